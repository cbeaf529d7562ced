"""Compiling models, and silencing MuJoCo's warnings."""

import contextlib
import copy
import tempfile
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import mujoco

from planspace.errors import PlanspaceError, unknown
from planspace.mjcf.hold import hold_joints, reference_positions
from planspace.mjcf.names import name_elements
from planspace.mjcf.references import referred_files
from planspace.mjcf.source import ModelSource, as_source

MUJOCO_ERRORS = (ValueError, RuntimeError, MemoryError, mujoco.FatalError, mujoco.UnexpectedError)
"""What MuJoCo raises for a model that it rejects."""

GeomPairs = tuple[tuple[str, str], ...]
"""Pairs of names of geoms or bodies."""


def load_model(source: ModelSource | str, watched: GeomPairs = ()) -> mujoco.MjModel:
    """Compile a model, with MuJoCo's silent reset of diverged states turned off.

    Args:
        source: the model's files, or the MJCF text of a model in one file.
        watched: pairs of geoms or bodies; each pair gets a contact sensor. These are the last sensors of the
            model and do not change its dynamics.

    Raises:
        PlanspaceError: a file of the model is missing, it requests too much, or MuJoCo rejects it; then the
            message quotes MuJoCo's.
    """
    try:
        return copy.copy(compile_source(as_source(source), watched))
    except MUJOCO_ERRORS as error:
        raise PlanspaceError(f"the model does not compile: {' '.join(str(error).split())}") from error


def compile_source(source: ModelSource, watched: GeomPairs = ()) -> mujoco.MjModel:
    """Compile a model as `load_model` does. The callers share the result and must not change it.

    Raises:
        PlanspaceError: a file of the model is missing, or it requests too much.
        ValueError: MuJoCo rejects it; see `MUJOCO_ERRORS` for its other exceptions.
    """
    return _compiled(source, watched)


@lru_cache(maxsize=4)
def _compiled(source: ModelSource, watched: GeomPairs) -> mujoco.MjModel:
    with open_spec(source) as spec:
        _watch(spec, watched)
        model = spec.compile()
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
    _limit_muscles(model)
    return model


def _limit_muscles(model: mujoco.MjModel) -> None:
    """Give muscles without a control range the range 0 to 1, to which their dynamics clip the control."""
    unlimited = (model.actuator_dyntype == int(mujoco.mjtDyn.mjDYN_MUSCLE)) & (
        model.actuator_ctrllimited == 0
    )
    model.actuator_ctrlrange[unlimited] = [0.0, 1.0]
    model.actuator_ctrllimited[unlimited] = 1


@contextmanager
def open_spec(source: ModelSource) -> Iterator[mujoco.MjSpec]:
    """Read a model as MuJoCo's editable specification, with its joints held and all elements named.

    Args:
        source: the model's files.

    Yields:
        The specification, to be compiled inside the block.

    Raises:
        PlanspaceError: a file of the model is missing, or it requests too much.
        ValueError: MuJoCo cannot read it.
    """
    referred_files(source.main, source.contents.get, "the model")  # checks what MuJoCo will read
    with read_spec(source) as spec:
        name_elements(spec)
        if source.held:
            reference = reference_positions(compile_source(replace(source, held=())))
            hold_joints(spec, dict(source.held), reference)
        yield spec


@contextmanager
def read_spec(source: ModelSource) -> Iterator[mujoco.MjSpec]:
    """Read a model as MuJoCo's editable specification; pictures are replaced by a plain colour."""
    with compiling(), contextlib.ExitStack() as stack:
        if source.files:
            folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="planspace-model-")))
            source.write(folder)
            spec = mujoco.MjSpec.from_file(str(folder / source.main))
        else:
            spec = mujoco.MjSpec.from_string(source.text)
        leave_out_pictures(spec)
        yield spec


def leave_out_pictures(spec: mujoco.MjSpec) -> None:
    """Replace textures from files by a plain colour; they do not change the dynamics."""
    for texture in [t for t in spec.textures if t.file or any(t.cubefiles)]:
        texture.file, texture.cubefiles = "", [""] * 6
        texture.builtin, texture.width, texture.height = mujoco.mjtBuiltin.mjBUILTIN_FLAT, 8, 8
        texture.rgb1 = texture.rgb2 = [0.8, 0.8, 0.8]


def _watch(spec: mujoco.MjSpec, pairs: GeomPairs) -> None:
    for number, pair in enumerate(pairs):
        sensor = spec.add_sensor(name=f"planspace_watch_{number}", type=mujoco.mjtSensor.mjSENS_CONTACT)
        watch_pair(spec, sensor, pair)
        sensor.intprm = [1, 0, 1]  # data: found; no reduction; one contact


def watch_pair(spec: mujoco.MjSpec, sensor: mujoco.MjsSensor, pair: tuple[str, str]) -> None:
    """Point a sensor at two geoms or bodies.

    Raises:
        UsageError: the model has no geom and no body of a name.
    """
    kinds = {body.name: mujoco.mjtObj.mjOBJ_BODY for body in spec.bodies if body.name}
    kinds |= {geom.name: mujoco.mjtObj.mjOBJ_GEOM for geom in spec.geoms if geom.name}
    for name in pair:
        if name not in kinds:
            raise unknown("geom or body", name, kinds)
    sensor.objtype, sensor.objname = kinds[pair[0]], pair[0]
    sensor.reftype, sensor.refname = kinds[pair[1]], pair[1]


@contextmanager
def stepping() -> Iterator[None]:
    """Silence MuJoCo inside the block and turn its failures into our error.

    Raises:
        PlanspaceError: MuJoCo has too little memory for the model, or fails for another reason.
    """
    with silenced():
        try:
            yield
        except (RuntimeError, MemoryError, mujoco.FatalError) as error:
            raise PlanspaceError(
                f"MuJoCo cannot simulate the model: {' '.join(str(error).split())}"
            ) from error


@contextmanager
def compiling() -> Iterator[None]:
    """Silence MuJoCo inside the block, also the warnings of its compiler, which are Python warnings."""
    with silenced(), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


@contextmanager
def silenced() -> Iterator[None]:
    """Make MuJoCo count its warnings without printing them: diverging physics would fill the disk."""
    before, silent = mujoco.MjLogConfig.get(), mujoco.MjLogConfig.get()
    silent.logto_console = silent.logto_file = False
    silent.set()
    try:
        yield
    finally:
        before.set()
