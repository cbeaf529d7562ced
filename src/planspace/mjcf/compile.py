"""Compiling MJCF text, and keeping MuJoCo's warnings off the disk and the terminal."""

import warnings
from collections.abc import Iterator
from contextlib import contextmanager

import mujoco

from planspace.errors import PlanspaceError, unknown
from planspace.mjcf.model_check import check_self_contained

MUJOCO_ERRORS = (ValueError, RuntimeError, MemoryError, mujoco.FatalError, mujoco.UnexpectedError)
"""What MuJoCo raises at a model that it does not take."""

GeomPairs = tuple[tuple[str, str], ...]
"""Pairs of geom names."""


def load_model(xml: str, watched: GeomPairs = ()) -> mujoco.MjModel:
    """Compiles an MJCF text which is whole, with MuJoCo's silent reset of diverged states switched off.

    Args:
        xml: the model.
        watched: pairs of geoms whose contact is to be watched: each gets a contact sensor, the last ones of
            the model, which does not change its dynamics.

    Raises:
        PlanspaceError: it refers to files, asks for too much, or MuJoCo does not accept it; the message is
            then MuJoCo's.
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
    """As `quiet`; where MuJoCo cannot go on, that is an error of ours.

    Raises:
        PlanspaceError: it has not enough memory for the model, or gives up for another reason.
    """
    with quiet():
        try:
            yield
        except (RuntimeError, MemoryError, mujoco.FatalError) as error:
            raise PlanspaceError(
                f"MuJoCo cannot simulate the model: {' '.join(str(error).split())}"
            ) from error


@contextmanager
def compiling() -> Iterator[None]:
    """As `quiet`; MuJoCo's compiler warns by way of Python, too, in lines that quote the model's names."""
    with quiet(), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


@contextmanager
def quiet() -> Iterator[None]:
    """What MuJoCo warns of is counted, and printed nowhere: physics that run away would fill the disk."""
    before, silent = mujoco.MjLogConfig.get(), mujoco.MjLogConfig.get()
    silent.logto_console = silent.logto_file = False
    silent.set()
    try:
        yield
    finally:
        before.set()
