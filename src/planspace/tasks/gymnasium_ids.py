"""Ids of Gymnasium environments: importing the packages that register them, and the versions of these."""

import importlib
import importlib.metadata
import importlib.util
import os
from pathlib import Path

import gymnasium

from planspace.errors import PlanspaceError, UsageError, install_command
from planspace.physics.rendering import rendering_backend

_ROBOTICS, _DM_CONTROL = ("gymnasium_robotics",), ("dm_control", "shimmy")
PROVIDERS: dict[str, tuple[str, ...]] = {
    "dm_control/": _DM_CONTROL,
    "Adroit": _ROBOTICS,
    "AntMaze": _ROBOTICS,
    "Fetch": _ROBOTICS,
    "FrankaKitchen": _ROBOTICS,
    "Hand": _ROBOTICS,
    "PointMaze": _ROBOTICS,
}
"""Start of an id to the modules that provide it (extra `robots`); importing the last registers its ids."""


def registered_id(given: str, task: str) -> str:
    """Import the packages that register an id, and return the id under which Gymnasium has it.

    Args:
        given: the id; `module:Name-v0` imports the module, as `gymnasium.make` does.
        task: the task, for messages.

    Raises:
        UsageError: Gymnasium does not know the id; its message suggests a similar one.
        PlanspaceError: a package is missing.
    """
    module, _, env_id = given.rpartition(":")
    if module:
        try:
            importlib.import_module(module)
        except Exception as error:  # whatever the user's module raises
            hint = " If it is in this folder, set PYTHONPATH=." if Path(f"{module}.py").is_file() else ""
            raise UsageError(
                f"{task}: importing {module} failed: {type(error).__name__}: {error}.{hint}"
            ) from error
    elif env_id not in gymnasium.registry:
        for provider in _providers(env_id):
            _import_provider(provider, task)
    try:
        gymnasium.spec(env_id)
    except gymnasium.error.Error as error:
        raise UsageError(f"{task}: {' '.join(str(error).split())}") from None
    return env_id


def provider_versions(env_id: str) -> dict[str, str]:
    """Return the versions of Gymnasium and of the packages that provide a registered id.

    A package whose version is unknown, such as a module of the user's own, is left out.
    """
    entry = gymnasium.spec(env_id).entry_point
    module = entry if isinstance(entry, str) else getattr(getattr(entry, "func", entry), "__module__", "")
    packages = ("gymnasium", module.partition(":")[0].partition(".")[0], *_providers(env_id))
    versions = {package: _version(package) for package in packages}
    return {package: version for package, version in versions.items() if version}


def _providers(env_id: str) -> tuple[str, ...]:
    return next((modules for start, modules in PROVIDERS.items() if env_id.startswith(start)), ())


def _import_provider(module: str, task: str) -> None:
    is_installed = importlib.util.find_spec(module) is not None
    if module == "dm_control" and is_installed and (backend := rendering_backend()):
        os.environ.setdefault("MUJOCO_GL", backend)  # dm_control chooses its backend when it is imported
    try:
        gymnasium.register_envs(importlib.import_module(module))
    except ModuleNotFoundError as error:
        raise PlanspaceError(
            f"{task} needs the package {error.name}: {install_command('robots')}."
        ) from error


def _version(package: str) -> str:
    """The version of an installed package; empty if it is unknown."""
    try:
        return importlib.metadata.version(package)
    except (importlib.metadata.PackageNotFoundError, ValueError):
        return ""
