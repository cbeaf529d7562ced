"""Training and test stacks: pictures that end in a known state."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int, UInt8

from planspace.demos.dataset import Demos
from planspace.demos.resample import resample
from planspace.embed.pixels.config import ImageFitConfig
from planspace.errors import PlanspaceError, check_setting
from planspace.physics.pictures import PictureConfig, Pictures, stacked
from planspace.physics.simulator import Simulator
from planspace.progress import progress
from planspace.tasks.catalog import find_task, task_names

BLOCK = 256
"""Stacks that are simulated together."""
MOST_TRIES = 20
"""Blocks without a valid stack, in a row, before it is an error."""
STEP_TOLERANCE = 1e-6


@dataclass(frozen=True)
class Stacks:
    """Stacks of pictures, and the state in which each ends."""

    images: UInt8[np.ndarray, "stack height width channel"]
    states: Float[np.ndarray, "stack state"]


def default_frame_s(demos: Demos) -> float:
    """The control step of the task of these demonstrations; without a task, their own time step."""
    if demos.info.problem in task_names():
        task = find_task(demos.info.problem)
        return task.frame_skip * float(task.compile()[0].opt.timestep)
    steps = np.diff(demos.times)
    return float(np.median(steps[steps > 0]))


def check_pictures(demos: Demos, config: PictureConfig, frame_s: float) -> None:
    """Check that pictures of a model can be drawn, before anything is written.

    Args:
        demos: demonstrations of the model.
        config: the pictures.
        frame_s: time between two frames [s].

    Raises:
        UsageError: `frame_s` is not a multiple of the model's time step, or longer than any demonstration; or
            the camera does not exist.
        PlanspaceError: nothing can be drawn here.
    """
    model, space = demos.info.compile()
    step, longest = float(model.opt.timestep), float(demos.times[demos.offsets[1:] - 1].max())
    wanted = (
        f"a multiple of the model's time step of {step:g} s, and at most a demonstration of {longest:g} s"
    )
    fits = step / 2 < frame_s <= longest and abs(round(frame_s / step) * step - frame_s) <= STEP_TOLERANCE
    check_setting("frame_s", frame_s, fits, wanted)
    Pictures(model, space, config).close()


def draw_stacks(
    sources: Sequence[tuple[Demos, Float[np.ndarray, "row state"]]],
    config: ImageFitConfig,
    frame_s: float,
    seed: int,
    stream: int = 0,
) -> Stacks:
    """Simulate short motions from drawn states, and draw them.

    A motion starts in a state of the sources, half of them moved at random, and takes `frames - 1` steps with
    random controls. So its last state is not exactly on a plan, and all velocities can be seen.

    Args:
        sources: demonstrations of one model, and the states of theirs to start from; equally often from each.
        config: the settings.
        frame_s: time between two frames [s].
        seed: seed of everything that is drawn.
        stream: stacks of another stream are drawn independently with the same seed.

    Raises:
        PlanspaceError: nearly all motions leave the model's bounds, or nothing can be drawn here.
    """
    rng, view = np.random.default_rng((seed, stream)), config.pictures
    model, space = sources[0][0].info.compile()
    simulator = Simulator(model, space, BLOCK)
    limits = _control_limits(simulator, [demos for demos, _ in sources])
    pictures = Pictures(model, space, view)
    images = np.empty((config.stacks, *view.stack_shape), dtype=np.uint8)
    found, tries = np.empty((config.stacks, space.size)), 0
    num = 0
    with progress("render", config.stacks, unit="stack") as bar:
        while num < config.stacks:
            starts = np.concatenate([_starts(s, config, rng) for _, s in sources])
            paths, valid = _simulate(simulator, rng.permutation(starts)[:BLOCK], view, frame_s, limits, rng)
            tries = 0 if valid.any() else tries + 1
            if tries > MOST_TRIES:
                raise PlanspaceError("nearly all motions leave the bounds of the model: lower --noise.")
            for path in paths[valid][: config.stacks - num]:
                images[num] = _stack(pictures, path, config, rng)
                found[num] = path[-1]
                num += 1
                bar.update()
    pictures.close()
    return Stacks(images, found)


def stacks_of_plans(
    demos: Demos, episodes: Int[np.ndarray, " demo"], config: PictureConfig, frame_s: float
) -> tuple[Demos, Stacks]:
    """Draw plans as an agent would see them: every control step, and the first picture repeated at the start.

    Args:
        demos: the plans.
        episodes: which of them.
        config: the pictures.
        frame_s: time between two frames [s].

    Returns:
        The plans, resampled to the frames, and a stack for each of their states.

    Raises:
        PlanspaceError: nothing can be drawn here.
    """
    info = demos.info
    resampled = Demos.from_episodes(info, [resample(demos.episode(int(i)), info, frame_s) for i in episodes])
    shown = resampled.render_states(None, config)
    images = np.empty((len(shown), *config.stack_shape), dtype=np.uint8)
    for first, end in zip(resampled.offsets[:-1], resampled.offsets[1:], strict=True):
        for row in range(first, end):
            rows = np.maximum(np.arange(row - config.frames + 1, row + 1), first)
            images[row] = stacked(shown[rows])
    return resampled, Stacks(images, resampled.states)


def _starts(states: np.ndarray, config: ImageFitConfig, rng: np.random.Generator) -> np.ndarray:
    """Drawn states, some of them moved; noise on a quaternion is removed by the state space."""
    drawn = states[rng.integers(len(states), size=BLOCK)].copy()
    moved = rng.random(BLOCK) < config.noisy_fraction
    noise = config.noise * states.std(axis=0) * rng.standard_normal(drawn.shape)
    return drawn + moved[:, None] * noise


def _control_limits(simulator: Simulator, recorded: Sequence[Demos]) -> tuple[np.ndarray, np.ndarray]:
    """The limits of each control; where the model has none, those of the recorded controls."""
    controls = np.concatenate([demos.controls for demos in recorded])
    low, high = simulator.control_low, simulator.control_high
    low = np.where(np.isfinite(low), low, controls.min(axis=0))
    return low, np.where(np.isfinite(high), high, controls.max(axis=0))


def _simulate(
    simulator: Simulator,
    starts: np.ndarray,
    view: PictureConfig,
    frame_s: float,
    limits: tuple[np.ndarray, np.ndarray],
    rng: np.random.Generator,
) -> tuple[np.ndarray, np.ndarray]:
    """Paths [motion, frame, state] with random controls, and whether each stays within the bounds."""
    num_steps = round(frame_s / float(simulator.model.opt.timestep))
    low, high = limits
    simulator.reset(simulator.space.normalise(starts))
    path = [simulator.states()]
    valid = simulator.allowed(len(starts))
    for _ in range(view.frames - 1):
        simulator.step(rng.uniform(low, high, (len(starts), len(low))), num_steps)
        path.append(simulator.states())
        valid &= simulator.allowed(len(starts))
    return np.stack(path, axis=1), valid & ~simulator.diverged()


def _stack(
    pictures: Pictures, path: np.ndarray, config: ImageFitConfig, rng: np.random.Generator
) -> UInt8[np.ndarray, "height width channel"]:
    """The pictures of a path in one look; in some stacks the earlier ones repeat a later one."""
    frames = np.arange(len(path))
    if len(path) > 1 and rng.random() < config.start_fraction:
        frames = np.maximum(frames, rng.integers(1, len(path)))
    return stacked(pictures.of_states(path[frames], pictures.draw_look(rng)))
