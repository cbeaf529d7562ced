"""The audit hook notices everything that a hostile file could do."""

import importlib
import os
import socket
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from .audit import CANARY, nothing_else_happens

ACTIONS: dict[str, tuple[str, Callable[[Path], object]]] = {
    "read": ("open", lambda secret: secret.read_text()),
    "read through a link": ("open", lambda secret: (secret.parents[1] / "allowed" / "link").read_text()),
    "write": ("open", lambda secret: secret.write_text("")),
    "remove": ("os.remove", lambda secret: secret.unlink()),
    "move": ("os.rename", lambda secret: secret.rename(secret.parents[1] / "allowed" / "moved")),
    "truncate": ("os.truncate", lambda secret: os.truncate(secret, 0)),
    "make a folder": ("os.mkdir", lambda secret: (secret.parent / "new").mkdir()),
    "import a module": (CANARY, lambda secret: importlib.import_module(CANARY)),
    "run a program": (
        "subprocess.Popen",
        lambda secret: subprocess.run([sys.executable, "-c", ""], check=True),
    ),
    "run a shell": ("os.system", lambda secret: os.system("exit 0")),
    "open a socket": ("socket", lambda secret: socket.socket().close()),
}


@pytest.mark.usefixtures("canary")
@pytest.mark.parametrize("action", ACTIONS)
def test_the_hook_sees(action: str, tmp_path: Path) -> None:
    event, act = ACTIONS[action]
    secret, allowed = tmp_path / "outside" / "secret", tmp_path / "allowed"
    secret.write_text("secret")
    allowed.mkdir()
    (allowed / "link").symlink_to(secret)
    with pytest.raises(AssertionError, match=event), nothing_else_happens(allowed):
        act(secret)
    sys.modules.pop(CANARY, None)
    with nothing_else_happens(allowed):
        (allowed / "own").write_text("")
        (allowed / "own").unlink()
