import json
import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planspace.embed.config import PRESETS
from planspace.rl.config import TrainConfig
from planspace.storage.json_files import write_sealed
from planspace.study.answer import answer
from planspace.study.design import Arm, Claim, Study
from planspace.study.execute import SCHEMA, result_file
from planspace.study.report import slug, write_report
from planspace.study.run import open_results
from planspace.study.summary import read_findings, summarise
from planspace.study.tables import as_text
from planspace.study.unit import FitUnit, PlansUnit, PolicyUnit, Unit

EVIL = "<script>alert('evil')</script>"
PLANS = PlansUnit("cartpole-swingup", 20)
FITS = tuple(FitUnit(PLANS, replace(PRESETS["paper"], z_dim=z), num_seeds=2) for z in (2, 3))
BASE = TrainConfig(steps=400_000, num_seeds=5)


def arm(label: str, config: TrainConfig = BASE, fits: tuple[FitUnit, ...] = ()) -> Arm:
    return Arm(
        f"swing-up {EVIL}",
        label,
        tuple(PolicyUnit("cartpole-swingup", replace(config, seed=s), fits) for s in (0, 5)),
    )


ARMS = (
    arm("raw"),
    arm(f"z {EVIL}", replace(BASE, z="augment"), FITS),
    arm("sparse", replace(BASE, reward="sparse")),
)
SECOND = tuple(replace(unit, fits=(replace(FITS[0], seed=5),)) for unit in ARMS[1].units)
"""Units with another embedding of the same demonstrations."""
STUDY = Study(
    "pretend",
    "half",
    f"Is it safe? {EVIL}",
    ARMS,
    (
        Claim(f"z helps {EVIL}", "ours", "final", ARMS[1].name, ARMS[0].name),
        Claim("even", "ours", "final", ARMS[2].name, ARMS[0].name, "same", 5.0),
        Claim("unknown", "ours", "final", "no such arm", ARMS[0].name),
    ),
    (f"A note {EVIL}",),
)


def fake_result(unit: Unit, rng: np.random.Generator) -> dict[str, Any]:
    if isinstance(unit, PlansUnit):
        return {"hash": "", "count": 20, "median_duration_s": 0.8, "reached": 1.0}
    if isinstance(unit, FitUnit):
        names = ("straightness", "speed_variation", "midpoint_error", "time_correlation", "path_error")
        metrics = dict.fromkeys((*names, "effective_rank", "decoded_error"), 0.5)
        paths = rng.normal(size=(3, 10, min(3, unit.config.z_dim))).tolist()
        curves = {name: rng.normal(size=(30, 2)).tolist() for name in ("path_error", "bound")}
        return {
            "hash": "", "seed": 1, "metrics": metrics, "paths": paths, "log_steps": list(range(30)), **curves
        }  # fmt: skip
    returns = rng.normal(size=(20, 5)) + 100.0 * bool(unit.fits)
    poses = rng.integers(-500, 500, (8, 2, 4)).tolist()
    return {
        "seeds": list(unit.config.seeds),
        "steps": [20_000 * (i + 1) for i in range(20)],
        "returns": returns.tolist(),
        "eval_steps": [400_000],
        "eval_returns": [[None, *returns[-1, 1:].tolist()]],
        "frozen": [True, False, False, False, False],
        "film": {"seed": unit.config.seed, "seconds": 0.05, "poses": poses},
    }


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out, rng = tmp_path_factory.mktemp("report"), np.random.default_rng(0)
    open_results(out)
    (out / "units").mkdir()
    for unit in STUDY.units:
        head = {"schema": SCHEMA, "kind": f"{unit.kind} of a study", "unit": unit.spec}
        found = {"found": fake_result(unit, rng), "seconds": 1.0, "cores": 1, "resumed": False}
        write_sealed(result_file(unit, out), {**head, **found})
    return write_report(read_findings(STUDY, out), out)[1]


def own_text(page: Path) -> str:
    """The page without Plotly's code, which contains many URLs."""
    html = page.read_text()
    return html[: html.index("<script>")] + html[html.index("</script>") :]


def test_names_are_escaped_and_nothing_is_loaded(page: Path) -> None:
    own = own_text(page)
    assert own.count("&lt;script&gt;alert(&#39;evil&#39;)") >= 5
    assert EVIL not in own
    assert "default-src 'none'" in own
    assert "http" not in own.replace("http-equiv", "")


def test_every_figure_and_table_is_also_a_file(page: Path) -> None:
    tables = json.loads((page.parent / "tables.json").read_text())
    assert [claim["verdict"] for claim in tables["claims"]] == ["holds", "holds", "not run yet"]
    (panel,) = tables["panels"].values()
    assert [row["seeds"] for row in panel] == [10, 10, 10]
    assert [row["diverged"] for row in panel] == [2, 2, 2]
    assert panel[1]["solved"] == 1.0 and panel[2]["solved"] is None  # a sparse return has no level
    assert panel[1]["improvement"][0] == 1.0 and panel[1]["components"] is not None
    markdown = (page.parent / "tables.md").read_text()
    assert "| 10 |" in markdown and "1 more claims are about arms that were not run." in markdown
    assert "400,000 steps per seed" in markdown
    assert EVIL not in markdown
    names = {file.name for file in (page.parent / "figures").iterdir()}
    panel_name = slug(ARMS[0].panel)
    for name in (panel_name, f"{panel_name}-profile", f"{panel_name}-reached", "demonstrations-in-z"):
        assert {f"{name}.png", f"{name}.svg"} <= names
    assert sum(name.startswith("training-") and name.endswith(".svg") for name in names) == 2


def test_the_report_opens_with_the_answer_and_three_pictures(page: Path) -> None:
    own = own_text(page)
    opening = own[own.index("<h1>") : own.index("<h2>")]
    assert opening.count('<img src="data:image/png;base64,') == 3
    assert (
        "30 policies were trained for 400,000 steps each: 3 arms with 10 seeds each, in 1 comparison."
        in opening
    )
    assert "Of 2 claims, 2 hold, 0 do not hold, and 0 cannot be decided with these seeds." in opening
    assert "95 % interval" in opening and "has the highest mean return" in opening
    assert own.index("<h2>Claims") > own.index("Watch the policies")


def test_a_long_list_of_undecided_claims_is_only_counted_in_a_terminal(page: Path) -> None:
    summary = summarise(read_findings(STUDY, page.parents[1]))
    undecided = [replace(summary.claims[0], verdict="cannot tell")] * 11
    shown = as_text(replace(summary, claims=[summary.claims[0], *undecided]))
    assert shown.count(summary.claims[0].claim.text) == 1
    assert shown.endswith("11 claims are not decided by these seeds, or were not run; see the report")


def test_the_answer_says_when_seeds_decide_nothing(page: Path) -> None:
    summary = summarise(read_findings(STUDY, page.parents[1]))
    nothing = [replace(row, verdict="cannot tell", number=None, interval=None) for row in summary.claims[:2]]
    sentences = answer(replace(summary, claims=nothing))
    assert sentences[1] == "These seeds are too few to decide any of the 2 claims."
    assert sentences[2].endswith("is open: 10 seeds give no interval.")


def test_a_part_of_a_study_can_be_read_from_its_table(page: Path, tmp_path: Path) -> None:
    """The demonstrations of the arm that is shown stand in the rows of another arm."""
    shared = replace(STUDY, arms=(ARMS[1], replace(ARMS[1], label="second", units=SECOND)), claims=())
    rng = np.random.default_rng(0)
    open_results(tmp_path)
    (tmp_path / "units").mkdir()
    for unit in shared.units:
        head = {"schema": SCHEMA, "kind": f"{unit.kind} of a study", "unit": unit.spec}
        found = {"found": fake_result(unit, rng), "seconds": 1.0, "cores": 1, "resumed": False}
        write_sealed(result_file(unit, tmp_path), {**head, **found})
    write_report(read_findings(shared, tmp_path), tmp_path)
    (tmp_path / "units").rename(tmp_path / "gone")
    part = shared.only(["second"])
    summary = summarise(read_findings(shared, tmp_path).of(part))
    assert [row.demos for row in summary.embeddings] == [20]
    assert (summary.units_done, summary.units_all) == (4, 4)
    assert [row.seeds for rows in summary.panels.values() for row in rows] == [10]


@pytest.fixture(scope="module")
def chromium() -> str:
    found = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if found is None:
        pytest.skip("needs Chromium")
    return found


PROBE = """<script>
window.addEventListener("load", () => setTimeout(() => {
  const log = [];
  const table = document.querySelectorAll("table.sortable")[0];
  const first = () => table.tBodies[0].rows[0].cells[0].textContent.trim();
  table.tHead.rows[0].cells[1].click(); log.push("ascending " + first());
  table.tHead.rows[0].cells[1].click(); log.push("descending " + first());
  document.querySelectorAll("details").forEach(d => d.open = true);
  document.querySelector(".film button").click();
  log.push("plays " + document.querySelector(".film button").textContent);
  log.push("plots " + document.querySelectorAll(".js-plotly-plot .main-svg").length);
  log.push("wide " + (document.body.scrollWidth <= WIDTH));
  const requests = performance.getEntriesByType("resource").filter(e => !e.name.startsWith("data:"));
  log.push("requests " + requests.length);
  document.title = "probe: " + log.join("; ");
}, 500));
</script>"""


@pytest.mark.slow
@pytest.mark.parametrize("width", [390, 1300])
def test_the_report_works_in_a_browser(page: Path, chromium: str, tmp_path: Path, width: int) -> None:
    probed = tmp_path / "probed.html"
    narrow = f"<style>html {{ width: {width}px; }}</style></head>"  # a window is at least 500 wide
    html = page.read_text().replace("</head>", narrow, 1)
    probed.write_text(html.replace("</body>", PROBE.replace("WIDTH", str(width)) + "</body>"))
    flags = [
        "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-sync",
        "--disable-background-networking", "--disable-component-update", "--enable-unsafe-swiftshader",
        f"--user-data-dir={tmp_path / 'profile'}", f"--window-size={width},900", "--enable-logging=stderr",
        "--virtual-time-budget=8000", "--dump-dom",
    ]  # fmt: skip
    found = subprocess.run(
        [chromium, *flags, probed.as_uri()], capture_output=True, text=True, timeout=120, check=False
    )
    title = re.search(r"<title>(.*?)</title>", found.stdout, re.DOTALL)
    assert title is not None, found.stderr[-2000:]
    title_text = title.group(1)
    assert "probe: ascending" in title_text
    assert "descending z" in title_text  # the arm with z has the highest mean
    assert "plays stop" in title_text and "wide true" in title_text and "requests 0" in title_text
    assert "plots 0" not in title_text
    console = [line for line in found.stderr.splitlines() if ":CONSOLE:" in line or ":CONSOLE(" in line]
    wrong = [line for line in console if "ERROR" in line or "Uncaught" in line or "Refused" in line]
    assert wrong == []
