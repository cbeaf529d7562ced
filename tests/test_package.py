"""Rules for the package as a whole."""

import ast
import re
import subprocess
import sys
import tomllib
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest
import yaml

import planspace
from planspace.cli.entry import VERBS

ROOT = Path(__file__).parents[1]
SOURCE = Path(planspace.__file__).parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
GROUND_FLOOR = ("errors", "progress", "workers", "seams", "summary")
MAX_LINES = 350
"""Lines of a file in src, tests or benchmarks."""
STAGES = [
    "storage",
    "mjcf",
    "physics",
    "tasks",
    "demos",
    "plan",
    "embed",
    "control",
    "envs",
    "rl",
    "figures",
    "study",
    "cli",
]
"""In this order; a stage imports only from the ground floor and from earlier stages."""


def test_importing_planspace_is_light() -> None:
    code = "import sys, planspace, planspace.envs.wrappers as _; "
    code += "print([m for m in ('jax', 'mujoco', 'matplotlib', 'onnx', 'torch') if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_using_a_wrapper_is_light(embedding_folder: Path) -> None:
    code = "import sys, gymnasium, planspace; from planspace.envs.wrappers import *; "
    code += "env = gymnasium.make('planspace/CartPoleSwingUp-v0'); "
    code += f"env = PlanSpaceObservation(PlanSpaceShaping(env, {str(embedding_folder)!r}, [0.0] * 4), "
    code += f"{str(embedding_folder)!r}); env.reset(seed=0); env.step(env.action_space.sample()); "
    code += "print([m for m in ('jax', 'matplotlib', 'torch') if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def imports(file: Path, *, at_import: bool = False) -> set[str]:
    """Names that a file imports, of modules and of objects in modules.

    Args:
        file: a Python file.
        at_import: leave out imports inside functions and for type checkers.
    """
    found: set[str] = set()
    nodes: list[ast.AST] = [ast.parse(file.read_text())]
    while nodes:
        node = nodes.pop()
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            found |= {node.module or ""} | {f"{node.module}.{alias.name}" for alias in node.names}
        is_function = isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda)
        is_for_types = isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)
        if not (at_import and (is_function or is_for_types)):
            nodes += ast.iter_child_nodes(node)
    return found


def modules() -> dict[str, Path]:
    """Every module of the package by its full name."""
    named = {}
    for file in SOURCE.rglob("*.py"):
        parts = ("planspace", *file.relative_to(SOURCE).with_suffix("").parts)
        named[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = file
    return named


def test_stages_import_only_earlier_stages() -> None:
    """Also inside functions."""
    for name, file in modules().items():
        stage = name.split(".")[1] if "." in name else ""
        if stage in STAGES:
            later = STAGES[STAGES.index(stage) + 1 :]
        elif stage in GROUND_FLOOR:
            later = STAGES
        else:
            continue  # planspace/__init__.py and __main__.py offer all stages
        forbidden = tuple(f"planspace.{other}" for other in later)
        wrong = [
            found for found in imports(file) if f"{found}.".startswith(tuple(f"{x}." for x in forbidden))
        ]
        assert wrong == [], f"{file} imports {wrong}"


def test_every_folder_has_a_place_in_the_order() -> None:
    folders = {path.name for path in SOURCE.iterdir() if (path / "__init__.py").exists()}
    assert folders == set(STAGES)
    assert {file.stem for file in SOURCE.glob("*.py")} - {"__init__", "__main__"} == set(GROUND_FLOOR)


def test_no_modules_import_each_other_in_a_circle() -> None:
    """At import. A config may import inside a function what `--help` does not need."""
    files = modules()
    files.pop("planspace")  # imports its stages lazily, and every module imports it implicitly
    graph = {name: imports(file, at_import=True) & files.keys() for name, file in files.items()}
    graph = {name: {other for other in others if other != name} for name, others in graph.items()}
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        raise AssertionError(f"these modules import each other: {error.args[1]}") from error


def test_no_file_is_longer_than_350_lines() -> None:
    files = [file for folder in ("src", "tests", "benchmarks") for file in (ROOT / folder).rglob("*.py")]
    lengths = {file: len(file.read_text().splitlines()) for file in files}
    assert {file: length for file, length in lengths.items() if length > MAX_LINES} == {}


def test_nothing_is_saved_as_a_pickle() -> None:
    forbidden = {"pickle", "cloudpickle", "dill", "joblib", "shelve", "marshal"}
    between_processes = {SOURCE / "workers.py", SOURCE / "plan" / "workers.py"}
    between_processes |= {SOURCE / "control" / "workers.py"}
    for file in SOURCE.rglob("*.py"):
        assert file in between_processes or not imports(file) & forbidden
        assert "allow_pickle=True" not in file.read_text()


def test_every_shipped_task_is_registered_with_gymnasium() -> None:
    import gymnasium

    from planspace.tasks.catalog import shipped_tasks

    assert shipped_tasks()
    for task in shipped_tasks().values():
        spec = gymnasium.spec(task.env_id)
        assert (spec.kwargs, spec.max_episode_steps) == ({"task": task.name}, task.horizon)


def test_every_public_name_is_imported_on_first_use() -> None:
    for name in planspace.__all__:
        assert getattr(planspace, name) is not None
        assert name in dir(planspace)
    declared = (SOURCE / "__init__.py").read_text()
    assert all(f"import {name} as {name}\n" in declared for name in planspace.__all__)  # for type checkers


@pytest.mark.parametrize("file", ["test.yml", "nightly.yml", "release.yml", "docs.yml"])
def test_workflows_name_what_exists(file: str) -> None:
    """They cannot run here."""
    classified = set(re.findall(r"Python :: (3\.\d+)", "\n".join(PROJECT["classifiers"])))
    workflow = yaml.safe_load((ROOT / ".github" / "workflows" / file).read_text())
    assert workflow["permissions"] == {"contents": "read"}
    for job in workflow["jobs"].values():
        matrix = job.get("strategy", {}).get("matrix", {}).get("python", [])
        used = {
            step["with"]["python-version"] for step in job["steps"] if "setup-python" in step.get("uses", "")
        }
        assert {*matrix, *used} - {"${{ matrix.python }}"} <= classified
        assert all(re.search(r"@(release/)?v\d+$", step["uses"]) for step in job["steps"] if "uses" in step)
        commands = "\n".join(step.get("run", "") for step in job["steps"])
        assert set(re.findall(r"^planspace ([a-z]\w*)", commands, re.MULTILINE)) <= VERBS.keys()
        assert all((ROOT / path).exists() for path in re.findall(r"\btests/\S+", commands))
        extras = ",".join(re.findall(r"""['"]\.\[(.*?)\]['"]""", commands)).split(",")
        assert {*extras} - {""} <= PROJECT["optional-dependencies"].keys()
    if file == "test.yml":
        assert set(workflow["jobs"]["linux"]["strategy"]["matrix"]["python"]) == classified


def test_issue_forms_have_what_the_host_requires() -> None:
    forms = [file for file in (ROOT / ".github" / "ISSUE_TEMPLATE").glob("*.yml") if file.stem != "config"]
    assert len(forms) == 3
    for form in map(yaml.safe_load, (file.read_text() for file in forms)):
        assert {"name", "description", "body"} <= form.keys()
        fields = [field for field in form["body"] if field["type"] != "markdown"]
        assert all(field["id"] and field["attributes"]["label"] for field in fields)
