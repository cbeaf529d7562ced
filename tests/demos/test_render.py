import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from planspace.demos.dataset import Demos
from planspace.demos.recording import recorded
from planspace.demos.render import FilmConfig, render_demos, render_side_by_side
from planspace.demos.state_info import StateInfo
from planspace.errors import PlanspaceError, UsageError
from planspace.mjcf.source import ModelSource
from planspace.plan.demonstrations import state_info
from planspace.tasks.problem_file import load_problem

# JAX, which other tests import, warns when ffmpeg is started by a fork
pytestmark = pytest.mark.filterwarnings("ignore:os.fork\\(\\) was called:RuntimeWarning")


SMALL = FilmConfig(episodes=2, fps=20, width=64, height=48)


def moving_cart(info: StateInfo | None = None) -> Demos:
    """A cart with its pole up that moves from left to right in one second and back in half a second."""
    states = np.zeros((51, 4))
    states[:, 0] = np.linspace(-0.8, 0.8, 51)
    there = recorded(states, np.zeros((50, 1)), np.arange(51) * 0.02, 0)
    back = recorded(states[::-2], np.zeros((25, 1)), np.arange(26) * 0.02, 1)
    return Demos.from_episodes(info or state_info(load_problem("cartpole-swingup")), [there, back])


def blue_column(picture: np.ndarray) -> float:
    """Position of the blue cart, from 0 at the left edge to 1 at the right edge."""
    r, g, b = (picture[..., i].astype(int) for i in range(3))
    columns = np.nonzero((b - r > 40) & (b - g > 20))[1]
    assert len(columns)
    return columns.mean() / picture.shape[1]


def test_a_gif_plays_the_states_in_real_time(opengl: str, tmp_path: Path) -> None:
    from PIL import Image

    render_demos(moving_cart(), tmp_path / "film.gif", SMALL)
    with Image.open(tmp_path / "film.gif") as film:
        assert film.size == (64, 48)
        places, durations = [], []
        for i in range(film.n_frames):
            film.seek(i)
            places.append(blue_column(np.asarray(film.convert("RGB"))))
            durations.append(film.info["duration"])
    # at 20 frames per second: 21 frames in the first second, including its end, then 11
    assert sum(durations) == (21 + 11) * 50
    assert places[0] < 0.35 and places[20] > 0.65 and places[-1] < 0.35
    assert (np.diff(places[:21]) >= 0).all()  # it moves to the right


def test_frames_are_upright(opengl: str, tmp_path: Path) -> None:
    from PIL import Image

    render_demos(moving_cart(), tmp_path / "film.gif", replace(SMALL, episodes=1))
    with Image.open(tmp_path / "film.gif") as film:
        picture = np.asarray(film.convert("RGB")).astype(int)
    orange = np.nonzero(picture[..., 0] - picture[..., 2] > 60)[0]
    blue = np.nonzero(picture[..., 2] - picture[..., 0] > 40)[0]
    assert orange.mean() < blue.mean()  # rows are counted from the top: the pole is above the cart


def test_side_by_side_the_shorter_one_waits_at_its_end(opengl: str, tmp_path: Path) -> None:
    from PIL import Image

    carts = moving_cart()
    back = Demos.from_episodes(carts.info, [carts.episode(1)])
    render_side_by_side({"": carts, " ": back}, tmp_path / "film.gif", replace(SMALL, episodes=1))
    with Image.open(tmp_path / "film.gif") as film:
        assert film.size == (128, 48) and film.n_frames >= 3
        film.seek(film.n_frames - 1)
        picture = np.asarray(film.convert("RGB"))
    left, right = blue_column(picture[:, :64]), blue_column(picture[:, 64:])
    assert left > 0.65 and right < 0.35  # the one on the left ends at the right, the other at the left


def test_the_last_pose_stays_for_the_pause(opengl: str, tmp_path: Path) -> None:
    from PIL import Image

    render_demos(moving_cart(), tmp_path / "film.gif", replace(SMALL, episodes=1, pause_s=1.5))
    with Image.open(tmp_path / "film.gif") as film:
        film.seek(film.n_frames - 1)
        assert film.info["duration"] >= 1500


def test_a_fitted_camera_shows_the_robot_larger_than_the_models_own(opengl: str, tmp_path: Path) -> None:
    from PIL import Image

    def blue_pixels(camera: str) -> int:
        render_demos(moving_cart(), tmp_path / "film.gif", replace(SMALL, episodes=1, camera=camera))
        with Image.open(tmp_path / "film.gif") as film:
            picture = np.asarray(film.convert("RGB")).astype(int)
        return int((picture[..., 2] - picture[..., 0] > 40).sum())

    assert blue_pixels("fit") > 1.2 * blue_pixels("side")


def test_an_mp4(opengl: str, tmp_path: Path) -> None:
    ffmpeg = pytest.importorskip("imageio_ffmpeg")
    render_demos(moving_cart(), tmp_path / "film.mp4", SMALL)
    frames, seconds = ffmpeg.count_frames_and_secs(str(tmp_path / "film.mp4"))
    assert frames == 21 + 11
    assert seconds == pytest.approx(1.6, abs=0.06)


def test_a_model_without_a_camera_gets_a_free_camera(opengl: str, tmp_path: Path) -> None:
    info = state_info(load_problem("cartpole-swingup"))
    assert info.source is not None
    lines = [line for line in info.source.text.splitlines() if "<camera" not in line]
    info = replace(info, source=ModelSource("\n".join(lines)))
    render_demos(moving_cart(info), tmp_path / "film.gif", replace(SMALL, episodes=1, fps=2))
    assert (tmp_path / "film.gif").stat().st_size > 0
    with pytest.raises(UsageError, match="the model has no camera; leave out --camera"):
        render_demos(moving_cart(info), tmp_path / "no.gif", replace(SMALL, camera="side"))


@pytest.mark.parametrize(
    ("file", "change", "message"),
    [
        ("film.avi", {}, "is not a film; give FILE.gif or FILE.mp4"),
        ("film.mp4", {"width": 63}, "must have an even width and height, got 63 x 48"),
        ("film.gif", {"camera": "sied"}, "unknown camera 'sied'. Did you mean 'side'"),
        ("film.gif", {"fps": 0}, "must be at least 1"),
        ("film.gif", {"fps": 101}, "must be at most 100"),
        ("film.gif", {"pause_s": -1.0}, "`pause_s` must be at least 0"),
    ],
)
def test_invalid_settings_are_refused(file: str, change: dict, message: str, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=message):
        render_demos(moving_cart(), tmp_path / file, replace(SMALL, **change))
    assert list(tmp_path.iterdir()) == []


def test_a_dataset_without_a_model_cannot_be_filmed(tmp_path: Path) -> None:
    bare = StateInfo(("a", "b", "c", "d"), ("",) * 4, (), 1)
    with pytest.raises(PlanspaceError, match="the dataset has no model; import it with --problem"):
        render_demos(moving_cart(bare), tmp_path / "film.gif", SMALL)


def test_error_without_opengl_says_what_to_do(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setenv("MUJOCO_GL", "nonsense")
    with pytest.raises(PlanspaceError, match=r"no OpenGL backend works here; unset MUJOCO_GL.*'nonsense'"):
        render_demos(moving_cart(), tmp_path / "film.gif", SMALL)
    assert list(tmp_path.iterdir()) == []


def test_error_without_ffmpeg_says_what_to_install(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(PlanspaceError, match=r"pip install .*\[video\]'"):
        render_demos(moving_cart(), tmp_path / "film.mp4", SMALL)
