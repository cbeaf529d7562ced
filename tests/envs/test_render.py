"""Drawing environments, as images."""

import os
import subprocess
import sys

import pytest

from planspace.physics.rendering import rendering_backend

HEADLESS = """
import gymnasium, numpy, planspace
env = gymnasium.make("planspace/ReacherTrig-v0", render_mode="rgb_array")
env.reset(seed=0)
first = env.render()
for _ in range(20):
    env.step(env.action_space.high)
second = env.render()
print(first.shape, first.dtype, first.flags.c_contiguous, first.std() > 1, (first != second).any())
"""


@pytest.mark.slow
@pytest.mark.skipif(rendering_backend() is None, reason="no OpenGL backend works here")
def test_images_need_no_display_and_no_setting():
    environment = {name: value for name, value in os.environ.items() if name not in ("DISPLAY", "MUJOCO_GL")}
    command = [sys.executable, "-c", HEADLESS]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.stdout.strip() == "(480, 640, 3) uint8 True True True", done.stderr
