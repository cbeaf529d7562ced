"""Opening a door with the Adroit hand from 25 human demonstrations, by several ways to use them.

    OPENBLAS_NUM_THREADS=1 python benchmarks/door.py runs/door --archive door_human.npz
    python benchmarks/door.py --table

The archive holds the demonstrations that were released with DAPG as arrays (docs/howto/demonstrations.md says
what it looks like). They recorded observations, which lack the height of the arm and all velocities. The
states are reconstructed: the height follows from the position of the palm, and the velocities are central
differences. `--states` prints how far the reconstructed states are from what was recorded.

The task is `AdroitHandDoorSparse-v1`, 10 for each step with an open door and -0.1 for every other. An episode
succeeds if the door is open in any of its 200 steps. The demonstrations are slower than that. `--lead N`
pairs each state with the control that was recorded N steps later, so that policies that imitate them are
faster. The algorithms have the preset `modern` and networks of 64 x 64; TRPO and PPO have no replay and look
further ahead (`ON_POLICY`), and TRPO takes smaller steps. Each final policy plays 100 episodes, without
noise. Settings were chosen on seed 300; seeds from 301 show what they are worth. Rows are added to
results/rl/door.csv unit by unit; a unit is a seed of an arm.
"""

import itertools
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from csv_rows import Row, add_missing, make_parser, parse

import planspace as ps
from planspace.demos.dataset import Demos
from planspace.demos.episode import Episode
from planspace.demos.state_info import StateInfo
from planspace.embed.config import PRESETS
from planspace.embed.embedding import Embedding
from planspace.envs.gymnasium_env import GymTaskEnv
from planspace.rl.algorithms import find_algorithm
from planspace.rl.config import TrainConfig
from planspace.rl.play import play
from planspace.seams import with_settings
from planspace.tasks.env_state import mujoco_of
from planspace.tasks.gymnasium import GymTask

RESULTS = Path(__file__).parents[1] / "results" / "rl" / "door.csv"
COLUMNS = ("algorithm", "arm", "lead", "steps", "seed", "episodes", "success", "return_mean")
TASK = GymTask("AdroitHandDoorSparse-v1")
SEED, NUM_SEEDS, STEPS, EPISODES, HIDDEN = 301, 5, 300_000, 100, (64, 64)
LEAD = 4
"""Steps by which a state has its control earlier than it was recorded; see `hurried`."""
CLOSED = -0.1 * 200
"""Return of an episode whose door stays closed."""
ON_POLICY = {"discount": 0.995, "gae_lambda": 0.97}
"""Settings of TRPO and PPO in all arms."""
INITIAL_STD = 0.05
"""Noise with which their policies begin in arms that clone."""
MAX_KL = 0.01
"""The bound of an update of TRPO."""
BATCH_STEPS = 5000
"""Steps of an iteration of TRPO and PPO."""
CLONING = {"clone": 10_000, "plan_noise": 0.2, "clone_weight": 0.1, "clone_decay": 1.0}
ARMS: dict[str, dict[str, Any]] = {
    "scratch": {},
    "cloning": CLONING,
    "resets": {"resets": 0.5},
    "resets + z": {"resets": 0.5, "z": "augment"},
    "replay": {"replay": 0.5},
    "resets and replay": {"resets": 0.5, "replay": 0.5},
    "reverse resets and replay": {"resets": 0.8, "reset_schedule": "reverse", "replay": 0.5},
    "cloning and resets": {**CLONING, "resets": 0.25},
}
"""Settings of `TrainConfig` that differ from those of the first arm."""


def main() -> None:
    """Run the units that the results do not have yet."""
    parser = make_parser(__doc__, "where demonstrations, embedding and runs are kept")
    parser.add_argument("--archive", type=Path, help="the demonstrations (.npz)")
    parser.add_argument("--algo", default="sac", choices=("sac", "trpo", "ppo"))
    parser.add_argument("--arms", nargs="+", default=list(ARMS), choices=ARMS)
    parser.add_argument("--seeds", type=int, default=NUM_SEEDS, metavar="N", help="how many seeds")
    parser.add_argument("--first", type=int, default=SEED, metavar="N", help="the first seed")
    parser.add_argument("--steps", type=int, default=STEPS, metavar="N")
    parser.add_argument("--lead", type=int, default=LEAD, metavar="N", help="steps; see `hurried`")
    parser.add_argument("--states", action="store_true", help="say how exact the states are, and stop")
    options, rows = parse(parser, RESULTS, table)
    if options.archive is None:
        parser.error("--archive FILE is needed")
    recorded = full_states(options.archive)
    demos = hurried(recorded, options.lead)
    demos.save(options.folder / f"demos-{options.lead}")
    if options.states:
        print(exactness(recorded, options.archive))
        return
    for seed in range(options.first, options.first + options.seeds):
        for arm in options.arms:
            if "replay" in ARMS[arm] and options.algo != "sac":
                continue
            lead = options.lead if {"clone", "replay"} & ARMS[arm].keys() else 0  # others use no controls
            key = {"algorithm": options.algo, "arm": arm, "lead": str(lead)}
            key |= {"steps": str(options.steps), "seed": str(seed)}
            train = partial(run, options.folder, demos, key)
            add_missing(RESULTS, COLUMNS, rows, key, train)


def run(folder: Path, demos: Demos, key: Row) -> Row:
    """Train one seed of an arm, and let it play."""
    settings, seed = ARMS[key["arm"]], int(key["seed"])
    algorithm = with_settings(find_algorithm(key["algorithm"], "modern"), hidden=HIDDEN, critic_hidden=HIDDEN)
    if key["algorithm"] != "sac":
        settings = {"batch_steps": BATCH_STEPS, **settings}
        noise = {"initial_std": INITIAL_STD} if "clone" in settings else {}
        algorithm = with_settings(algorithm, **ON_POLICY, **noise)
    if key["algorithm"] == "trpo":
        algorithm = with_settings(algorithm, max_kl=MAX_KL)
    config = TrainConfig(algorithm, num_seeds=1, seed=seed, steps=int(key["steps"]), **settings)
    out = folder / "-".join(key.values()).replace(" ", "-")
    ps.train_policies(
        TASK,
        config,
        embedding=embedding_of(demos, folder) if "z" in settings else None,
        plans=demos if config.uses_of_plans else None,
        out=out,
    )
    returns, _ = play(ps.load_policy(out, seed), EPISODES, 0)
    success, mean = (returns > CLOSED + 1).mean(), returns.mean()
    return {"episodes": str(EPISODES), "success": f"{success:.2f}", "return_mean": f"{mean:.1f}"}


def hurried(demos: Demos, lead: int) -> Demos:
    """Give each state the control that was recorded some steps later.

    The demonstrations are slower than the task allows, and the actuators are position servos: told earlier
    where to go, they move faster.
    """
    episodes = [demos.episode(i) for i in range(len(demos))]
    ahead = [np.minimum(np.arange(len(e.controls)) + lead, len(e.controls) - 1) for e in episodes]
    return Demos.from_episodes(
        demos.info, [replace(e, controls=e.controls[rows]) for e, rows in zip(episodes, ahead, strict=True)]
    )


def embedding_of(demos: Demos, folder: Path) -> Embedding:
    """An embedding of the joints' positions and velocities."""
    joints = demos.select(demos.info.names[:60])
    return ps.fit_embedding(joints, config=PRESETS["modern"], out=folder / "embedding")


# --- states -----------------------------------------------------------------------------------------


def full_states(archive: Path) -> Demos:
    """Reconstruct the states of the demonstrations from their observations."""
    with np.load(archive) as data:
        arrays = {name: data[name] for name in data.files}
    env, names = GymTaskEnv(TASK), TASK.sizes.settable_names
    info = StateInfo(names, ("",) * len(names), (), TASK.sizes.action_low.size)
    episodes, offsets = [], arrays["offsets"]
    for i, (first, last) in enumerate(itertools.pairwise(offsets)):
        door, dt = arrays["door_body_pos"][i], env.step_time
        observed = arrays["observations"][first:last]
        positions = joint_positions(env, observed, door, arrays["init_qpos"][i], dt)
        velocities = np.asarray(np.gradient(positions, dt, axis=0))
        velocities[0] = arrays["init_qvel"][i]
        states = np.hstack([positions, velocities, np.broadcast_to(door, (len(positions), 3))])
        times, goal = dt * np.arange(len(states)), np.full(len(names), np.nan)
        controls = arrays["actions"][first : last - 1]
        episodes.append(Episode(states, controls, times, goal, True, i, i))
    env.close()
    return Demos.from_episodes(info, episodes)


def joint_positions(
    env: GymTaskEnv, observed: np.ndarray, door: np.ndarray, first: np.ndarray, dt: float
) -> np.ndarray:
    """All joint positions [step, 30] of a demonstration.

    An observation holds all but the first, the slide of the arm, and the position of the palm at the start of
    the last simulation step. The slide moves the palm along a fixed axis.
    """
    positions = np.zeros((len(observed), 30))
    positions[:, 1:28], positions[:, 28], positions[:, 29] = (
        observed[:, :27],
        observed[:, 28],
        observed[:, 27],
    )
    positions[:, 0] = first[0]
    lag = timestep(env)
    for _ in range(3):  # the palm depends on the velocities, and these on the slide
        velocities = np.asarray(np.gradient(positions, dt, axis=0))
        before = positions - lag * velocities
        before[0] = positions[0]  # the first observation is that of a reset
        palms, axis = palms_at(env, before, door)
        positions[:, 0] += (observed[:, 29:32] - palms) @ axis
    return positions


def palms_at(env: GymTaskEnv, positions: np.ndarray, door: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Position of the palm [step, 3], and the direction in which the slide moves it."""
    palms = np.zeros((len(positions), 3))
    env.reset(seed=0)
    for k, qpos in enumerate(positions):
        palms[k] = env.set_state(np.concatenate([qpos, np.zeros(30), door]))[29:32]
    moved = positions[0].copy()
    moved[0] += 0.01
    there = env.set_state(np.concatenate([moved, np.zeros(30), door]))[29:32]
    return palms, (there - palms[0]) / 0.01


def timestep(env: GymTaskEnv) -> float:
    """Duration of a simulation step [s]."""
    found = mujoco_of(env.inner)
    assert found is not None
    return float(found[0].opt.timestep)


def exactness(demos: Demos, archive: Path) -> str:
    """How far the states, and one step from each with the recorded action, are from what was recorded."""
    with np.load(archive) as data:
        observed, actions = data["observations"], data["actions"]
    env, offsets = GymTaskEnv(TASK), demos.offsets
    inside = np.setdiff1d(np.arange(len(demos.states)), offsets[1:] - 1)
    at, after = [], []
    for row in inside:
        env.reset(seed=0)
        at.append(np.abs(env.set_state(demos.states[row])[:38] - observed[row, :38]))
        obs = env.step(actions[row])[0]
        after.append(np.abs(obs[:38] - observed[row + 1, :38]))
    at, after = np.array(at), np.array(after)
    env.close()
    lines = ["| numbers | state | one step later |", "|---|---|---|"]
    for name, columns in (("joints [rad]", slice(0, 29)), ("palm and handle [m]", slice(29, 35))):
        shown = [
            f"{np.median(worst):.4f} (99 %: {np.quantile(worst, 0.99):.3f})"
            for worst in (at[:, columns].max(axis=1), after[:, columns].max(axis=1))
        ]
        lines.append(f"| {name} | {' | '.join(shown)} |")
    return "\n".join(lines)


def table(rows: list[Row]) -> str:
    """Success of the seeds of each arm."""
    names = ("algorithm", "arm", "lead", "steps", "seeds", "success of each seed", "mean", "mean return")
    lines = [f"| {' | '.join(names)} |", "|---" * len(names) + "|"]
    groups: dict[tuple[str, ...], list[Row]] = {}
    for row in rows:
        groups.setdefault(tuple(row[name] for name in ("algorithm", "arm", "lead", "steps")), []).append(row)
    for (algorithm, arm, lead, steps), own in groups.items():
        success, returns = (
            np.array([float(row[name]) for row in own]) for name in ("success", "return_mean")
        )
        each = ", ".join(f"{found:.0%}" for found in sorted(success))
        cells = (algorithm, arm, lead, f"{int(steps):,}", len(own), each, f"{success.mean():.0%}")
        lines.append(f"| {' | '.join(map(str, cells))} | {returns.mean():.0f} |")
    return "\n".join(lines)


if __name__ == "__main__":
    main()
