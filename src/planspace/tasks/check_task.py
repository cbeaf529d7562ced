"""Trying a task on a small batch before it is used, so that a misfit is refused where it is handed over."""

from collections.abc import Callable

import mujoco
import numpy as np

from planspace.errors import UsageError
from planspace.physics.space import StateSpace
from planspace.tasks.task import PAGE, Task, misfit

BATCH = 3
"""Environments in the trial."""
NUMBERS, TRUTH_VALUES = "iuf", "b"
"""Kinds of NumPy types."""


def check_task(task: Task, model: mujoco.MjModel | None = None, space: StateSpace | None = None) -> None:
    """Call every function of a task once, on a batch of its own starts, and check what it returns.

    Args:
        task: the task.
        model: its compiled model; None compiles it.
        space: its state space; None reads it from the model.

    Raises:
        PlanspaceError: the model does not compile.
        UsageError: the task does not fit its model, or a function returns another shape or type than it
            should; the message names the function, what was wanted and what was returned.
    """
    if not isinstance(task, Task):
        raise UsageError(f"expected a Task, got {type(task).__name__}. See {PAGE}.")
    if model is None or space is None:
        model, space = task.compile()
    num_controls = _check_sizes(task, model, space)
    rng = np.random.default_rng(0)
    if task.draw_targets is not None:
        _try(task, "draw_targets", lambda: task.draw_targets(BATCH, rng), (BATCH, None))  # pyright: ignore
    if task.draw_starts is not None:
        _try(task, "draw_starts", lambda: task.draw_starts(BATCH, rng), (BATCH, space.size))  # pyright: ignore
    states, targets = task.sample_starts(BATCH, rng)
    control = np.zeros((BATCH, num_controls))
    obs = _try(task, "observe", lambda: task.observe(states, targets), (BATCH, len(task.obs_fields) or None))
    _try(task, "at_goal", lambda: task.at_goal(states, targets), (BATCH,), TRUTH_VALUES)
    _try(task, "terminated", lambda: task.terminated(states), (BATCH,), TRUTH_VALUES)
    for name in ("reward", "reward_2020"):
        function = getattr(task, name)
        if function is not None:
            _try(task, name, lambda f=function: f(states, states, control, targets), (BATCH,))
    if any(not 0 <= column < space.size for column in task.sin_cos_columns):
        raise misfit(
            task, "trig_columns", f"must lie between 0 and {space.size - 1}, got {task.trig_columns}"
        )
    if obs.shape[1] == 0:
        raise misfit(task, "observe", "returned observations without numbers")


def _check_sizes(task: Task, model: mujoco.MjModel, space: StateSpace) -> int:
    """Check the joints and the size of the start against the model; return the number of controls."""
    names = [model.joint(i).name for i in range(model.njnt)]
    left_out = [name or "a joint without a name" for name in names if name not in task.joints]
    if left_out:
        problem = f"leaves out {left_out[0]!r}, which the model moves: name it, or remove it from the model"
        raise misfit(task, "joints", problem)
    if len(task.start_low) != space.size:
        problem = f"has {len(task.start_low)} numbers, a state has {space.size} ({', '.join(space.names)})"
        raise misfit(task, "start_low", problem)
    if model.nu == 0:
        raise misfit(task, "model", "has no actuators, so that there is nothing to control")
    return model.nu


def _try(
    task: Task,
    name: str,
    call: Callable[[], np.ndarray],
    wanted: tuple[int | None, ...],
    kinds: str = NUMBERS,
) -> np.ndarray:
    """Call a function of a task and check the shape and type of what it returns."""
    try:
        got = call()
    except Exception as error:  # whatever the user's function raises
        raise misfit(task, name, f"failed: {type(error).__name__}: {error}") from error
    shape = "(" + ", ".join("any" if size is None else str(size) for size in wanted)
    shape += ",)" if len(wanted) == 1 else ")"
    what = "truth values" if kinds == TRUTH_VALUES else "numbers"
    if not isinstance(got, np.ndarray):
        raise misfit(task, name, f"must return an array of {what}, it returned a {type(got).__name__}")
    fits = len(got.shape) == len(wanted) and all(
        size in (None, actual) for size, actual in zip(wanted, got.shape, strict=False)
    )
    if not fits:
        raise misfit(
            task, name, f"must return shape {shape} for {BATCH} environments, it returned {got.shape}"
        )
    if got.dtype.kind not in kinds:
        raise misfit(task, name, f"must return {what}, it returned {got.dtype}")
    return got
