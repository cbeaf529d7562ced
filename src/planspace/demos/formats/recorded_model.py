"""The meaning of MuJoCo states that were recorded with the text or the name of their model."""

from dataclasses import dataclass
from pathlib import Path

from planspace.demos.state_info import StateInfo
from planspace.errors import PlanspaceError, quoted
from planspace.mjcf.compile import load_model
from planspace.mjcf.read import MAX_MODEL_BYTES, read_model
from planspace.mjcf.skeleton import refers_to_files, skeleton
from planspace.mjcf.source import ModelFile, ModelSource
from planspace.mjcf.subprocess_model import read_model_in_subprocess
from planspace.physics.space import StateSpace
from planspace.storage.checks import check_file
from planspace.storage.files import read_bytes

MODEL_FOLDERS = ("models", ".")
"""Folders next to a recording in which robosuite 1.0 keeps the models that the recording names."""
PANDA = tuple(f"robot0_joint{i}" for i in range(1, 8))
FINGERS = ("gripper0_finger_joint1", "gripper0_finger_joint2")
ROBOSUITE: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "Door": ((*PANDA, *FINGERS, "door_hinge", "latch_joint"), ()),
    "Lift": ((*PANDA, *FINGERS), ("cube_jnt0",)),
    "NutAssembly": ((*PANDA, *FINGERS), ("SquareNut0_jnt0", "RoundNut0_jnt0")),
    "PickPlace": ((*PANDA, *FINGERS), ("Milk0_jnt0", "Bread0_jnt0", "Cereal0_jnt0", "Can0_jnt0")),
    "Stack": ((*PANDA, *FINGERS), ("cubeA_jnt0", "cubeB_jnt0")),
    "Wipe": (PANDA, ()),
}
"""Hinges and slides, then free joints, of robosuite 1.0's environments with a Panda. The recordings that come
with robosuite 1.0 have the models `models/model_1.xml`, from which these names were taken."""


@dataclass(frozen=True)
class Recording:
    """What a recording says about its model."""

    model: str
    """The MJCF text of the model, or the name of its file; empty if the recording says neither."""
    file: Path
    """The file of the recording."""
    environment: str = ""
    """Name of robosuite's environment."""
    robot: str = ""
    """Name of robosuite's robot."""


@dataclass(frozen=True)
class RecordedModel:
    """The joints of a recorded model."""

    info: StateInfo
    """The meaning of its states, with the model if it compiles. The number of controls is unknown: 0."""
    notice: str = ""
    """Why the dataset has no model; empty if it has one."""


def model_states(path: Path, *, untrusted: bool = False) -> StateInfo:
    """The states of all joints of a model that the user names.

    Args:
        path: the MJCF file.
        untrusted: whether to read it in a separate process with limited memory and time.

    Raises:
        PlanspaceError: the model cannot be read or does not compile.
    """
    read = read_model_in_subprocess if untrusted else read_model
    return _info(source := read(ModelFile(path)), source)


def read_recorded_model(recording: Recording) -> RecordedModel | None:
    """Read the joints of a model, and the model itself if it compiles.

    Returns:
        The model; None if the recording does not say which model it is.

    Raises:
        PlanspaceError: the model is not MJCF, or its joints cannot be read from it.
    """
    where = f"the model of {recording.file}"
    if recording.model.lstrip().startswith("<"):
        return _read_text(recording.model, where)
    path = _find(recording)
    if path is not None:
        check_file(path, most=MAX_MODEL_BYTES)
        try:
            return RecordedModel(_info(source := read_model(ModelFile(path)), source))
        except PlanspaceError:
            try:
                text = read_bytes(path, most=MAX_MODEL_BYTES).decode()
            except UnicodeDecodeError as error:
                raise PlanspaceError(f"{path} is not a text file: {error}.") from error
            return _read_text(text, str(path))
    text = _robosuite_text(recording)
    if not text:
        return None
    missing = f"its file {quoted(recording.model)} is missing" if recording.model else "it was not recorded"
    notice = (
        f"the dataset has no model, because {missing}; the states are named as in robosuite 1.0's "
        f"{recording.environment} with a {recording.robot}."
    )
    return RecordedModel(_info(ModelSource(text), None), notice)


def _read_text(text: str, where: str) -> RecordedModel:
    missing = refers_to_files(text, where)
    if missing:
        reason = f"it refers to files that were not recorded, such as {quoted(missing)}"
    else:
        try:
            return RecordedModel(_info(source := ModelSource(text), source))
        except PlanspaceError as error:
            reason = str(error).removesuffix(".")
    try:
        info = _info(ModelSource(skeleton(text, where)), None)
    except PlanspaceError as error:
        raise PlanspaceError(f"the joints of {where} cannot be read: {error}") from error
    return RecordedModel(info, f"the dataset has no model: {reason}.")


def _info(readable: ModelSource, source: ModelSource | None) -> StateInfo:
    """Describe the states of all joints of a model; `source` is the model that the dataset gets."""
    model = load_model(readable)
    joints = tuple(model.joint(i).name for i in range(model.njnt))
    space = StateSpace.from_model(model, joints)
    return StateInfo.of_model(model, space, source=source, joints=joints if source else ())


def _find(recording: Recording) -> Path | None:
    """The file of a model that the recording names, next to the recording."""
    name = recording.model
    if not name or Path(name).name != name or "\0" in name:
        return None
    paths = (recording.file.parent / folder / name for folder in MODEL_FOLDERS)
    return next((path for path in paths if path.is_file()), None)


def _robosuite_text(recording: Recording) -> str:
    """A model with the joints of one of robosuite's environments; empty if it is not known."""
    if recording.robot != "Panda" or recording.environment not in ROBOSUITE:
        return ""
    scalar, free = ROBOSUITE[recording.environment]
    kinds = [(name, "slide" if name in FINGERS else "hinge", ' range="-1 1"') for name in scalar]
    kinds += [(name, "free", "") for name in free]
    bodies = [
        '<body><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>'
        f'<joint name="{name}" type="{kind}"{rest}/></body>'
        for name, kind, rest in kinds
    ]
    return f"<mujoco><worldbody>{''.join(bodies)}</worldbody></mujoco>"
