import numpy as np
import pytest

from planspace.demos.dataset import Demos
from planspace.demos.episode import Episode
from planspace.demos.state_info import StateInfo
from planspace.study.stick_figure import FRAMES, stick_film
from planspace.tasks.catalog import TASKS


def one_episode(task_name: str, states: np.ndarray) -> Demos:
    task = TASKS[task_name]
    model, space = task.compile()
    info = StateInfo.of_model(model, space, problem=task.problem_name, joints=task.joints, source=task.source)
    times = 0.04 * np.arange(len(states))
    controls = np.zeros((len(states) - 1, model.nu))
    return Demos.from_episodes(
        info, [Episode(states, controls, times, np.full(space.size, np.nan), False, 0, 0)]
    )


def test_the_pole_is_drawn_at_its_state() -> None:
    states = np.zeros((3, 4))
    states[:, 0] = [0.0, 0.5, 0.5]
    states[:, 1] = [0.0, 0.0, np.pi / 2]  # upright; upright and to the right; lying to the right
    film = stick_film(one_episode("cartpole-swingup", states))
    poses = np.array(film.poses)
    assert film.seconds == pytest.approx(0.04)
    (pole,) = [i for i in range(poses.shape[1]) if abs(poses[0, i, 3] - poses[0, i, 1]) > 400]
    length = [np.hypot(*(pose[pole, 2:] - pose[pole, :2])) for pose in poses]
    assert length == pytest.approx([600] * 3, abs=3)  # [mm]
    upright, moved, lying = poses[:, pole]
    assert abs(upright[0] - upright[2]) <= 1
    np.testing.assert_allclose(moved - upright, [500, 0, 500, 0], atol=2)
    assert abs(lying[1] - lying[3]) <= 1
    assert max(lying[0], lying[2]) == pytest.approx(1100, abs=3)


def test_a_long_episode_is_thinned_and_drawn_in_the_plane_of_motion() -> None:
    states = np.zeros((500, 4))
    states[:, 0] = np.linspace(0.0, 3.0, 500)
    film = stick_film(one_episode("reacher-raw", states))
    poses = np.array(film.poses)
    assert len(poses) == FRAMES
    assert film.seconds * (FRAMES - 1) == pytest.approx(0.04 * 499, rel=1e-3)
    tip = np.hypot(poses[..., 2], poses[..., 3]).max()
    assert tip == pytest.approx(210, abs=12)  # the arm lies in the plane that is drawn
