"""The documentation builds without a warning, and what it tells a reader to type works."""

import os
import re
import shlex
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest

from planspace.cli.entry import main, parse

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PAGES = sorted(path.relative_to(DOCS) for path in DOCS.rglob("*.md") if "_build" not in path.parts)
EXTRAS = {
    "tutorial.md": ("stable_baselines3", "imageio"),
    "howto/own-environment.md": ("imageio",),  # gymnasium[mujoco]
    "howto/demonstrations.md": ("minari",),
}
SMALLER = {
    "--num 200": "--num 6",
    "--num 60": "--num 12",
    "--seeds 15": "--seeds 2",
    "--steps 500000": "--steps 8000",
    "60_000": "2_000",
    "range(3)": "range(1)",
}
"""What a reader's patience is asked for, and what a test's."""
READ_ALONE = ("text", "yaml", "{toctree}", "{literalinclude}", "{eval-rst}")
"""Output, tables of contents, and what other tests run."""


@dataclass(frozen=True)
class Block:
    """A fenced block of code."""

    language: str
    file: str
    """Where a reader is to save it; empty if it is to be typed."""
    text: str


def blocks(page: Path) -> list[Block]:
    found = re.findall(r"^```(\S+)[^\n]*\n(.*?)^```$", (DOCS / page).read_text(), re.MULTILINE | re.DOTALL)
    parsed = []
    for fence, text in found:
        caption = re.match(r":caption: (\S+)\n", text)
        is_file = fence == "{code-block}" and caption is not None
        body = text[caption.end() :] if is_file and caption else text
        for large, small in SMALLER.items():
            body = body.replace(large, small)
        parsed.append(Block("file" if is_file else fence, caption[1] if is_file and caption else "", body))
    return parsed


def runs(page: Path) -> bool:
    return any(block.language in ("python", "shell", "file") for block in blocks(page))


@pytest.mark.slow
@pytest.mark.filterwarnings("default")  # a reader is warned by Minari, too
@pytest.mark.parametrize("page", [str(page) for page in PAGES if runs(page)])
def test_what_it_tells_to_type_works(
    page: str,
    embedding_folder: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    for module in EXTRAS.get(page, ()):
        pytest.importorskip(module, reason="needs an extra")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "minari"))
    shutil.copytree(embedding_folder, "runs/cartpole-swingup-small/embedding")
    names: dict = {}
    for block in blocks(Path(page)):
        if block.language == "file":
            Path(block.file).write_text(block.text)
        elif block.language == "python":
            exec(block.text, names)
        elif block.language == "shell":
            for line in block.text.splitlines():
                run_line(line, capsys)
        else:
            assert block.language in READ_ALONE, f"{page} has a block of {block.language} that nothing checks"


def run_line(line: str, capsys: pytest.CaptureFixture[str]) -> None:
    program, *arguments = shlex.split(line)
    if program == "pip":  # installing is what continuous integration does
        return
    if program == "planspace":
        quick = ["--steps", "20", "--batch", "16"] if arguments[0] == "embed" else []
        assert main([*arguments, *quick]) == 0, capsys.readouterr().err
        return
    assert program == "python", f"who runs {line!r}?"
    done = subprocess.run([sys.executable, *arguments], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("page", [str(page) for page in PAGES])
def test_commands_named_in_passing_exist(page: str) -> None:
    """Measurements take too long to run again here; their commands must at least be ones that could run."""
    text = re.sub(r"^```.*?^```$", "", (DOCS / page).read_text(), flags=re.MULTILINE | re.DOTALL)
    lines = re.findall(r"^ {4}(planspace .*|python .*)$", text, re.MULTILINE)
    lines += [code for code in re.findall(r"`(planspace [^`]+|python [^`]+)`", text.replace("\n", " "))]
    for line in lines:
        words = shlex.split(line.partition(" # ")[0].partition(";")[0])
        if words[0] == "python":
            script = next(w for w in words[1:] if w.endswith(".py"))
            assert (ROOT / script).exists(), line
            for option in re.findall(r"--[\w-]+", line.partition(";")[0]):
                assert f'"{option}"' in (ROOT / script).read_text(), line
        else:
            assert_parses(["1" if word == "N" else word for word in words[1:]], line)


def assert_parses(words: list[str], line: str) -> None:
    if "..." in line or not any(word.startswith("--") for word in words):  # the name of a command
        words = [*words, "--help"]
    try:
        parse(words)
    except SystemExit as stop:
        assert not stop.code, line


def test_it_builds_without_a_warning(tmp_path: Path) -> None:
    for module in ("sphinx", "myst_parser", "furo"):
        pytest.importorskip(module, reason="needs the extra docs")
    command = [sys.executable, "-m", "sphinx", "-q", "-W", "--keep-going", str(DOCS), str(tmp_path / "html")]
    done = subprocess.run(
        command, capture_output=True, text=True, check=False, env={**os.environ, "MPLBACKEND": "agg"}
    )
    assert done.returncode == 0, done.stderr
    html = (tmp_path / "html" / "how-it-works.html").read_text()
    assert "https://" not in re.sub(r'<a [^>]*href="[^"]*"', "", html)  # nothing is fetched to read it


def test_the_diagrams_are_what_their_script_draws(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    script = (DOCS / "diagrams.py").read_text()
    names: dict = {"__name__": "diagrams", "__file__": str(tmp_path / "diagrams.py")}
    (tmp_path / "figures").mkdir()
    import matplotlib

    backend = matplotlib.get_backend()
    with matplotlib.rc_context():
        exec(script, names)
        for draw in ("draw_triplet", "draw_flow", "draw_system"):
            names[draw]()
    matplotlib.use(backend)
    drawn = list((tmp_path / "figures").iterdir())
    assert len(drawn) == 3
    pages = [[f.read_text() for f in (file, DOCS / "figures" / file.name)] for file in drawn]
    now, then = ([int(x) for x in re.findall(r"Matplotlib v([0-9.]+)", p)[0].split(".")] for p in pages[0])
    if now < then:
        pytest.skip("an older Matplotlib cuts formulas in other pieces")
    for page in pages:
        texts = [re.findall(r"<text[^>]*>([^<]*)</text>|<tspan[^>]*>([^<]*)</tspan>", svg) for svg in page]
        assert texts[0] == texts[1]
