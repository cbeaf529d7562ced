from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planspace.cli import main
from planspace.demos.dataset import Demos
from planspace.demos.search_tree import SearchTree
from planspace.embed.embedding import Embedding
from planspace.envs.batch import TaskBatch
from planspace.envs.episodes import TaskEpisodes
from planspace.envs.plan_starts import PlanStarts
from planspace.envs.task import TaskEnv
from planspace.errors import PlanspaceError, UsageError
from planspace.rl import arm, evaluation
from planspace.rl.algorithms.trpo import TRPO
from planspace.rl.config import TrainConfig
from planspace.rl.observe import Observer
from planspace.rl.plans import Plans
from planspace.rl.rollout import Rollout, collect
from planspace.rl.training import train_policies
from planspace.seams import plain_settings
from planspace.tasks.catalog import TASKS
from planspace.tasks.task import Task

from .reaches import reaches

TASK = "cartpole-swingup"
QUICK = TrainConfig(num_seeds=1, steps=800, batch_steps=400, resets=0.5)


class Replaying(TRPO):
    """TRPO that says that it has a replay buffer."""

    replays = True


def plans_of(config: TrainConfig, demos: Demos, task: str = TASK) -> Plans:
    found = Plans.of(config, Observer(TASKS[task], config.obs, "none", "both"), demos)
    assert found is not None
    return found


def recorder(rollouts: list[Rollout]) -> Any:
    """`collect` that also appends its rollout to a list."""

    def recorded(*args: Any, **kwargs: Any) -> Rollout:
        rollouts.append(collect(*args, **kwargs))
        return rollouts[-1]

    return recorded


def starts_of(rollouts: list[Rollout]) -> np.ndarray:
    return np.concatenate([rollout.obs[rollout.step == 0] for rollout in rollouts])


@pytest.mark.slow
def test_training_starts_at_plans_and_evaluation_does_not(
    demos: Demos, monkeypatch: pytest.MonkeyPatch
) -> None:
    played: dict[Any, list[Rollout]] = {arm: [], evaluation: []}
    for module, rollouts in played.items():
        monkeypatch.setattr(module, "collect", recorder(rollouts))
    # `cartpole` ends an episode beyond 0.2 rad, so that episodes also start within an iteration
    train_policies("cartpole", replace(QUICK, resets=1.0), plans=demos)
    known = demos.states.astype(np.float32)
    known = known[np.abs(known[:, 1]) <= 0.2]
    starts = starts_of(played[arm])
    assert len(starts) > 8 and (starts[:, None] == known).all(axis=2).any(axis=1).all()
    assert len(np.unique(starts, axis=0)) > 4
    assert (np.abs(starts_of(played[evaluation])) <= 0.01).all()


def test_half_of_the_starts_are_from_plans_and_the_others_as_without_plans(demos: Demos) -> None:
    own = TaskEpisodes(TASKS[TASK], 400)
    own.reset([np.random.default_rng(0)])
    usual = own.states.copy()
    plans_of(QUICK, demos).episodes(own).reset([np.random.default_rng(0)])
    changed = (own.states != usual).any(axis=1)
    assert 150 < changed.sum() < 250
    assert (own.states[changed][:, None] == demos.states).all(axis=2).any(axis=1).all()


@pytest.mark.slow
def test_a_seed_does_not_depend_on_the_others(demos: Demos) -> None:
    together = train_policies(TASK, replace(QUICK, num_seeds=3), plans=demos).history
    alone = train_policies(TASK, replace(QUICK, seed=1), plans=demos).history
    for name in ("return", "eval_return", "kl"):
        np.testing.assert_array_equal(together[name][:, 1], alone[name][:, 0])
    without = train_policies(TASK, replace(QUICK, seed=1, resets=0.0)).history
    assert (without["return"] != alone["return"]).any()


def drawn_at(plans: Plans, done: float) -> np.ndarray:
    """Starts when this fraction of training is done."""
    started = plans.episodes(TaskEpisodes(TASKS[TASK], 300))
    assert isinstance(started, PlanStarts)
    moved = started.at(done)
    moved.reset([np.random.default_rng(0)])
    return moved.states


def test_a_reverse_curriculum_moves_from_the_ends_of_plans_to_their_starts(demos: Demos) -> None:
    config = replace(QUICK, resets=1.0, reset_schedule="reverse")
    plans, durations = plans_of(config, demos), demos.times[demos.offsets[1:] - 1]
    left = 1.0 - demos.times / np.repeat(durations, np.diff(demos.offsets))
    for done, part in ((0.0, 0.1), (0.25, 0.55), (0.5, 1.0), (0.9, 1.0)):
        starts = drawn_at(plans, done)
        rows = (starts[:, None] == demos.states).all(axis=2).argmax(axis=1)
        np.testing.assert_array_equal(starts, demos.states[rows])
        assert 0.9 * part < left[rows].max() <= part + 1e-9


def test_training_moves_the_curriculum(demos: Demos, monkeypatch: pytest.MonkeyPatch) -> None:
    moved, at = [], PlanStarts.at
    monkeypatch.setattr(PlanStarts, "at", lambda self, done: (moved.append(done), at(self, done))[1])
    train_policies(TASK, replace(QUICK, reset_schedule="reverse"), plans=demos)
    assert moved == [0.0, 0.5]


def test_starts_are_drawn_from_search_trees_and_from_both(demos: Demos) -> None:
    nodes = [demos.episode(i).states[:3] + 0.01 for i in range(len(demos))]
    trees = tuple(SearchTree(x, np.array([-1, 0, 0]), np.array([0.0, 0.1, 0.1])) for x in nodes)
    grown, fraction = replace(demos, trees=trees), {}
    for states in ("plans", "trees", "both"):
        starts = drawn_at(plans_of(replace(QUICK, resets=1.0, reset_states=states), grown), 0.0)
        from_trees = (starts[:, None] == np.concatenate(nodes)).all(axis=2).any(axis=1)
        from_plans = (starts[:, None] == demos.states).all(axis=2).any(axis=1)
        assert (from_trees ^ from_plans).all()
        fraction[states] = from_trees.mean()
    assert fraction["plans"] == 0 and fraction["trees"] == 1 and 0.4 < fraction["both"] < 0.6
    with pytest.raises(UsageError, match="--reset-states trees needs search trees, but these plans have"):
        plans_of(replace(QUICK, reset_states="trees"), demos)


def test_without_resets_the_environments_are_those_of_earlier_versions(demos: Demos) -> None:
    own = TaskEpisodes(TASKS[TASK], 2)
    config = replace(QUICK, algorithm=Replaying(), resets=0.0, replay=0.5)
    assert plans_of(config, demos).episodes(own) is own
    assert plans_of(QUICK, demos).transitions() is None


@pytest.mark.parametrize("reward", ["dense", "sparse"])
def test_transitions_are_steps_of_the_task(demos: Demos, reward: Any) -> None:
    config = TrainConfig(Replaying(), obs="trig", reward=reward, replay=0.5)
    found = plans_of(config, demos).transitions()
    assert found is not None
    env, row = TaskEnv(TASK, obs="trig", reward=reward), 0
    for i in range(len(demos)):
        plan = demos.episode(i)
        for k in range(len(plan.controls) - 1):  # a step of the task lasts two of the plan
            if k in (0, len(plan.controls) - 2):
                obs, _ = env.reset(options={"state": plan.states[k]})
                np.testing.assert_array_equal(found.obs[row], obs)
                mean = plan.controls[k : k + 2].mean(axis=0)
                np.testing.assert_allclose(found.actions[row], mean, rtol=1e-5, atol=1e-6)
                obs, paid, terminated, _, _ = env.step(found.actions[row])
                np.testing.assert_array_equal(found.next_obs[row], obs)
                assert (found.rewards[row], found.terminated[row]) == (paid, terminated)
            row += 1
    assert row == len(found.obs)


def test_the_target_of_a_transition_is_the_goal_of_its_plan(monkeypatch: pytest.MonkeyPatch) -> None:
    task, plans = reaches()
    _ = task.space
    compiled, calls = Task.compile, []
    monkeypatch.setattr(Task, "compile", lambda self: (calls.append(self), compiled(self))[1])
    config = TrainConfig(Replaying(), replay=0.5)
    found = Plans.of(config, Observer(task, "raw", "none", "both"), plans)
    assert found is not None
    steps = found.transitions()
    assert steps is not None and len(steps.rewards) == 15 and len(calls) == 1
    goals = plans.goals.copy()
    goals[1] = plans.episode(1).states[-1]
    expected = np.repeat(goals[:, :2], 5, axis=0)  # the last two numbers of an observation are the goal
    np.testing.assert_allclose(steps.obs[:, -2:], expected, atol=1e-6)
    batch = TaskBatch(task, 15)
    batch.reset(np.concatenate([plans.episode(i).states[:-1] for i in range(3)]), np.repeat(goals, 5, axis=0))
    np.testing.assert_allclose(steps.rewards, batch.step(steps.actions)[0], atol=1e-6)


def test_steps_from_where_an_episode_would_have_ended_are_left_out(demos: Demos) -> None:
    config = TrainConfig(Replaying(), replay=0.5)
    found = plans_of(config, demos, "cartpole").transitions()
    assert found is not None
    assert (np.abs(found.obs[:, 1]) <= 0.2).all() and found.terminated.any()


def test_a_run_is_continued_only_with_the_same_plans(demos: Demos, tmp_path: Path) -> None:
    first = train_policies(TASK, QUICK, plans=demos, out=tmp_path).history
    again = train_policies(TASK, QUICK, plans=demos, out=tmp_path).history
    np.testing.assert_array_equal(first["return"], again["return"])
    fewer = Demos.from_episodes(demos.info, [demos.episode(0)])
    with pytest.raises(PlanspaceError, match="settings: plans has changed"):
        train_policies(TASK, QUICK, plans=fewer, out=tmp_path)
    with pytest.raises(PlanspaceError, match="resets was 0.5, now 0.25"):
        train_policies(TASK, replace(QUICK, resets=0.25), plans=demos, out=tmp_path)


def test_settings_without_plans_are_saved_as_in_earlier_versions() -> None:
    saved = plain_settings(TrainConfig())
    assert "replay" not in saved and "resets" not in saved
    assert plain_settings(QUICK)["resets"] == 0.5


@pytest.mark.parametrize("name", ["resets", "replay"])
@pytest.mark.parametrize("fraction", [-0.1, 1.1, float("nan")])
def test_a_fraction_outside_0_to_1_is_refused(name: str, fraction: float) -> None:
    with pytest.raises(UsageError, match=f"`{name}` must be between 0 and 1"):
        TrainConfig(**{name: fraction})


REPLAY = replace(QUICK, algorithm=Replaying(), resets=0.0, replay=0.5)
REFUSED: dict[str, tuple[str, TrainConfig, str]] = {
    "no buffer": (TASK, replace(QUICK, replay=0.5), "--replay 0.5 needs an algorithm with a replay buffer"),
    "unused": (TASK, replace(QUICK, resets=0.0), "plans were given, but nothing uses them"),
    "joints": ("pendulum-swingup", QUICK, r"the plans have the states \(slider, hinge, .* the same joints"),
    "gymnasium": ("gym:Pendulum-v1", QUICK, "which gym:Pendulum-v1 does not allow: leave it out"),
    "shaping": (TASK, replace(REPLAY, shaping="raw"), "leave out --shaping, or use --resets"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_does_not_fit_is_refused(case: str, demos: Demos) -> None:
    task, config, message = REFUSED[case]
    with pytest.raises(UsageError, match=message):
        train_policies(task, config, plans=demos)


def test_plans_that_lack_something_are_refused(demos: Demos, embedding: Embedding) -> None:
    assert demos.info.source is not None
    heavier = replace(demos.info.source, text=demos.info.source.text.replace('mass="', 'mass="1'))
    with pytest.raises(UsageError, match="made with another model than that of cartpole-swingup"):
        train_policies(TASK, QUICK, plans=replace(demos, info=replace(demos.info, source=heavier)))
    with pytest.raises(UsageError, match="needs the controls of the plans, but they have none"):
        train_policies(TASK, REPLAY, plans=replace(demos, controls=np.zeros_like(demos.controls)))
    with pytest.raises(UsageError, match="ends an episode at every state of the plans"):
        fallen = replace(demos, states=np.full_like(demos.states, 1.0))
        train_policies("cartpole", QUICK, plans=fallen)
    with pytest.raises(UsageError, match="needs one embedding for all seeds, got 2"):
        config = replace(REPLAY, z="augment", num_seeds=2)
        train_policies(TASK, config, plans=demos, embedding=[embedding, embedding])
    with pytest.raises(UsageError, match="--resets needs plans: give --plans DIR"):
        train_policies(TASK, QUICK)


def test_the_command_line_takes_plans(
    demo_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = ["train", "pendulum-swingup", "--out", str(tmp_path), "--plans", str(demo_folder)]
    assert main([*run, "--resets", "0.5"]) == 2
    assert "give plans of the same joints" in capsys.readouterr().err
    assert main([*run, "--resets", "2"]) == 2
    assert "must be between 0 and 1, got 2.0" in capsys.readouterr().err
