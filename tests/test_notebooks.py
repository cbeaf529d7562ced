"""The notebooks run from top to bottom in a kernel, and are stored without outputs."""

import json
import os
import sys
from pathlib import Path

import pytest

NOTEBOOKS = sorted((Path(__file__).parents[1] / "notebooks").glob("*.ipynb"))
SMALLER = {
    "NUM_PLANS = 12": "NUM_PLANS = 3",
    "NUM_EPISODES = 40": "NUM_EPISODES = 12",
    "steps=1500": "steps=20",
    "STEPS = 10_000": "STEPS = 1_000",
    "n_eval_episodes=10": "n_eval_episodes=2",
    "--samples 128": "--samples 16",
    "--episode-s 4": "--episode-s 0.4",
}
"""Budgets of the notebooks, and the smaller budgets that the tests use."""
LONG = ("own-robot",)
RUNS = [
    pytest.param(file, id=file.stem, marks=pytest.mark.nightly if file.stem in LONG else pytest.mark.slow)
    for file in NOTEBOOKS
]
NEEDS = {"own-data": ("stable_baselines3",)}


@pytest.mark.filterwarnings("default")  # of the packages that talk to the kernel
@pytest.mark.parametrize("file", RUNS)
def test_notebook_runs(file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for module in ("ipykernel", *NEEDS.get(file.stem, ())):
        pytest.importorskip(module, reason="needs an extra")
    nbclient = pytest.importorskip("nbclient", reason="needs the extra test")
    nbformat = pytest.importorskip("nbformat", reason="needs the extra test")
    monkeypatch.setenv(
        "PATH", f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    )  # `planspace`
    notebook = nbformat.read(file, as_version=4)
    nbformat.validate(notebook)
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    for cell in code:
        for large, small in SMALLER.items():
            cell.source = cell.source.replace(large, small)
    nbclient.NotebookClient(notebook, timeout=300, resources={"metadata": {"path": str(tmp_path)}}).execute()
    assert all(cell.execution_count for cell in code)
    outputs = [output for cell in code for output in cell.outputs]
    assert "image/png" in {kind for output in outputs for kind in output.get("data", ())}
    complaints = [output.text for output in outputs if "Warning" in output.get("text", "")]
    assert complaints == []


def test_notebooks_have_no_outputs() -> None:
    assert len(NOTEBOOKS) == 3
    for file in NOTEBOOKS:
        notebook = json.loads(file.read_text())
        code = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
        assert not any(cell["outputs"] or cell["execution_count"] for cell in code), file
        assert '"google.colab" in sys.modules' in "".join(code[0]["source"]), file


def test_every_smaller_budget_is_used() -> None:
    text = "".join(file.read_text() for file in NOTEBOOKS)
    assert [large for large in SMALLER if large not in text] == []
