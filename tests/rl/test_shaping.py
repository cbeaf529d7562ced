import itertools
from dataclasses import replace
from pathlib import Path

import gymnasium
import numpy as np
import pytest

from planspace.embed.embedding import Embedding
from planspace.envs.batch import TaskBatch
from planspace.envs.wrappers import PlanSpaceShaping
from planspace.errors import UsageError
from planspace.rl.algorithms import ALGORITHMS
from planspace.rl.config import BATCH_STEPS, TrainConfig
from planspace.rl.rollout import ShapeFn
from planspace.rl.shaping import Shaping
from planspace.rl.training import train_policies
from planspace.tasks.catalog import TASKS
from planspace.tasks.problem import Box, Problem
from planspace.tasks.problem_task import task_of_problem

TASK, GAMMA = TASKS["cartpole-swingup"], 0.99
CONFIG = TrainConfig(obs="trig", shaping="z", shaping_scale=7.0, num_seeds=2, steps=2 * BATCH_STEPS)
ALONE = replace(CONFIG, num_seeds=1)
RUNNING = np.zeros(1, dtype=bool)


def shaping_of(
    config: TrainConfig, *embeddings: Embedding, discount: float = GAMMA, bootstrap_timeout: bool = False
) -> ShapeFn:
    found = Shaping.of(config, TASK, embeddings)
    assert found is not None
    return found.reward_fn(discount, bootstrap_timeout)


def test_the_mean_shaping_from_a_start_to_the_goal_equals_the_scale(embedding: Embedding) -> None:
    starts, _ = TASKS["cartpole-swingup"].sample_starts(1000, np.random.default_rng(0))
    goal = np.zeros((1000, 4))
    for form in ("z", "raw"):
        config = replace(CONFIG, shaping=form, num_seeds=1)
        paid = shaping_of(config, embedding, discount=1.0)(starts, goal, *np.zeros((2, 1000), dtype=bool))
        assert paid.mean() == pytest.approx(7.0)


def test_the_discounted_shaping_of_an_episode_telescopes(
    embedding: Embedding, rng: np.random.Generator
) -> None:
    shape = shaping_of(ALONE, embedding)
    states = rng.normal(size=(11, 1, 4))
    paid = [shape(a, b, RUNNING, RUNNING)[0] for a, b in itertools.pairwise(states)]
    summed = sum(GAMMA**t * x for t, x in enumerate(paid))
    # The sum is GAMMA^10 Phi(x_10) - Phi(x_0). The potential at the goal is 0, so a step from the goal to x
    # gives GAMMA Phi(x).
    goal = np.zeros((1, 4))
    last, first = (
        shape(goal, states[-1], RUNNING, RUNNING)[0] / GAMMA,
        shape(goal, states[0], RUNNING, RUNNING)[0] / GAMMA,
    )
    assert summed == pytest.approx(GAMMA**10 * last - first)
    ended = shape(states[0], states[1], ~RUNNING, RUNNING)[0]
    assert ended == pytest.approx(-first)  # the potential after termination is 0
    limit = shape(states[0], states[1], RUNNING, ~RUNNING)[0]
    assert limit == ended  # without `bootstrap_timeout`, the time limit is like a termination
    modern = shaping_of(ALONE, embedding, bootstrap_timeout=True)
    assert modern(states[0], states[1], RUNNING, ~RUNNING)[0] == pytest.approx(paid[0])


def test_the_raw_distance_wraps_angles() -> None:
    shape = shaping_of(replace(ALONE, shaping="raw"))
    near, turned = np.zeros((1, 4)), np.array([[0.0, 2 * np.pi, 0.0, 0.0]])
    assert shape(near, turned, RUNNING, RUNNING)[0] == pytest.approx(0.0)


def test_training_and_wrapper_give_the_same_shaping(embedding: Embedding, embedding_folder: Path) -> None:
    shape = shaping_of(ALONE, embedding)
    starts, _ = TASKS["cartpole-swingup"].sample_starts(1000, np.random.default_rng(0))
    typical = float(embedding.distance(starts, np.zeros(4)).mean())
    env = PlanSpaceShaping(
        gymnasium.make("planspace/CartPoleSwingUp-v0"),
        embedding_folder,
        goal=[0.0] * 4,
        scale=7.0 / typical,
        discount=GAMMA,
    )
    _, info = env.reset(seed=0)
    before = info["state"]
    for _ in range(5):
        *_, info = env.step(env.action_space.sample())
        expected = shape(before[None], info["state"][None], RUNNING, RUNNING)[0]
        assert info["shaping"] == pytest.approx(expected, abs=1e-6)
        before = info["state"]


def test_each_seed_is_shaped_by_its_own_embedding(embedding: Embedding) -> None:
    other = replace(embedding, encoder=([-w for w in embedding.encoder[0]], embedding.encoder[1]))
    states = np.random.default_rng(0).normal(size=(2, 40, 4))
    ended = np.zeros((2, 40), dtype=bool)
    both = shaping_of(CONFIG, embedding, other)(*states, *ended)
    shared = shaping_of(CONFIG, embedding)(*states, *ended)
    halves = states[:, :20], states[:, 20:]
    one = replace(CONFIG, num_seeds=1)
    first = shaping_of(one, embedding)(*halves[0], *ended[:, :20])
    second = [shaping_of(one, e)(*halves[1], *ended[:, 20:]) for e in (embedding, other)]
    np.testing.assert_array_equal(
        both, np.concatenate([first, second[1]])
    )  # equal bit for bit to single seeds
    np.testing.assert_array_equal(shared, np.concatenate([first, second[0]]))
    assert not np.allclose(*second, rtol=1e-2)


@pytest.mark.slow
@pytest.mark.parametrize("algo", ["trpo", pytest.param("ppo", marks=pytest.mark.nightly)])
def test_shaping_changes_training_but_not_the_reported_returns(algo: str, embedding: Embedding) -> None:
    config = replace(CONFIG, algorithm=ALGORITHMS[algo])
    shaped = train_policies(TASK, config, embedding=embedding).history
    plain = train_policies(TASK, replace(config, shaping="none")).history
    np.testing.assert_array_equal(shaped["return"][0], plain["return"][0])  # the same first policy
    assert (shaped["return"][1] != plain["return"][1]).all()
    again = train_policies(TASK, config, embedding=embedding).history
    np.testing.assert_array_equal(again["return"], shaped["return"])


@pytest.mark.slow
def test_the_sparse_reward_is_one_at_the_goal() -> None:
    config = replace(CONFIG, shaping="none", reward="sparse")
    returns = train_policies(TASK, config).history["return"]
    assert (returns >= 0).all() and (returns * 20 == np.round(returns * 20)).all()  # steps, over 20 episodes
    batch = TaskBatch(TASKS["cartpole-swingup"], 1, reward="sparse")
    batch.reset(np.zeros((1, 4)), np.zeros((1, 0)))
    assert batch.step(np.zeros((1, 1)))[0] == 1.0


def test_wrong_combinations_of_shaping_and_embedding_are_refused(
    embedding: Embedding, tmp_path: Path
) -> None:
    with pytest.raises(UsageError, match="shaping by 'z' needs an embedding"):
        train_policies(TASK, CONFIG, out=tmp_path / "a")
    with pytest.raises(
        UsageError, match="shaping needs one goal, but reacher-raw has another target in every episode"
    ):
        train_policies("reacher-raw", replace(CONFIG, obs="raw", shaping="raw"), out=tmp_path / "b")
    with pytest.raises(UsageError, match="or --shaping z"):
        train_policies(TASK, replace(CONFIG, shaping="none"), embedding=embedding, out=tmp_path / "c")
    with pytest.raises(UsageError, match=r"`shaping_scale` must be above 0 and finite, got 0\.0"):
        replace(CONFIG, shaping_scale=0.0)
    with pytest.raises(UsageError, match="unknown reward type of cartpole '2020'"):
        train_policies("cartpole", TrainConfig(reward="2020"), out=tmp_path / "d")
    assert not any((tmp_path / name).exists() for name in "abcd")


def test_activations_that_are_free_in_the_goal_do_not_count() -> None:
    """The raw potential at the goal is 0 with any activation."""
    model = """<mujoco><worldbody><body><joint name="j" axis="0 1 0" range="-100 100"/>
      <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.02" mass="0.5"/></body></worldbody><actuator>
      <general joint="j" dyntype="filter" dynprm="0.1" gainprm="3" ctrlrange="-1 1"/></actuator></mujoco>"""
    box = Box((0.5, 0.0), (1.0, 0.0))
    problem = Problem("arm", model, ("j",), box, Box((0.0, 0.0), (0.0, 0.0)), 0.1)
    shaping = Shaping.of(replace(ALONE, shaping="raw"), task_of_problem(problem), ())
    assert shaping is not None
    shape = shaping.reward_fn(1.0, True)
    goals, running = np.array([[0, 0, 0.0], [0, 0, 0.7]]), np.zeros(2, dtype=bool)
    np.testing.assert_array_equal(shape(goals, goals[::-1], running, running), 0)
    starts = np.array([[0.75, 0, 0.2]] * 2)
    np.testing.assert_allclose(shape(starts, goals, running, running), 7.0, rtol=0.02)
