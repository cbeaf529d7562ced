"""Return of the best known controller on the swing-up, from the starts of evaluations.

    python benchmarks/swingup_ceiling.py [RUN ...]

It runs a planned swing-up from each of the 20 starts, and every policy of the given runs (folders of
`planspace train`, or `DIR/work/policies-*` of a study). The plan is from SST and polished; then the regulator
holds the goal. Its control can change at every physics step, unlike a policy's. The output is the mean return
of the planner and of the best policy, and the ceiling: the mean of the best return from each start.
"""

import argparse
from pathlib import Path

import mujoco
import numpy as np

from planspace.embed.saved_embedding import load_embedding
from planspace.envs.batch import TaskBatch
from planspace.physics.replay import advance
from planspace.plan.config import PlanConfig
from planspace.plan.pipeline import Pipeline
from planspace.plan.planner import Failure
from planspace.plan.regulator import Regulator
from planspace.progress import progress
from planspace.rl.config import BATCH_STEPS
from planspace.rl.evaluation import EVALUATION_SEED
from planspace.rl.saved_policy import Policy, load_policy
from planspace.rl.training import num_episodes
from planspace.tasks.catalog import find_task
from planspace.tasks.problem_file import load_problem

TASK = find_task("cartpole-swingup")
STARTS, TARGETS = TASK.sample_starts(num_episodes(TASK, BATCH_STEPS), np.random.default_rng(EVALUATION_SEED))


def planned() -> np.ndarray:
    """Return of a planned swing-up from each start."""
    problem = load_problem(TASK.problem)
    config = PlanConfig.for_problem(problem, restarts=4)
    planner, returns = Pipeline(problem, config), []
    with progress("plan", len(STARTS), unit="start") as bar:
        for i, start in enumerate(STARTS):
            rng = np.random.default_rng(i)
            goal = problem.draw_goal(planner.space, rng)
            found = planner.connect(start, goal, rng)
            if isinstance(found, Failure):
                raise SystemExit(f"no plan from start {i}: {found.reason}")
            regulator = Regulator(planner.simulator, goal, planner.weights, config.regulator)
            returns.append(followed(planner, regulator, start, found.controls))
            bar.update()
    return np.array(returns)


def followed(planner: Pipeline, regulator: Regulator, start: np.ndarray, controls: np.ndarray) -> float:
    """Return of a plan, followed by the regulator until the episode ends."""
    data, state, total = mujoco.MjData(planner.model), start, 0.0
    planner.space.write(start, data.qpos, data.qvel, data.act)
    for step in range(TASK.horizon):
        efforts = []
        for k in range(step * TASK.frame_skip, (step + 1) * TASK.frame_skip):
            control = controls[k] if k < len(controls) else regulator.control(state)
            efforts.append(control**2)
            state = advance(planner.model, data, planner.space, control)
        effort = np.sqrt(np.mean(efforts, axis=0))[None]  # so that its square is their mean square
        total += float(TASK.reward(state[None], state[None], effort, np.empty((1, 0)))[0])
    return total


def played(policy: Policy) -> np.ndarray:
    """Return of a policy from each start; each action is the mean."""
    batch, about = TaskBatch(TASK, len(STARTS)), policy.about
    embedding = load_embedding(policy.embedding) if about["embeddings"] else None
    batch.reset(STARTS, TARGETS)
    total = np.zeros(len(STARTS))
    for _ in range(TASK.horizon):
        obs = TASK.observe_as(about["obs"], batch.states, batch.targets)
        if embedding is not None and about["z"] != "none":
            z = embedding.encode(batch.states)
            obs = z if about["z"] == "replace" else np.concatenate([obs, z], axis=1)
        reward, _, _ = batch.step(policy(obs.astype(np.float32)))
        total += reward
    return total


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("runs", nargs="*", type=Path, metavar="RUN")
    runs = parser.parse_args().runs
    plans = planned()
    policies = [load_policy(run, seed) for run in runs for seed in load_policy(run).about["seeds"]]
    returns = np.array([played(policy) for policy in policies]).reshape(-1, len(STARTS))
    print(
        "command: python benchmarks/swingup_ceiling.py", " ".join(map(str, runs[:1])), "..." * (len(runs) > 1)
    )
    print(f"planned swing-ups: mean {plans.mean():.1f}, worst {plans.min():.1f}, best {plans.max():.1f}")
    if len(returns):
        best = returns.mean(axis=1).argmax()
        print(f"best of {len(returns)} policies: {returns[best].mean():.1f} ({policies[best].run.name})")
    ceiling = np.concatenate([plans[None], returns]).max(axis=0)
    print(f"best known from each of {len(STARTS)} starts: mean {ceiling.mean():.1f}")


if __name__ == "__main__":
    main()
