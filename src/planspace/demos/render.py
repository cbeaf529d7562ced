"""Film the robot in its recorded states, in real time."""

import io
import math
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import mujoco
import numpy as np
from jaxtyping import Float, UInt8

from planspace.demos.dataset import Demos
from planspace.demos.episode import Episode
from planspace.demos.framing import Frame, has_plane, light_from_camera
from planspace.errors import PlanspaceError, UsageError, check_setting, install_command, unknown
from planspace.physics.rendering import context_class, rendering_advice, rendering_backend
from planspace.progress import progress
from planspace.storage.files import write_bytes

SUFFIXES = (".gif", ".mp4")
FIT = "fit"
"""The camera that is fitted to the whole motion."""
Image = UInt8[np.ndarray, "height width 3"]
Encoder = Callable[[Iterator[Image], "FilmConfig"], bytes]


@dataclass(frozen=True)
class FilmConfig:
    """Settings of a film."""

    episodes: int = 3
    """Number of demonstrations, starting with the first, shown one after another."""
    fps: int = 30
    """Frames per second."""
    width: int = 480
    """Width of a frame [pixels]."""
    height: int = 360
    """Height of a frame [pixels]."""
    camera: str = ""
    """Name of a camera, or `fit` for one that is fitted to the whole motion. By default the first camera of
    the model; `fit` for a model without any."""
    pause_s: float = 0.0
    """How long the last pose of each demonstration stays [s]."""

    def __post_init__(self) -> None:
        """Check the numbers."""
        if min(self.episodes, self.fps, self.width, self.height) < 1:
            raise UsageError("--episodes, --fps, --width and --height must be at least 1.")
        if self.fps > 100:
            raise UsageError(f"--fps must be at most 100, the limit of GIF, got {self.fps}.")
        check_setting("pause_s", self.pause_s, 0 <= self.pause_s < math.inf, "at least 0 and finite")


def render_demos(demos: Demos, file: Path, config: FilmConfig) -> None:
    """Film demonstrations.

    Args:
        demos: the demonstrations, with a model.
        file: the GIF or MP4 file to write.
        config: the settings.

    Raises:
        UsageError: the file is neither GIF nor MP4, an MP4 has an odd size, or the camera does not exist.
        PlanspaceError: there is no model, no OpenGL backend works, or the file cannot be written.
    """
    _render([demos], ("",), file, config)


def render_side_by_side(columns: Mapping[str, Demos], file: Path, config: FilmConfig) -> None:
    """Film demonstrations of one robot side by side; a shorter one waits at its end.

    Args:
        columns: datasets by the titles that stand above them; equally many demonstrations are filmed of each.
        file: the GIF or MP4 file to write.
        config: the settings; width and height are those of one picture.

    Raises:
        UsageError: the file is neither GIF nor MP4, an MP4 has an odd size, or the camera does not exist.
        PlanspaceError: there is no model, no OpenGL backend works, or the file cannot be written.
    """
    _render(list(columns.values()), tuple(columns), file, config)


def _render(columns: Sequence[Demos], titles: Sequence[str], file: Path, config: FilmConfig) -> None:
    whole = replace(config, width=config.width * len(columns))
    _find_encoder(file, whole)
    model, space = columns[0].info.compile()
    num = min(config.episodes, *(len(demos) for demos in columns))
    pause = round(config.pause_s * config.fps)
    rows = [
        _equally_long([_poses(demos.episode(i), config.fps) for demos in columns], pause) for i in range(num)
    ]
    poses = [space.normalise(np.concatenate(column)) for column in zip(*rows, strict=True)]
    frame = Frame.of_motion(model, space, np.concatenate(poses))
    with _camera(model, config, frame) as shoot, progress("render", len(poses[0]), unit="frame") as bar:

        def frames() -> Iterator[Image]:
            data = mujoco.MjData(model)
            for states in zip(*poses, strict=True):
                pictures = []
                for title, state in zip(titles, states, strict=True):
                    space.write_data(state, data)
                    mujoco.mj_forward(model, data)
                    pictures.append(_with_title(shoot(data), title))
                yield np.concatenate(pictures, axis=1)
                bar.update()

        write_film(file, frames(), whole)


def _equally_long(parts: list[np.ndarray], pause: int) -> list[np.ndarray]:
    """The poses of each column; the last pose stays until the longest has ended, and `pause` frames more."""
    longest = max(len(part) for part in parts) + pause
    return [np.concatenate([part, part[-1:].repeat(longest - len(part), axis=0)]) for part in parts]


def _with_title(picture: Image, title: str) -> Image:
    if not title:
        return picture
    from PIL import Image as Pillow
    from PIL import ImageDraw

    image = Pillow.fromarray(picture)
    size = max(12, picture.shape[0] // 16)
    ImageDraw.Draw(image).text(
        (size // 2, size // 3), title, fill="black", stroke_width=2, stroke_fill="white", font_size=size
    )
    return np.asarray(image)


def write_film(file: Path, pictures: Iterator[Image], config: FilmConfig) -> None:
    """Write pictures as a film.

    Args:
        file: the GIF or MP4 file to write.
        pictures: pictures of the width and height of `config`.
        config: the settings.

    Raises:
        UsageError: the file is neither GIF nor MP4, or an MP4 has an odd size.
        PlanspaceError: the file cannot be written.
    """
    write_bytes(file, _find_encoder(file, config)(pictures, config))


def _find_encoder(file: Path, config: FilmConfig) -> "Encoder":
    suffix = check_film(file)
    if suffix == ".mp4" and (config.width % 2 or config.height % 2):
        raise UsageError(f"an MP4 must have an even width and height, got {config.width} x {config.height}.")
    return _encode_gif if suffix == ".gif" else _mp4_encoder()


def check_film(file: Path) -> str:
    """The suffix of a film, in lower case.

    Raises:
        UsageError: the file is neither a GIF nor an MP4.
    """
    suffix = file.suffix.lower()
    if suffix not in SUFFIXES:
        raise UsageError(f"{file} is not a film; give FILE.gif or FILE.mp4.")
    return suffix


def _poses(episode: Episode, fps: int) -> Float[np.ndarray, "picture state"]:
    """The states at the times of the frames, interpolated linearly."""
    instants = np.arange(int(np.floor(episode.times[-1] * fps)) + 1) / fps
    return np.stack([np.interp(instants, episode.times, x) for x in episode.states.T], axis=1)


# --- drawing ----------------------------------------------------------------------------------------


@contextmanager
def _camera(
    model: mujoco.MjModel, config: FilmConfig, frame: Frame
) -> Iterator[Callable[[mujoco.MjData], Image]]:
    """Open a camera and yield a function that takes a picture of the model.

    `mujoco.Renderer` uses the backend that MUJOCO_GL named when MuJoCo was first imported. This function
    makes the same calls with a backend that works, so it can be chosen later.
    """
    view = _view(model, config, frame)
    backend = rendering_backend()
    if backend is None:
        raise PlanspaceError(
            f"the robot cannot be drawn: no OpenGL backend works here; {rendering_advice()}."
        )
    model.vis.global_.offwidth, model.vis.global_.offheight = config.width, config.height
    gl = context_class(backend)(config.width, config.height)
    gl.make_current()
    context = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_150)
    mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, context)
    scene, needs_floor = mujoco.MjvScene(model, maxgeom=10_000), not has_plane(model)
    if not model.ncam:  # nobody chose how this model looks
        light_from_camera(model)
    whole = mujoco.MjrRect(0, 0, config.width, config.height)

    def shoot(data: mujoco.MjData) -> Image:
        options, everything = mujoco.MjvOption(), mujoco.mjtCatBit.mjCAT_ALL
        mujoco.mjv_updateScene(model, data, options, None, view, everything, scene)
        if needs_floor:
            frame.add_floor(scene)
        mujoco.mjr_render(whole, scene, context)
        picture = np.empty((config.height, config.width, 3), dtype=np.uint8)
        mujoco.mjr_readPixels(picture, None, whole, context)
        return picture[::-1]  # OpenGL counts rows from the bottom

    try:
        yield shoot
    finally:
        context.free()
        gl.free()


def _view(model: mujoco.MjModel, config: FilmConfig, frame: Frame) -> mujoco.MjvCamera:
    name = config.camera
    names = [model.camera(i).name for i in range(model.ncam)]
    if name and name not in (*names, FIT):
        raise (
            unknown("camera", name, [*names, FIT])
            if names
            else UsageError("the model has no camera; leave out --camera.")
        )
    if name == FIT or not names:
        return frame.camera(model, config.width / config.height)
    view = mujoco.MjvCamera()
    view.type = mujoco.mjtCamera.mjCAMERA_FIXED
    view.fixedcamid = names.index(name) if name else 0
    return view


# --- encoding ---------------------------------------------------------------------------------------


def _encode_gif(pictures: Iterator[Image], config: FilmConfig) -> bytes:
    from PIL import Image as Pillow

    frames = [Pillow.fromarray(picture).quantize(colors=128) for picture in pictures]
    ends = np.round(np.arange(len(frames) + 1) * 100 / config.fps)  # the unit of time in a GIF is 0.01 s
    film = io.BytesIO()
    frames[0].save(
        film,
        format="GIF",
        save_all=True,
        append_images=frames[1:],
        duration=(np.diff(ends) * 10).astype(int).tolist(),
        loop=0,
    )
    return film.getvalue()


def _mp4_encoder() -> Encoder:
    try:
        import imageio_ffmpeg
    except ImportError as error:
        raise PlanspaceError(
            f"an MP4 needs imageio-ffmpeg: {install_command('video')}; or write a FILE.gif."
        ) from error

    def encode(pictures: Iterator[Image], config: FilmConfig) -> bytes:
        size = (config.width, config.height)
        with tempfile.TemporaryDirectory() as folder:
            film = Path(folder) / "film.mp4"
            try:
                writer = imageio_ffmpeg.write_frames(str(film), size, fps=config.fps, macro_block_size=2)
                writer.send(None)
                for picture in pictures:
                    writer.send(np.ascontiguousarray(picture))
                writer.close()
                return film.read_bytes()
            except (OSError, RuntimeError) as error:
                lines = str(error).strip().splitlines()
                raise PlanspaceError(
                    f"ffmpeg cannot write the MP4: {lines[-1] if lines else error!r}."
                ) from error

    return encode
