"""What holds for the package as a whole."""

import ast
import subprocess
import sys
from pathlib import Path

import planspace

SOURCE = Path(planspace.__file__).parent
ORDER = ["storage", "mjcf", "physics", "tasks", "demos", "plan", "embed", "envs", "rl", "figures", "study"]
"""The stages: data flows in this direction, and so may no import flow against it."""


def test_importing_planspace_is_light() -> None:
    code = "import sys, planspace, planspace.envs.wrappers as _; "
    code += "print([m for m in ('jax', 'mujoco', 'matplotlib', 'onnx') if m in sys.modules])"
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


def imports(file: Path) -> set[str]:
    tree = ast.parse(file.read_text())
    found = {a.name for n in ast.walk(tree) if isinstance(n, ast.Import) for a in n.names}
    return found | {n.module or "" for n in ast.walk(tree) if isinstance(n, ast.ImportFrom)}


def test_stages_import_only_what_comes_before_them() -> None:
    for position, stage in enumerate(ORDER):
        later = tuple(f"planspace.{name}" for name in ORDER[position + 1 :])
        for file in (SOURCE / stage).rglob("*.py"):
            wrong = [name for name in imports(file) if name.startswith(later)]
            assert wrong == [], f"{file} imports {wrong}"


def test_nothing_is_pickled() -> None:
    forbidden = {"pickle", "cloudpickle", "dill", "joblib", "shelve", "marshal"}
    for file in SOURCE.rglob("*.py"):
        assert not imports(file) & forbidden
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
