import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from planspace.cli import main
from planspace.cli.repair import repair
from planspace.errors import PlanspaceError
from planspace.rl.config import TrainConfig
from planspace.rl.history import load_history
from planspace.rl.training import train_policies
from planspace.storage.arrays import Arrays, read_arrays, write_arrays

GOLDEN = Path(__file__).parents[1] / "golden" / "2026-11" / "run"
ALTERATIONS: dict[str, tuple[Callable[[Arrays], object], str]] = {
    "no returns": (lambda a: a.pop("return"), "KeyError: 'return'"),
    "no lengths": (lambda a: a.pop("length"), "KeyError: 'length'"),
    "losses of another shape": (lambda a: a.update(loss=a["loss"][:1].copy()), r"loss has shape \(1, 2\)"),
    "no steps": (lambda a: a.pop("steps"), "KeyError: 'steps'"),
    "no axis of seeds": (lambda a: a.update({"return": a["return"][:, 0].copy()}), "not enough values"),
    "one number": (lambda a: a.update(eval_steps=np.array(1)), "unsized"),
    "seeds that differ": (lambda a: a.update(frozen=a["frozen"][:, :1].copy()), r"frozen has shape \(2, 1\)"),
    "too few steps": (lambda a: a.update(steps=a["steps"][:1].copy()), r"steps has shape \(1,\)"),
    "nothing": (lambda a: a.update({k: v[:0].copy() for k, v in a.items()}), r"steps has shape \(0,\)"),
    "truths": (lambda a: a.update({"return": a["return"] > 0}), "return has .*bool"),
    "broken steps": (lambda a: a.update(steps=a["steps"] / 2), "steps has .*float64"),
    "steps that turn back": (lambda a: a.update(steps=a["steps"][::-1].copy()), "steps do not increase"),
    "no number": (lambda a: a["return"].fill(np.nan), "return is not finite"),
    "too large a number": (lambda a: a["return"].fill(1e308), "return is not finite, or too large"),
    "too large for a frozen seed, too": (
        lambda a: (a["return"].fill(1e308), a["frozen"].fill(1)),
        "return is not finite, or too large",
    ),
    "frozen or not": (lambda a: a["frozen"].fill(np.nan), "frozen is neither 0 nor 1"),
}


@pytest.fixture
def run(tmp_path: Path) -> Path:
    return shutil.copytree(GOLDEN, tmp_path / "run")


def alter(run: Path, change: Callable[[Arrays], object]) -> None:
    """Change the history and recompute its checksum, as an attacker can."""
    arrays = {name: array.copy() for name, array in read_arrays(run / "history.safetensors").items()}
    change(arrays)
    write_arrays(run / "history.safetensors", arrays)


@pytest.mark.parametrize("name", ALTERATIONS)
def test_an_altered_history_gives_a_one_line_error(
    name: str, run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    change, message = ALTERATIONS[name]
    assert load_history(run)["return"].shape == (2, 2)
    alter(run, change)
    with pytest.raises(PlanspaceError, match=rf"history.safetensors was altered .*{message}"):
        load_history(run)
    assert main(["curves", str(run), "--out", str(tmp_path / "curves")]) == 1
    err = capsys.readouterr().err
    assert "history.safetensors was altered" in err and len(err.splitlines()) == 1
    (line,) = repair(run)
    assert "history.safetensors was altered" in line and not (run / "history.safetensors").exists()


def test_histories_with_numbers_that_are_not_finite_are_drawn(run: Path, tmp_path: Path) -> None:
    alter(run, lambda a: [a[name].fill(np.nan) for name in ("explained_variance", "kl", "eval_return")])
    alter(
        run, lambda a: (a["return"][1].fill(np.inf), a["frozen"][1].fill(1))
    )  # the returns that froze both seeds
    assert main(["curves", str(run), "--out", str(tmp_path / "curves")]) == 0


def test_a_history_of_other_settings_is_refused(tmp_path: Path) -> None:
    config = TrainConfig(num_seeds=1, steps=1)
    train_policies("cartpole", config, out=tmp_path)
    shutil.copy(GOLDEN / "history.safetensors", tmp_path)  # a history of two seeds and two iterations
    with pytest.raises(PlanspaceError, match=r"history.safetensors was altered .*has shape \(2,"):
        train_policies("cartpole", config, out=tmp_path)
