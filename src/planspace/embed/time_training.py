"""Training of the time head: the largest quasimetric that no known transition contradicts.

Notation: d is the quasimetric of `time_head`; an edge leads from x to y in t seconds, which is an upper bound
on the shortest time.

    maximise E[-softplus(farthest - d(a, b))]   over pairs of random states a, b
    subject to E[(d(x, y) - t)_+^2] <= slack^2  over edges

A quasimetric that meets the constraint on every edge is at most the shortest time along edges, and the
largest one equals it (Wang et al. 2023, Optimal goal-reaching reinforcement learning via quasimetric
learning). The multiplier of the constraint rises while the constraint is violated and falls otherwise. Edges
are those of the search trees and the steps of the demonstrations. A demonstration is nearly the fastest way,
so the time between two of its states is also a target of d.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import optax
from jaxtyping import Array, Float, Int, Key

from planspace.demos.dataset import Demos
from planspace.embed.config import TimeHeadConfig
from planspace.embed.embedding import Embedding
from planspace.embed.mlp import forward
from planspace.embed.networks import glorot_layers
from planspace.embed.time_head import TimeHead
from planspace.errors import PlanspaceError
from planspace.progress import progress

CHUNK = 500
"""Steps of one compiled call."""
MULTIPLIER_RATE = 0.01
"""Change of the multiplier's logarithm per step and per unit of log(violation / slack)."""
FIRST_MULTIPLIER, LARGEST_MULTIPLIER = 5.0, 14.0
"""Bounds of its logarithm: at the start, and at most."""
SMALLEST = 1e-9
"""Keeps logarithms of the violation finite."""


class Pairs(eqx.Module):
    """What the head is trained on."""

    x: Float[Array, "state read"]
    """What the head reads of each state: first those of the demonstrations, then the nodes of the trees."""
    before: Int[Array, " edge"]
    after: Int[Array, " edge"]
    seconds: Float[Array, " edge"]
    times: Float[Array, " row"]
    """Time of each state of a demonstration."""
    offsets: Int[Array, " bound"]
    """First state of each demonstration; the last entry is their number of states."""


class Head(eqx.Module):
    """The network h in JAX."""

    weights: list[Array]
    """Weights [out, in] of each layer."""
    biases: list[Array]
    """Biases [out] of each layer."""

    def __call__(self, x: Float[Array, " read"]) -> Float[Array, " feature"]:
        """H of one state."""
        layers = [(weight.T, bias) for weight, bias in zip(self.weights, self.biases, strict=True)]
        return forward(layers, x, jax.nn.relu)


def fit_time_head(
    embedding: Embedding, demos: Demos, train: Int[np.ndarray, " demo"], config: TimeHeadConfig, seed: int
) -> TimeHead:
    """Train a head for a finished embedding, which does not change.

    Args:
        embedding: gives what the head reads.
        demos: demonstrations with the columns that the embedding reads, with or without search trees.
        train: which of them are trained on.
        config: how to train.
        seed: seed of weights and batches.

    Raises:
        PlanspaceError: the training diverged.
    """
    pairs = make_pairs(embedding, demos, train, config)
    init_key, key = jr.split(jr.key(seed))
    head = Head(*glorot_layers((pairs.x.shape[1], *config.hidden, config.features), init_key))
    optimiser = _optimiser(config).init(eqx.filter(head, eqx.is_array))
    state = (head, optimiser, jnp.asarray(FIRST_MULTIPLIER))
    with progress("time head", config.steps, unit="step") as bar:
        for first in range(0, config.steps, CHUNK):
            count = min(CHUNK, config.steps - first)
            state, violation = _run_steps(state, jnp.array(first), jnp.array(count), pairs, config, key)
            if not np.isfinite(violation):
                raise PlanspaceError(
                    f"training of the time head diverged before step {first + count}; try a lower "
                    "--time-learning-rate, in another folder."
                )
            bar.update(count)
    weights, biases = (list(map(np.asarray, part)) for part in (state[0].weights, state[0].biases))
    return TimeHead(weights, biases, config.inputs)


def make_pairs(
    embedding: Embedding, demos: Demos, train: Int[np.ndarray, " demo"], config: TimeHeadConfig
) -> Pairs:
    """Collect the states, edges and times of the training demonstrations."""
    rows = demos.rows(train)
    lengths = np.diff(demos.offsets)[train]
    offsets = np.concatenate([[0], np.cumsum(lengths)])
    steps = np.setdiff1d(np.arange(len(rows) - 1), offsets[1:-1] - 1)
    states, times = [demos.states[rows]], demos.times[rows]
    before, after, seconds = [steps], [steps + 1], [np.diff(times)[steps]]
    first = len(rows)
    for tree in (demos.trees[i] for i in train if demos.trees):
        states.append(tree.states)
        before.append(first + tree.parents[1:])
        after.append(first + np.arange(1, len(tree)))
        seconds.append(tree.durations[1:])
        first += len(tree)
    read = embedding.time_inputs(np.concatenate(states), config.inputs)
    return Pairs(
        x=jnp.asarray(read, dtype=jnp.float32),
        before=jnp.asarray(np.concatenate(before)),
        after=jnp.asarray(np.concatenate(after)),
        seconds=jnp.asarray(np.concatenate(seconds), dtype=jnp.float32),
        times=jnp.asarray(times, dtype=jnp.float32),
        offsets=jnp.asarray(offsets),
    )


def quasimetric(a: Float[Array, " feature"], b: Float[Array, " feature"]) -> Float[Array, ""]:
    """`time_head.quasimetric` of two states, in JAX."""
    return jnp.maximum(b - a, 0.0).max()


@eqx.filter_jit
def _run_steps(
    state: tuple, first: Array, count: Array, pairs: Pairs, config: TimeHeadConfig, key: Key[Array, ""]
) -> tuple[tuple, Array]:
    """Take steps first .. first + count - 1; return the state after them and the last violation [s]."""

    def step(i: Array, carry: tuple) -> tuple:
        (head, optimiser, multiplier), _ = carry
        step_key = jr.fold_in(key, first + i)
        gradient, violation = eqx.filter_grad(_loss, has_aux=True)(
            head, multiplier, pairs, config, key=step_key
        )
        updates, optimiser = _optimiser(config).update(gradient, optimiser)
        change = jnp.log(violation + SMALLEST) - jnp.log(config.slack)
        multiplier = jnp.minimum(multiplier + MULTIPLIER_RATE * change, LARGEST_MULTIPLIER)
        return (eqx.apply_updates(head, updates), optimiser, multiplier), violation

    return jax.lax.fori_loop(0, count, step, (state, jnp.zeros(())))


def _loss(
    head: Head, multiplier: Array, pairs: Pairs, config: TimeHeadConfig, *, key: Key[Array, ""]
) -> tuple[Array, Array]:
    edge_key, a_key, b_key, plan_key = jr.split(key, 4)

    def d(a: Int[Array, " pair"], b: Int[Array, " pair"]) -> Float[Array, " pair"]:
        h = jax.vmap(head)
        return jax.vmap(quasimetric)(h(pairs.x[a]), h(pairs.x[b]))

    edges = jr.randint(edge_key, (config.batch,), 0, len(pairs.before))
    over = jnp.maximum(d(pairs.before[edges], pairs.after[edges]) - pairs.seconds[edges], 0.0)
    a, b = (jr.randint(k, (config.batch,), 0, len(pairs.x)) for k in (a_key, b_key))
    spread = jax.nn.softplus((config.farthest - d(a, b)) / config.softness) * config.softness
    earlier, later = _within_plans(pairs, config.batch // 2, plan_key)
    error = d(earlier, later) - (pairs.times[later] - pairs.times[earlier])
    violation = jnp.mean(over**2)
    loss = jnp.mean(spread) + jnp.exp(multiplier) * violation + config.plan_weight * jnp.mean(error**2)
    return loss, jnp.sqrt(violation)


def _within_plans(pairs: Pairs, batch: int, key: Key[Array, ""]) -> tuple[Array, Array]:
    """Draw pairs of states of the same demonstration, the earlier one first."""
    demo_key, time_key = jr.split(key)
    demo = jr.randint(demo_key, (batch,), 0, len(pairs.offsets) - 1)
    first, length = pairs.offsets[demo], pairs.offsets[demo + 1] - pairs.offsets[demo]
    where = jnp.sort(jr.uniform(time_key, (2, batch)), axis=0)
    earlier, later = first + jnp.floor(where * length).astype(int)
    return earlier, later


def _optimiser(config: TimeHeadConfig) -> optax.GradientTransformation:
    return optax.adam(optax.cosine_decay_schedule(config.learning_rate, config.steps))
