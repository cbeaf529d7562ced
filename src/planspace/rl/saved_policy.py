"""Trained policies, loaded with NumPy only: neither JAX nor MuJoCo is imported.

RUN/policies.safetensors   weights [seed, ...], and statistics that standardise observations
RUN/policies.json          what they observe, the limits of their actions, the return of each seed; sealed
RUN/embedding/             the embedding that makes z; if there are several, RUN/embedding-0/ and so on
"""

import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, NotRequired, TypedDict, cast, get_args

import numpy as np
from jaxtyping import Float

from planspace.embed.embedding import Embedding
from planspace.embed.saved_embedding import load_embedding
from planspace.errors import PlanspaceError, UsageError, quoted
from planspace.rl.config import GoalMode, ZMode, ZTarget
from planspace.rl.normalise import ObsStatistics
from planspace.rl.stack import Activation, Stack, scaled
from planspace.storage.arrays import Arrays, read_arrays, write_arrays
from planspace.storage.checks import reject_malformed
from planspace.storage.json_files import read_description, write_sealed
from planspace.storage.ready_made import POLICY, find_folder
from planspace.tasks.catalog import TASKS
from planspace.tasks.gymnasium import parse_gym_task
from planspace.tasks.observation_types import MAX_OBS, OBSERVATION_TYPES, ObservationType, RewardType

SCHEMA = 2
"""1: tanh units and a linear output. 2: ReLU units, or an output that tanh squashes, which version 0.1.0 does
not know."""
WEIGHTS, DESCRIPTION, EMBEDDING = "policies.safetensors", "policies.json", "embedding"
ALLOWED = {
    "obs": OBSERVATION_TYPES,
    "reward": get_args(RewardType),
    "z": get_args(ZMode),
    "z_to": get_args(ZTarget),
    "goal": get_args(GoalMode),
}
"""Values that a description may have."""
DEFAULTS = {"reward": "dense", "goal": "raw"}
"""Values of what a description may leave out."""


class PoliciesInfo(TypedDict):
    """The description of a run's policies, in `policies.json`."""

    task: str
    env_id: str | None
    """Its Gymnasium id; None for a task that planspace does not ship."""
    task_sha256: NotRequired[str]
    """Hash of the content of a task that planspace does not ship."""
    environment: NotRequired[dict[str, Any]]
    """Id and arguments of a Gymnasium environment; see `GymTask.plain`."""
    obs: ObservationType
    reward: NotRequired[RewardType]
    z: ZMode
    z_to: ZTarget
    action_repeat: NotRequired[int]
    """Environment steps for which each action is held; 1 if it is missing."""
    goal: NotRequired[GoalMode]
    """Whether z of the goal is observed; `raw` if it is missing."""
    num_obs: int
    """Numbers in an observation, including z."""
    columns: list[int | None]
    """First and last column that the policies read."""
    layer_norm: bool
    activation: NotRequired[Activation]
    """The activation of hidden layers; tanh if it is missing."""
    squashed: NotRequired[bool]
    """Whether tanh squashes the output between the limits of an action; no if it is missing."""
    action_low: list[float | None]
    """Lower limits of an action; None for no limit."""
    action_high: list[float | None]
    """Upper limits of an action; None for no limit."""
    seeds: list[int]
    embeddings: list[str]
    """The folder of each seed's embedding; empty without z."""
    embedding_hashes: NotRequired[list[str]]
    """`Embedding.hash` of each seed's embedding; earlier versions did not record it."""
    returns: list[float | None]
    """Return of each seed in the last evaluation; None if it is not finite."""
    versions: dict[str, str]


@dataclass(frozen=True)
class Policy:
    """The policy of one seed."""

    run: Path
    """The run that trained it."""
    about: PoliciesInfo
    """The description of the run's policies."""
    seed: int
    """Its seed."""
    network: Stack
    """The mean action, for a seed axis of one."""
    std: Float[np.ndarray, " action"]
    """Standard deviation of its exploration in training; 0 if it explored without noise."""
    columns: slice
    """The part of an observation that it reads."""
    statistics: ObsStatistics | None
    """Standardises observations."""
    low: Float[np.ndarray, " action"]
    """Lower limits of an action; -inf where the environment sets none."""
    high: Float[np.ndarray, " action"]
    """Upper limits of an action; inf where the environment sets none."""
    keeps: object = field(default=None, repr=False)
    """The temporary folder of a run in memory, which is removed with the last policy that needs it."""

    @property
    def embedding(self) -> Path:
        """The folder of the embedding that makes its z."""
        return self.run / self.about["embeddings"][self.about["seeds"].index(self.seed)]

    def load_embedding(self) -> Embedding:
        """Load the embedding that makes its z.

        Raises:
            PlanspaceError: the embedding cannot be loaded, or is not the one of the training.
        """
        embedding = load_embedding(self.embedding)
        hashes = self.about.get("embedding_hashes")
        if hashes and hashes[self.about["seeds"].index(self.seed)] != embedding.hash:
            raise PlanspaceError(
                f"{self.embedding} is not the embedding that the policy was trained with: it was replaced."
            )
        return embedding

    def __call__(self, obs: Float[np.ndarray, "*batch obs"]) -> Float[np.ndarray, "*batch action"]:
        """The mean action, clipped to the environment's limits.

        Raises:
            PlanspaceError: the observation has another number of columns than in training, or the action is
                not finite.
        """
        obs = np.asarray(obs)
        if obs.shape[-1:] != (self.about["num_obs"],):
            task = self.about["env_id"] or self.about["task"]
            raise PlanspaceError(
                f"the policy was trained on observations of {self.about['num_obs']} numbers "
                f"({task}, obs={self.about['obs']!r}, z={self.about['z']!r}), "
                f"got {obs.shape[-1] if obs.ndim else 'one number'}."
            )
        with np.errstate(all="ignore"):  # checked below
            rows = obs.reshape(1, -1, obs.shape[-1]).astype(np.float32)
            rows = rows if self.statistics is None else self.statistics(rows)
            actions = self.network(rows[..., self.columns])[0]
            if self.about.get("squashed", False):
                actions = scaled(np.tanh(actions), self.low, self.high)
        if not np.isfinite(actions).all():
            raise PlanspaceError(
                f"{self.run}: an action of seed {self.seed} is not finite, because its weights or its "
                "observations are too large."
            )
        actions = np.clip(actions, self.low, self.high).astype(np.float32)
        return actions.reshape(*obs.shape[:-1], len(self.low))


def save_policies(run: Path, arrays: Arrays, about: PoliciesInfo) -> None:
    """Write the policies of a run, the description last: a folder without it holds no policies."""
    sha256 = write_arrays(run / WEIGHTS, arrays)
    schema = SCHEMA if {"activation", "squashed"} & about.keys() else 1
    write_sealed(run / DESCRIPTION, {"schema": schema, "kind": "policies", "weights_sha256": sha256, **about})


def find_runs(folder: Path) -> dict[str, Path]:
    """Find the training runs in a folder: the folder itself, or the arms of a `planspace run`.

    Args:
        folder: the folder, or the name of a ready-made policy, such as `cartpole-swingup`.

    Raises:
        UsageError: neither a folder nor a ready-made policy has this name.

    Returns:
        The folder of each run that holds policies, by the name of its arm; empty if no run has any.
    """
    folder = find_folder(folder, POLICY)
    if (folder / DESCRIPTION).exists():
        return {folder.name: folder}
    return {file.parent.name: file.parent for file in sorted(folder.glob(f"train/*/{DESCRIPTION}"))}


def load_policy(run: str | Path, seed: int | Literal["best"] = "best") -> Policy:
    """Load a policy of a training run. Its task is not needed.

    Args:
        run: the folder that `planspace train` or `train_policies` wrote, or the name of a ready-made policy,
            such as `cartpole-swingup`.
        seed: a seed of the run, or `best` for the one with the best return in the last evaluation.

    Raises:
        PlanspaceError: the run is not finished, was altered, or was written by a newer planspace.
        UsageError: the run has no such seed, or neither a folder nor a ready-made policy has this name.
    """
    run = find_folder(run, POLICY)
    if not (run / DESCRIPTION).exists():
        raise PlanspaceError(
            f"{run} holds no policies: it has no {DESCRIPTION}. `planspace train` makes them."
        )
    about = read_description(run / DESCRIPTION, kind="policies", schema=SCHEMA)
    with reject_malformed(run / DESCRIPTION):
        return _assembled(run, about, seed)


def _assembled(run: Path, saved: dict[str, Any], seed: int | Literal["best"]) -> Policy:
    _check_about(run / DESCRIPTION, saved)
    about = cast(PoliciesInfo, saved)
    seeds = about["seeds"]
    if seed != "best" and seed not in seeds:
        raise UsageError(f"{run} has seeds {seeds[0]} to {seeds[-1]}, not {seed}.")
    returns = [-np.inf if x is None else float(x) for x in about["returns"]]  # None was not finite
    i = int(np.argmax(returns)) if seed == "best" else seeds.index(seed)
    every_seed = read_arrays(run / WEIGHTS, sha256=str(saved["weights_sha256"]))
    arrays = {name: array[i : i + 1] for name, array in every_seed.items()}
    bad = [name for name, array in arrays.items() if not np.isfinite(array).all()]
    if bad:
        raise PlanspaceError(f"{run / WEIGHTS}: {bad[0]} holds a number that is not finite.")
    layers = range(sum(name.endswith(".weight") for name in arrays))
    network = Stack(
        [arrays[f"{n}.weight"] for n in layers],
        [arrays[f"{n}.bias"] for n in layers],
        layer_norm=about["layer_norm"],
        activation=about.get("activation", "tanh"),
    )
    statistics = None
    if "num" in arrays:
        statistics = ObsStatistics(arrays["num"], arrays["mean"], arrays["squares"])
    with np.errstate(over="ignore"):
        std = np.exp(arrays["log_std"][0]) if "log_std" in arrays else np.zeros(len(about["action_low"]))
        low, high = _limits(about["action_low"], -np.inf), _limits(about["action_high"], np.inf)
    columns = slice(*about["columns"])
    policy = Policy(run, about, seeds[i], network, std, columns, statistics, low, high)
    if not np.isfinite(std).all() or not (low < high).all():
        raise ValueError("its actions have no standard deviation or no range")
    tried = np.stack([np.zeros(about["num_obs"], np.float32), np.ones(about["num_obs"], np.float32)])
    if policy(tried).shape != (2, len(std)):
        raise ValueError("its network has other sizes than its description")
    return policy


def _check_about(file: Path, about: dict[str, Any]) -> None:
    """Check that it names only what is ours: Gymnasium would import code for an environment's name.

    A task that planspace does not ship has no environment's name; `play` is given the task.
    """
    task, env_id = about["task"], about["env_id"]
    if not isinstance(task, str) or not isinstance(env_id, str | None):
        raise TypeError("its task or its environment is not a name")
    known = TASKS.get(task)
    if env_id is not None and (known is None or known.env_id != env_id):
        raise PlanspaceError(
            f"{file} names the environment {quoted(env_id)} for the task {quoted(task)}; planspace has none "
            "such for it. Train the policy anew with `planspace train`, or upgrade planspace."
        )
    if "environment" in about:
        parse_gym_task(about["environment"])
    for name, known in ALLOWED.items():
        if about.get(name, DEFAULTS.get(name)) not in known:
            raise ValueError(f"{name} is {quoted(about.get(name))}")
    _check_output(about)
    if not all(type(number) is int for number in (*about["seeds"], about["num_obs"])):
        raise TypeError("its seeds or its num_obs are not whole numbers")
    if not 0 < about["num_obs"] <= MAX_OBS:
        raise ValueError(f"it observes {about['num_obs']} numbers")
    _check_embeddings(about)


def _check_embeddings(about: dict[str, Any]) -> None:
    """Check that each seed has its embedding within the run."""
    embeddings = about.get("embeddings", ())
    if not all(re.fullmatch(rf"{EMBEDDING}(-\d+)?", name) for name in embeddings):
        raise ValueError("it names an embedding outside its run")
    if about["z"] != "none" and len(embeddings) != len(about["seeds"]):
        raise ValueError("it does not name an embedding for each seed")
    hashes = about.get("embedding_hashes", embeddings)
    if len(hashes) != len(embeddings) or not all(isinstance(one, str) for one in hashes):
        raise ValueError("it does not name a hash for each embedding")


def _check_output(about: dict[str, Any]) -> None:
    """Check how the network computes actions, and how long they last."""
    if type(repeat := about.get("action_repeat", 1)) is not int or repeat < 1:
        raise ValueError(f"action_repeat is {quoted(repeat)}")
    if about.get("activation", "tanh") not in get_args(Activation):
        raise ValueError(f"activation is {quoted(about['activation'])}")
    if type(is_squashed := about.get("squashed", False)) is not bool:
        raise TypeError(f"squashed is {quoted(is_squashed)}")
    if is_squashed and None in (*about["action_low"], *about["action_high"]):
        raise ValueError("its output is squashed between limits that are missing")


def _limits(numbers: list[float | None], unlimited: float) -> Float[np.ndarray, " action"]:
    """Lower or upper limits of an action; null in JSON means no limit."""
    if not all(x is None or isinstance(x, int | float) for x in numbers):
        raise TypeError("a limit of its actions is not a number")
    limits = np.array([unlimited if x is None else x for x in numbers], np.float32)
    if not all(x is None or np.isfinite(limit) for x, limit in zip(numbers, limits, strict=True)):
        raise ValueError("a limit of its actions is not finite")
    return limits
