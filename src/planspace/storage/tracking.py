"""Curves for TensorBoard and Weights & Biases (extra `track`).

TensorBoard only needs the package `tensorboard`, neither TensorFlow nor PyTorch. Weights & Biases never
prompts for a login: without credentials it runs offline, and `wandb sync` uploads the run later.
"""

import contextlib
import netrc
import os
import secrets
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO, Literal

from planspace.errors import PlanspaceError, install_command
from planspace.storage.files import make_folder, read_bytes, write_bytes

TrackerName = Literal["tensorboard", "wandb"]
AddScalars = Callable[[int, Mapping[str, float]], None]
"""Function that writes named values of one step."""

FILE_VERSION = "brain.Event:2"
"""The format version, at the beginning of every event file."""


class Tracker:
    """Writes the scalars of a run to disk immediately, so that a crash loses none; see `open_tracker`.

    A run that is tracked again in the same folder is continued. TensorBoard then discards the scalars of the
    interrupted run from the first new step on.
    """

    def __init__(self, path: Path, file: BinaryIO, events: Any, record_writer: Any):
        """Use an open file.

        Args:
            path: the file's path, for messages.
            file: an open, empty file.
            events: the module `tensorboard.compat.proto.event_pb2`.
            record_writer: the class that frames and checks each event.
        """
        self._path, self._events, self._records = path, events, record_writer(file)
        self._started = False

    def add(self, step: int, scalars: Mapping[str, float]) -> None:
        """Write the values of one step.

        Args:
            step: step of the optimiser or the environment.
            scalars: values by name; the part of a name before `/` is its group.

        Raises:
            PlanspaceError: the file cannot be written.
        """
        if not self._started:
            self._write(file_version=FILE_VERSION)
            self._write(step=step, session_log={"status": self._events.SessionLog.START})
            self._started = True
        values = [{"tag": name, "simple_value": value} for name, value in scalars.items()]
        self._write(step=step, summary={"value": values})

    def close(self) -> None:
        """Close the file; nothing can be added afterwards."""
        with contextlib.suppress(OSError):  # `add` has reported failed writes
            self._records.close()

    def __enter__(self) -> "Tracker":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, where: TracebackType | None
    ) -> None:
        self.close()

    def _write(self, **event: Any) -> None:
        data = self._events.Event(wall_time=time.time(), **event).SerializeToString()
        try:
            self._records.write(data)
            self._records.flush()
        except OSError as error:
            raise PlanspaceError(f"cannot write {self._path}: {error.strerror}.") from error


def open_tracker(folder: Path) -> Tracker:
    """Open a run's folder for `tensorboard --logdir`, to start the run or to continue it.

    Raises:
        PlanspaceError: the package `tensorboard` is missing, or the folder cannot be written.
    """
    try:
        from tensorboard.compat.proto import event_pb2
        from tensorboard.summary.writer.record_writer import RecordWriter
    except ImportError as error:
        raise PlanspaceError(
            f"curves for TensorBoard need the package tensorboard: {install_command('track')}."
        ) from error
    # TensorBoard reads the files of a folder in the order of their names
    path = make_folder(folder) / f"events.out.tfevents.{time.time_ns()}.{os.getpid()}"
    return Tracker(path, open(path, "xb"), event_pb2, RecordWriter)


class WandbTracker:
    """Sends the scalars of a run to Weights & Biases, or stores them locally; see `open_wandb`."""

    def __init__(self, run: Any):
        """Use a run that `wandb.init` returned."""
        self._run = run

    def add(self, step: int, scalars: Mapping[str, float]) -> None:
        """Write the values of one step; Weights & Biases ignores steps that it already has."""
        self._run.log(dict(scalars), step=step)

    def close(self) -> None:
        """Finish the run."""
        self._run.finish()


def open_wandb(folder: Path) -> WandbTracker:
    """Start or continue the run of a folder.

    Raises:
        PlanspaceError: the package `wandb` is missing, or the folder cannot be written.
    """
    try:
        import wandb
    except ImportError as error:
        raise PlanspaceError(
            f"Weights & Biases needs the package wandb: {install_command('track')}."
        ) from error
    make_folder(folder)
    mode = None if "WANDB_MODE" in os.environ or _has_wandb_credentials() else "offline"
    try:
        run = wandb.init(
            project="planspace",
            name=folder.name,
            id=_wandb_id(folder),
            resume="allow",
            dir=folder,
            mode=mode,
            settings=wandb.Settings(
                silent=mode == "offline", console="off", disable_git=True, save_code=False
            ),
        )
    except wandb.errors.Error as error:
        raise PlanspaceError(
            f"Weights & Biases rejected the run ({' '.join(str(error).split())}). Set "
            "WANDB_MODE=offline to store it in its folder, or leave out --track wandb."
        ) from error
    return WandbTracker(run)


def _wandb_id(folder: Path) -> str:
    """The id of a folder's run. It is stored in the folder, so that the same run is continued."""
    path = make_folder(folder / "wandb") / "planspace-run-id"
    if not path.exists():
        write_bytes(path, secrets.token_hex(6).encode())
    return read_bytes(path).decode()


def _has_wandb_credentials() -> bool:
    if os.environ.get("WANDB_API_KEY"):
        return True
    try:
        return netrc.netrc().authenticators("api.wandb.ai") is not None
    except (OSError, netrc.NetrcParseError):
        return False


@contextlib.contextmanager
def open_trackers(names: Sequence[TrackerName], folder: Path) -> Iterator[AddScalars]:
    """Open the trackers of a run: TensorBoard in `folder`/tensorboard, Weights & Biases in `folder`.

    Args:
        names: names of the trackers; may be empty.
        folder: the run's folder.

    Yields:
        A function that writes the values of one step to all of them.

    Raises:
        PlanspaceError: a package is missing, or the folder cannot be written.
    """
    openers = {
        "tensorboard": lambda: open_tracker(folder / "tensorboard"),
        "wandb": lambda: open_wandb(folder),
    }
    with contextlib.ExitStack() as stack:
        trackers = [stack.enter_context(contextlib.closing(openers[name]())) for name in dict.fromkeys(names)]

        def add(step: int, scalars: Mapping[str, float]) -> None:
            for tracker in trackers:
                tracker.add(step, scalars)

        yield add
