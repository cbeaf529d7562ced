"""The documentation builds without warnings, and its code and commands work."""

import os
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import pytest

from planspace.cli.entry import main, parse
from planspace.embed.config import PRESETS
from tests.test_package import STAGES

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PAGES = sorted(path.relative_to(DOCS) for path in DOCS.rglob("*.md") if "_build" not in path.parts)
EXTRAS = {
    "tutorial.md": ("stable_baselines3", "imageio"),
    "howto/own-environment.md": ("imageio",),  # gymnasium[mujoco]
    "howto/demonstrations.md": ("minari", "pyarrow"),
    "howto/agents.md": ("stable_baselines3",),
}
SMALLER = {
    "--num 200": "--num 6",
    "--episodes 4 --out control": "--episodes 1 --episode-s 0.4 --no-film --out control",
    "--num 20 ": "--num 2 ",
    "num=60": "num=12",
    "num=20": "num=2",
    "--num 60": "--num 12",
    "--seeds 15": "--seeds 2",
    "--steps 500000": "--steps 8000",
    "60_000": "2_000",
    "20_000": "4_000",
    "500_000": "8_000",
    "--steps 20000": "--steps 4000",
    "steps=2000": "steps=20",
    "range(3)": "range(1)",
}
"""Budgets of the pages, and the smaller budgets that the tests use."""
READ_ALONE = ("text", "yaml", "{toctree}", "{literalinclude}", "{eval-rst}")
"""Blocks that are not executed here: output, tables of contents, and code that other tests run."""


@dataclass(frozen=True)
class Block:
    """A fenced block of a page."""

    language: str
    file: str
    """The file in which the reader saves the block; empty if the reader types it."""
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


QUICK = ("environments.md", "howto/own-environment.md", "howto/shaping.md")
"""Pages that run within seconds."""
LONG = (
    "control.md",
    "training.md",
    "tutorial.md",
    "howto/agents.md",
    "howto/own-objective.md",
    "howto/demonstrations.md",
    "howto/gymnasium-task.md",
    "howto/python-api.md",
    "howto/own-planner.md",
    "howto/own-algorithm.md",
    "environments.md",
)
"""Pages that run for more than half a minute and whose commands other tests run, too."""
RUNNING = [
    pytest.param(
        str(page),
        marks=pytest.mark.nightly if str(page) in LONG else () if str(page) in QUICK else pytest.mark.slow,
    )
    for page in PAGES
    if runs(page)
]


@pytest.mark.filterwarnings("default")  # Minari warns
@pytest.mark.parametrize("page", RUNNING)
def test_page_runs(
    page: str,
    embedding_folder: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    for module in EXTRAS.get(page, ()):
        pytest.importorskip(module, reason="needs an extra")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setitem(PRESETS, "modern", replace(PRESETS["modern"], steps=20, batch=16))
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "minari"))
    shutil.copytree(embedding_folder, "runs/cartpole-swingup-small/embedding")
    names: dict = {"__name__": "__main__"}
    for block in blocks(Path(page)):
        if block.language == "file":
            save(block, monkeypatch)
        elif block.language == "python":
            exec(block.text, names)
        elif block.language == "shell":
            for line in block.text.splitlines():
                run_line(line, capsys)
        else:
            assert block.language in READ_ALONE, f"nothing checks the {block.language} blocks of {page}"


def save(block: Block, monkeypatch: pytest.MonkeyPatch) -> None:
    """Save a file of a page, and forget a module of the same name."""
    Path(block.file).write_text(block.text)
    monkeypatch.delitem(sys.modules, Path(block.file).stem, raising=False)


def run_line(line: str, capsys: pytest.CaptureFixture[str]) -> None:
    program, *arguments = shlex.split(line)
    if program == "pip":  # .ci/run installs planspace
        return
    if program == "planspace":
        quick = ["--steps", "20", "--batch", "16", "--time-steps", "20"] if arguments[0] == "embed" else []
        assert main([*arguments, *quick]) == 0, capsys.readouterr().err
        return
    assert program == "python", f"no test runs {line!r}"
    done = subprocess.run([sys.executable, *arguments], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


PLACEHOLDERS = {"N": "1", "FILE.yaml": "pendulum"}


@pytest.mark.parametrize("page", [str(page) for page in PAGES])
def test_named_commands_parse(page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Measurements take too long to repeat here, so this only checks that their commands parse."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    for block in blocks(Path(page)):
        if block.language == "file":
            save(block, monkeypatch)
    text = re.sub(r"^```.*?^```$", "", (DOCS / page).read_text(), flags=re.MULTILINE | re.DOTALL)
    lines = re.findall(r"^ {4}(planspace .*|python .*)$", text, re.MULTILINE)
    lines += [code for code in re.findall(r"`(planspace [^`]+|python [^`]+)`", text.replace("\n", " "))]
    for line in lines:
        words = shlex.split(re.split(" # |;| > ", line)[0])
        if words[0] == "python":
            script = next(w for w in words[1:] if w.endswith(".py"))
            assert (ROOT / script).exists(), line
            for option in re.findall(r"--[\w-]+", line.partition(";")[0]):
                assert f'"{option}"' in (ROOT / script).read_text(), line
        else:
            assert_parses([PLACEHOLDERS.get(word, word) for word in words[1:]], line)


def assert_parses(words: list[str], line: str) -> None:
    if "..." in line or not any(word.startswith("--") for word in words):  # only names a command
        words = [*words, "--help"]
    try:
        parse(words)
    except SystemExit as stop:
        assert not stop.code, line


def test_every_page_is_in_one_table_of_contents() -> None:
    named = []
    for page in PAGES:
        for listing in re.findall(r"^```{toctree}\n(.*?)^```$", (DOCS / page).read_text(), re.M | re.S):
            entries = [line for line in listing.splitlines() if line and not line.startswith(":")]
            named += [page.parent / f"{entry}.md" for entry in entries]
    assert sorted(named) == [page for page in PAGES if page != Path("index.md")]


@pytest.mark.nightly
def test_build_has_no_warnings(tmp_path: Path) -> None:
    for module in ("sphinx", "myst_parser", "furo"):
        pytest.importorskip(module, reason="needs the extra docs")
    command = [sys.executable, "-m", "sphinx", "-q", "-W", "--keep-going", str(DOCS), str(tmp_path / "html")]
    done = subprocess.run(
        command, capture_output=True, text=True, check=False, env={**os.environ, "MPLBACKEND": "agg"}
    )
    assert done.returncode == 0, done.stderr
    html = (tmp_path / "html" / "how-it-works.html").read_text()
    assert "https://" not in re.sub(r'<a [^>]*href="[^"]*"', "", html)  # a page loads no remote resource


@pytest.mark.parametrize("page", ["README.md", "CONTRIBUTING.md", *(f"docs/{page}" for page in PAGES)])
def test_link_targets_exist(page: str) -> None:
    text = re.sub(r"^```.*?^```$", "", (ROOT / page).read_text(), flags=re.MULTILINE | re.DOTALL)
    targets = re.findall(r"\]\((?!https?:)([^)#\s]+)", text)
    assert [t for t in targets if not ((ROOT / page).parent / t).exists()] == []


@contextmanager
def matplotlib_settings() -> Iterator[None]:
    """Restore Matplotlib's settings and backend, which the script changes."""
    import matplotlib

    backend = matplotlib.get_backend()
    with matplotlib.rc_context():
        yield
    matplotlib.use(backend)


def test_diagrams_match_their_script(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    script = (DOCS / "diagrams.py").read_text()
    names: dict = {"__name__": "diagrams", "__file__": str(tmp_path / "diagrams.py")}
    (tmp_path / "figures").mkdir()
    with matplotlib_settings():
        exec(script, names)
        for draw in ("draw_triplet", "draw_flow", "draw_system", "draw_house"):
            names[draw]()
    drawn = list((tmp_path / "figures").iterdir())
    assert len(drawn) == 4
    pages = [[f.read_text() for f in (file, DOCS / "figures" / file.name)] for file in drawn]
    now, then = ([int(x) for x in re.findall(r"Matplotlib v([0-9.]+)", p)[0].split(".")] for p in pages[0])
    if now < then:
        pytest.skip("an older Matplotlib splits formulas differently")
    for page in pages:
        texts = [re.findall(r"<text[^>]*>([^<]*)</text>|<tspan[^>]*>([^<]*)</tspan>", svg) for svg in page]
        assert texts[0] == texts[1]


def test_house_diagram_names_every_package() -> None:
    names: dict = {"__name__": "diagrams", "__file__": str(DOCS / "diagrams.py")}
    with matplotlib_settings():
        exec((DOCS / "diagrams.py").read_text(), names)
    drawn = [re.split(r"[,\n] ?", name) for name in names["GROUND"]]
    drawn += [[name] for name in (*names["STAGES"], *names["TOP"])]
    package = ROOT / "src" / "planspace"
    found = {p.parent.name for p in package.glob("*/__init__.py")}
    found |= {p.stem for p in package.glob("*.py") if not p.name.startswith("__")}
    in_order = [name for group in drawn for name in group]
    assert set(in_order) == found
    assert [name for name in in_order if name in STAGES] == STAGES
