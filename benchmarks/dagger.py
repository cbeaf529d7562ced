"""Policies that imitate the controller, also where they themselves went (DAgger).

    OPENBLAS_NUM_THREADS=1 python benchmarks/dagger.py runs/dagger

Round 0 clones episodes of control from the task's starts. In each further round the policy acts, the
controller takes over from a random state of each of its episodes, and a new policy clones all episodes so far
that succeeded. Plans and embedding are the ready-made ones; the controller minimises the time to go with
0.16 s of foresight and 128 candidates, and follows plans. After each round the policy acts from the same 100
starts, without noise; `held` is the fraction of these episodes that are at the goal for their last second.

Policies of 256 x 256 take 30,000 gradient steps of cloning with `--plan-noise 0.05`, and then one iteration
of TRPO (4000 steps, `modern`, noise 0.1), because training has at least one. After the last round, a policy
takes 120,000 gradient steps on the same episodes, and `--further N` trains another such policy by TRPO for N
steps. What the folder holds is not made again. Rows are added to results/rl/dagger.csv. `--table` prints the
table of docs/training.md.
"""

from functools import partial
from pathlib import Path

import numpy as np
from csv_rows import add_missing, make_parser, parse

import planspace as ps
from planspace.control.config import ControlConfig
from planspace.control.episodes import LAST_S
from planspace.control.plant import Plant
from planspace.control.runs import EPISODES, control_into
from planspace.demos.dataset import Demos
from planspace.demos.episode import Episode
from planspace.envs.batch import TaskBatch
from planspace.rl.algorithms import find_algorithm
from planspace.rl.config import TrainConfig
from planspace.rl.observe import Observer
from planspace.rl.saved_policy import Policy
from planspace.rl.training import train_policies
from planspace.seams import with_settings
from planspace.tasks.observation_types import ObservationType
from planspace.tasks.task import Task

RESULTS = Path(__file__).parents[1] / "results" / "rl" / "dagger.csv"
COLUMNS = ("task", "guided", "corrected", "round", "clone", "steps", "episodes", "held", "return_mean")
CONTROL = ControlConfig(horizon_s=0.16, samples=128, cost="time", follow_s=3.0)
NUM_TESTS, TEST_SEED, GUIDE_SEED, LEARN_SEED = 100, 0, 7, 1000
CLONE_STEPS, LAST_CLONE_STEPS, PLAN_NOISE = 30_000, 120_000, 0.05
STEPS = 4000
"""Environment steps of training: one iteration."""


def main() -> None:
    """Run the rounds that the results do not have yet."""
    parser = make_parser(__doc__, "where episodes and policies are kept")
    parser.add_argument("--task", default="acrobot-swingup", help="a task with ready-made plans")
    parser.add_argument("--guided", type=int, default=60, metavar="N", help="episodes of round 0")
    parser.add_argument("--corrected", type=int, default=120, metavar="N", help="episodes of a later round")
    parser.add_argument("--rounds", type=int, default=7, metavar="N", help="rounds after round 0")
    parser.add_argument(
        "--further", type=int, default=0, metavar="N", help="steps of TRPO after the last round"
    )
    options, rows = parse(parser, RESULTS, table)
    if 0 < options.further <= STEPS:
        parser.error(f"--further must be more than the {STEPS} steps of every other policy")
    plant, folder = Plant.find(options.task), options.folder / f"{options.task}-{options.guided}"
    assert isinstance(plant.task, Task)
    runs = [control(plant, folder / "guided", options.guided, GUIDE_SEED)]

    def trained(number: int, clone: int, suffix: str = "", steps: int = STEPS) -> Policy:
        """The policy of a round, whose row is added."""
        out = folder / f"policy-{number}-{options.corrected}{suffix}"
        policy = cloned(plant.task, runs, out, clone, steps)
        key = {"task": options.task, "guided": str(options.guided), "corrected": str(options.corrected)}
        key |= {"round": str(number), "clone": str(clone), "steps": str(steps)}
        add_missing(RESULTS, COLUMNS, rows, key, partial(measure, plant.task, policy, runs))
        return policy

    policy = trained(0, CLONE_STEPS)
    for number in range(options.rounds):
        seed = LEARN_SEED + number
        states, _, _ = act(plant.task, policy, options.corrected, seed)
        when = np.random.default_rng(seed).integers(len(states), size=options.corrected)
        starts = states[when, np.arange(options.corrected)]
        out = folder / f"corrected-{number}-{options.corrected}"
        runs.append(control(plant, out, options.corrected, seed, starts))
        policy = trained(number + 1, CLONE_STEPS)
    trained(options.rounds, LAST_CLONE_STEPS, "-last")
    if options.further:
        trained(options.rounds, LAST_CLONE_STEPS, f"-further-{options.further}", options.further)


def measure(task: Task, policy: Policy, runs: list[Path]) -> dict[str, str]:
    """How many episodes a policy learned from, and what it does."""
    _, held, returns = act(task, policy, NUM_TESTS, TEST_SEED)
    return {
        "episodes": str(sum(len(successful(run)) for run in runs)),
        "held": f"{held.mean():.2f}",
        "return_mean": f"{returns.mean():.1f}",
    }


def control(plant: Plant, out: Path, num: int, seed: int, starts: np.ndarray | None = None) -> Path:
    """Control episodes from the task's starts, or from given ones."""
    name = plant.task.name
    embedding, plans = ps.load_embedding(name), ps.load_demos(name)
    control_into(plant, embedding, CONTROL, out, num=num, seed=seed, plans=plans, starts=starts)
    return out


def successful(run: Path) -> list[Episode]:
    """The episodes of a run that ended at the goal."""
    demos = ps.load_demos(run / EPISODES)
    return [demos.episode(i) for i in range(len(demos)) if demos.success[i]]


def cloned(task: Task, runs: list[Path], out: Path, clone: int, steps: int) -> Policy:
    """A policy that imitates the successful episodes of some runs, and then trains for some steps."""
    info = ps.load_demos(runs[0] / EPISODES).info
    demos = Demos.from_episodes(info, [episode for run in runs for episode in successful(run)])
    algorithm = with_settings(
        find_algorithm("trpo", "modern"), hidden=(256, 256), critic_hidden=(64, 64), initial_std=0.1
    )
    config = TrainConfig(
        algorithm, obs=observation(task), num_seeds=1, steps=steps, clone=clone, plan_noise=PLAN_NOISE
    )
    return train_policies(task, config, plans=demos, out=out).policy()


def act(task: Task, policy: Policy, num: int, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Let a policy act without noise.

    Returns:
        The states [time, episode, state], whether each episode holds the goal, and the returns.
    """
    batch, observe = TaskBatch(task, num), Observer(task, observation(task), "none", "both")
    batch.reset(*task.sample_starts(num, np.random.default_rng(seed)))
    states, returns, at_goal = [batch.states.copy()], np.zeros(num), []
    for _ in range(task.horizon):
        rewards, _, _ = batch.step(policy(observe(batch.states, batch.targets)))
        returns += rewards
        states.append(batch.states.copy())
        at_goal.append(task.at_goal(batch.states, batch.targets))
    last = round(LAST_S / (task.frame_skip * batch.simulator.model.opt.timestep))
    return np.stack(states), np.all(at_goal[-last - 1 :], axis=0), returns


def observation(task: Task) -> ObservationType:
    """What policies observe: sines and cosines if the task has angles."""
    return "trig" if task.sin_cos_columns else "raw"


def table(rows: list[dict[str, str]]) -> str:
    """What the policy of each round does."""
    lines = [
        "| round | episodes | gradient steps | steps of TRPO | held | mean return |",
        "|---|---|---|---|---|---|",
    ]
    for row in rows:
        cells = (row["round"], row["episodes"], f"{int(row['clone']):,}", f"{int(row['steps']):,}")
        cells += (f"{float(row['held']):.0%}",)
        lines.append(f"| {' | '.join((*cells, row['return_mean']))} |")
    return "\n".join(lines)


if __name__ == "__main__":
    main()
