"""Reading model files: the main file, the files that it refers to, and which joints are held."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

import mujoco
import numpy as np

from planspace.errors import PlanspaceError, UsageError, quoted, unknown
from planspace.mjcf.compile import MUJOCO_ERRORS, compile_source, compiling, leave_out_pictures, open_spec
from planspace.mjcf.hold import (
    activated,
    hold_joints,
    joint_positions,
    joint_velocities,
    reference_positions,
)
from planspace.mjcf.model_check import MAX_ASSET_BYTES
from planspace.mjcf.references import referred_files
from planspace.mjcf.same_model import different_fields
from planspace.mjcf.source import ModelFile, ModelSource, outside
from planspace.storage.files import read_bytes

MAX_MODEL_BYTES = 16 << 20


def read_model(file: ModelFile) -> ModelSource:
    """Read a model with all files that it refers to.

    Raises:
        PlanspaceError: a file cannot be read, lies outside the root folder or does not compile (MuJoCo's
            message gives the line), or a joint cannot be held.
        UsageError: a joint or the keyframe is not in the model.
    """
    path = file.path
    root = (file.root or path.parent).absolute()
    main = os.path.relpath(path.absolute(), root).replace(os.sep, "/")
    text = read_text(path)
    files = referred_files(main, _reader(root, path, main), str(path))
    source = ModelSource(text, main, tuple(sorted(files.items())))
    try:
        model = compile_source(source)
    except MUJOCO_ERRORS as error:
        raise PlanspaceError(f"{path} does not compile: {' '.join(str(error).split())}") from error
    if files:
        _compare(path, model)
    positions = _held_positions(file, model)
    if not positions:
        return source
    return _held(path, source, positions)


def read_keyframe(
    source: ModelSource, joints: Sequence[str], keyframe: str
) -> tuple[list[float], list[float], list[float]]:
    """Read the positions and velocities of joints, and all activations and delayed controls, in a keyframe.

    Raises:
        UsageError: the model has no such keyframe.
    """
    with open_spec(replace(source, held=())) as spec:
        for number, actuator in enumerate(spec.actuators):  # to find it again after others are removed
            actuator.name = actuator.name or f"planspace_{number}"
        model = spec.compile()
        key = _find_keyframe(model, keyframe)
        if source.held:
            hold_joints(spec, dict(source.held), reference_positions(model))
        left = {actuator.name for actuator in spec.actuators}
    positions = joint_positions(model, model.key_qpos[key])
    velocities = joint_velocities(model, model.key_qvel[key])
    activations = model.key_act[key].tolist()
    owners = [model.actuator(i).name for i in activated(model)]
    return (
        [x for name in joints for x in positions[name]],
        [v for name in joints for v in velocities[name]],
        [a for name, a in zip(owners, activations, strict=True) if name in left]
        + _delayed_controls(model, key, left),
    )


def _delayed_controls(model: mujoco.MjModel, key: int, left: set[str]) -> list[float]:
    """The controls that delays hold back in a keyframe, whose control was applied all the time before."""
    delayed = [i for i in range(model.nu) if model.actuator_delay[i] > 0 and model.actuator(i).name in left]
    return [u for i in delayed for u in [float(model.key_ctrl[key, i])] * int(model.actuator_history[i, 0])]


def _find_keyframe(model: mujoco.MjModel, name: str) -> int:
    names = [model.key(i).name for i in range(model.nkey)]
    if not names:
        raise UsageError(f"the keyframe {name!r} does not exist: the model has no keyframes.")
    if name not in names:
        raise unknown("keyframe", name, names)
    return names.index(name)


def read_text(path: Path) -> str:
    """Read one file of a model as text.

    Raises:
        PlanspaceError: the file is missing, too large, or not text.
    """
    try:
        return read_bytes(path, most=MAX_MODEL_BYTES, may_be_link=True).decode()
    except UnicodeDecodeError as error:
        raise PlanspaceError(f"{path} is not a text file: {error}.") from error


def _reader(root: Path, path: Path, main: str):
    """A function that reads the files of a model below its root folder."""
    real_root = os.path.realpath(root)

    @cache
    def read(name: str) -> bytes | None:
        file = root / name
        if name != main and not Path(os.path.realpath(file)).is_relative_to(real_root):
            raise outside(name, str(path))
        return read_bytes(file, most=MAX_ASSET_BYTES, may_be_link=True) if file.exists() else None

    return read


def _compare(path: Path, model: mujoco.MjModel) -> None:
    """Check that the copied files make the same model as the user's own.

    Raises:
        PlanspaceError: a number of the model differs.
    """
    with compiling():
        spec = mujoco.MjSpec.from_file(str(path))
        leave_out_pictures(spec)
        original = spec.compile()
        original.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET  # as in `model`
        if different := different_fields(original, model):
            raise PlanspaceError(
                f"{path}: a copy of its files makes another model, which differs in {', '.join(different)}. "
                "Put all files of the model below one folder, with paths relative to it."
            )


def _held_positions(file: ModelFile, model: mujoco.MjModel) -> dict[str, tuple[float, ...]]:
    """The joints that are held and their positions."""
    path, joints, hold, pose = file.path, file.joints, file.hold, reference_positions(model)
    for name in (*(joints or ()), *(() if hold == "all" else hold)):
        if name not in pose:
            raise UsageError(f"{path}: {unknown('joint', name, pose)}")
    if file.keyframe:
        pose = joint_positions(model, model.key_qpos[_find_keyframe(model, file.keyframe)])
    left_out = [name for name in pose if joints is not None and name not in joints]
    if hold != "all":
        free = [n for n in left_out if model.joint(n).type[0] == mujoco.mjtJoint.mjJNT_FREE and n not in hold]
        if free:
            raise PlanspaceError(
                f"{path}: the free joint {free[0]!r} is not in joints, so its body would hang in the air. "
                f"Add it to joints, or write `held: [{free[0]}]` if the body is mounted."
            )
        if both := [name for name in hold if joints is not None and name in joints]:
            raise UsageError(f"{path}: the joint {both[0]!r} is in both joints and held.")
        left_out += [name for name in hold if name not in left_out]
    given = hold if isinstance(hold, Mapping) else {}
    return {name: _position(path, name, given.get(name, pose[name]), len(pose[name])) for name in left_out}


def _position(path: Path, name: str, position: Sequence[float], size: int) -> tuple[float, ...]:
    if len(position) != size or not np.isfinite(position).all():
        raise UsageError(
            f"{path}: held: the joint {name!r} has {size} position{'s' * (size > 1)}, got {quoted(position)}."
        )
    return tuple(float(x) for x in position)


def _held(path: Path, source: ModelSource, positions: dict[str, tuple[float, ...]]) -> ModelSource:
    """The source with held joints, after a check that it compiles."""
    held = ModelSource(source.text, source.main, source.files, tuple(positions.items()))
    names = ", ".join(positions)
    try:
        compile_source(held)
    except PlanspaceError as error:
        raise PlanspaceError(f"{path}: {error}") from error
    except MUJOCO_ERRORS as error:
        raise PlanspaceError(
            f"{path}: the joints {names} cannot be held: {' '.join(str(error).split())}. Add them to joints, "
            "or remove what refers to them from the model."
        ) from error
    return held
