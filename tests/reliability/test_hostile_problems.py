"""Hostile problem files are rejected, and nothing else happens."""

from pathlib import Path

import numpy as np
import pytest

from planspace.cli import main
from planspace.demos.load import load_demos
from planspace.embed.saved_embedding import load_embedding
from planspace.mjcf import subprocess_model
from planspace.tasks.problem_file import load_problem

from .audit import assert_rejected
from .hostile_models import HINGE
from .saved_files import GOLDEN

ALIASES = "a0: &a0 [x, x]\n" + "".join(f"a{i}: &a{i} [*a{i - 1}, *a{i - 1}]\n" for i in range(1, 40))
YAML = {
    "code in a tag": ("model: !!python/object/apply:os.system ['touch triggered']\n", "not valid YAML"),
    "name in a tag": ("model: !!python/name:os.system\n", "not valid YAML"),
    "aliases of aliases": (ALIASES, "unknown key"),
    "aliases in a value": ("joints: &a [*a]\n", "not valid YAML|missing|is invalid|joints"),
    "nested too deep": ("a: " + "[" * 100_000, "not valid YAML"),
    "too large": ("# " + "x" * (1 << 20), "at most"),
    "too many keys": ("".join(f"k{i}: 1\n" for i in range(20_000)), "at most"),
    "repeated key": ("model: a\nmodel: b\n", "comes twice"),
    "merge key": ("a: &a {b: 1}\nc: {<<: *a}\n", "must be plain text"),
    "list as a key": ("? [a]\n: 1\n", "must be plain text"),
    "number as a key": ("1: 2\n", "must have names as keys"),
    "long sexagesimal number": ("a: 1" + ":1" * 60_000, "a text has 120001 characters; the limit is 4096"),
    "model outside": (
        "model: ../secret.xml\njoints: [a]\nstart: [0]\ngoal: [0]\ntolerance: 1\n",
        "outside its folder",
    ),
}


@pytest.mark.parametrize("trick", YAML)
def test_hostile_problems_are_rejected(trick: str, models: Path, tmp_path: Path) -> None:
    text, message = YAML[trick]
    (models / "p.yaml").write_text(text)
    assert_rejected(models, lambda: load_problem(str(models / "p.yaml")), message)
    assert not list(tmp_path.rglob("triggered"))


@pytest.mark.parametrize("verb", ["plan", "demos import"])
def test_an_untrusted_problem_ends_in_one_line(
    verb: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("model.xml").write_text(f'<mujoco><size memory="1000M"/><worldbody>{HINGE}</worldbody></mujoco>')
    Path("problem.yaml").write_text("model: model.xml\njoints: [j]\nstart: [0]\ngoal: [0]\ntolerance: 0.1\n")
    Path("demos.csv").write_text("time,x\n0,1\n0.1,2\n")
    monkeypatch.setattr(subprocess_model, "MEMORY_BYTES", 1 << 30)
    command = "plan problem.yaml" if verb == "plan" else "demos import demos.csv --problem problem.yaml"
    assert main([*command.split(), "--untrusted", "--out", "out"]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("planspace: ") and "Could not allocate memory" in line
    assert not Path("out").exists()


def test_names_in_an_html_figure_are_escaped() -> None:
    from dataclasses import replace

    from planspace.figures.interactive_paths import paths_html
    from planspace.figures.paths import embedded_paths

    demos, embedding = load_demos(GOLDEN / "demos"), load_embedding(GOLDEN / "embedding")
    evil = "</script><script>alert(1)</script>"
    names = (evil, *demos.info.names[1:])
    inputs = replace(embedding.inputs, names=names)
    shown = replace(demos, info=replace(demos.info, names=names, problem=evil))
    page = paths_html(embedded_paths(replace(embedding, inputs=inputs), shown, np.arange(3)))
    assert evil not in page
