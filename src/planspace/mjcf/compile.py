"""Compiling MJCF text, and silencing MuJoCo's warnings."""

import warnings
from collections.abc import Iterator
from contextlib import contextmanager

import mujoco

from planspace.errors import PlanspaceError, unknown
from planspace.mjcf.model_check import check_self_contained

MUJOCO_ERRORS = (ValueError, RuntimeError, MemoryError, mujoco.FatalError, mujoco.UnexpectedError)
"""What MuJoCo raises for a model that it rejects."""

GeomPairs = tuple[tuple[str, str], ...]
"""Pairs of geom names."""


def load_model(xml: str, watched: GeomPairs = ()) -> mujoco.MjModel:
    """Compile a self-contained MJCF text, with MuJoCo's silent reset of diverged states turned off.

    Args:
        xml: the model.
        watched: pairs of geoms; each pair gets a contact sensor. These are the last sensors of the model and
            do not change its dynamics.

    Raises:
        PlanspaceError: the model refers to files, requests too much, or MuJoCo rejects it; then the message
            quotes MuJoCo's.
    """
    check_self_contained(xml)
    try:
        with compiling():
            if not watched:
                model = mujoco.MjModel.from_xml_string(xml)
            else:
                spec = mujoco.MjSpec.from_string(xml)
                _watch(spec, watched)
                model = spec.compile()
    except MUJOCO_ERRORS as error:
        raise PlanspaceError(f"the model does not compile: {' '.join(str(error).split())}") from error
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
    return model


def _watch(spec: mujoco.MjSpec, pairs: GeomPairs) -> None:
    names = [geom.name for geom in spec.geoms if geom.name]
    geom, found_once = mujoco.mjtObj.mjOBJ_GEOM, [1, 0, 1]  # data: found; no reduction; one contact
    for number, pair in enumerate(pairs):
        for name in pair:
            if name not in names:
                raise unknown("geom", name, names)
        sensor = spec.add_sensor(name=f"planspace_watch_{number}", type=mujoco.mjtSensor.mjSENS_CONTACT)
        sensor.objtype, sensor.objname, sensor.reftype, sensor.refname = geom, pair[0], geom, pair[1]
        sensor.intprm = found_once


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
