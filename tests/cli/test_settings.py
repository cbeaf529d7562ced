"""Every setting of planning, embedding and training is an option, with the defaults of preset and problem."""

import dataclasses
import json
from pathlib import Path
from typing import Any

import pytest

from planspace.cli.entry import parse
from planspace.embed.config import PRESETS as FIT_PRESETS
from planspace.embed.objectives import OBJECTIVES
from planspace.errors import UsageError
from planspace.plan.config import PlanConfig
from planspace.plan.planners import PLANNERS
from planspace.rl.algorithms import PRESETS as RL_PRESETS
from planspace.seams import plain_settings
from planspace.tasks.problem_file import load_problem

from .calls import call

GOLDEN_RUN = Path(__file__).parents[1] / "golden" / "2026-11" / "run" / "config.json"


def leaves(config: Any) -> list[str]:
    """Names of all settings, nested ones included."""
    found = []
    for field in dataclasses.fields(config):
        value = getattr(config, field.name)
        found += leaves(value) if dataclasses.is_dataclass(value) else [field.name]
    return found


def parsed(*words: object) -> Any:
    return parse([str(word) for word in words])


@pytest.mark.parametrize(
    ("words", "config"),
    [
        *[(["plan", "--planner", name], PlanConfig(planner)) for name, planner in PLANNERS.items()],
        *[(["embed", "x", "--objective", n], FIT_PRESETS["modern"].with_objective(n)) for n in OBJECTIVES],
        *[(["train", "--algo", algo, "--preset", preset], x) for (algo, preset), x in RL_PRESETS.items()],
    ],
    ids=lambda value: "-".join(value[1:]) if isinstance(value, list) else "",
)
def test_help_has_every_setting(words: list[str], config: Any, capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = call(capsys, *words, "--help")
    assert code == 0
    for name in set(leaves(config)) - {"algorithm"}:  # which OMPL planner it is, which --planner says
        assert name.replace("_", "-") in out.replace("--no-", "--"), name


def test_defaults_are_those_of_the_preset_and_options_win() -> None:
    verb = parsed("train", "cartpole", "--algo", "ppo", "--preset", "modern", "--discount", 0.9, "--out", "x")
    expected = RL_PRESETS["ppo", "modern"]
    assert verb.config.algorithm == dataclasses.replace(
        expected,
        on_policy=dataclasses.replace(expected.on_policy, discount=0.9),  # pyright: ignore
    )
    verb = parsed("embed", "x", "--preset", "paper", "--linearity", 2, "--out", "y")
    assert verb.config == FIT_PRESETS["paper"].with_settings(linearity=2.0)


def test_defaults_are_those_of_the_problem() -> None:
    for name in ("arm", "cartpole-swingup"):
        assert parsed("plan", name, "--out", "x").config == PlanConfig.for_problem(load_problem(name))
    assert parsed("plan", "arm", "--min-rounds", 9, "--out", "x").config.planner.min_rounds == 9


def test_what_a_run_recorded_is_a_config_file(tmp_path: Path) -> None:
    verb = parsed("train", "cartpole", "--max-kl", 0.5, "--hidden", 8, 8, "--seeds", 2, "--out", "x")
    recorded = {"task": "cartpole", "versions": {}, "embeddings": [], **plain_settings(verb.config)}
    (tmp_path / "config.json").write_text(json.dumps(recorded))
    again = parsed("train", "cartpole", "--config", tmp_path / "config.json", "--out", "x")
    assert again.config == verb.config
    other = parsed("train", "cartpole", "--config", tmp_path / "config.json", "--max-kl", 0.1, "--out", "x")
    assert other.config == verb.config.with_hyperparameters(max_kl=0.1)


def test_what_version_0_1_0_recorded_is_a_config_file() -> None:
    config = parsed("train", "cartpole", "--config", GOLDEN_RUN, "--out", "x").config
    assert (config.z, config.steps, config.num_seeds) == ("augment", 8000, 2)


def test_a_yaml_file_sets_what_it_names(tmp_path: Path) -> None:
    text = "preset: paper\nz_dim: 5\nobjective: {prior: 0.5}\nlearning_rate: 1e-4\n"
    (tmp_path / "fit.yaml").write_text(text)
    config = parsed("embed", "x", "--config", tmp_path / "fit.yaml", "--out", "y").config
    assert config == FIT_PRESETS["paper"].with_settings(z_dim=5, prior=0.5, learning_rate=1e-4)


@pytest.mark.parametrize(
    ("verb", "text", "message"),
    [
        ("train", "maxkl: 1", "unknown setting 'maxkl'"),
        ("train", "algorithm: {name: mine, source_sha256: ab}", "is your own code"),
        ("embed", "objective: {name: pca, linearity: 3}", "unknown setting 'linearity'"),
        ("embed", "z_dim: 0", "`z_dim` must be at least 1, got 0."),
        ("embed", "fit: [1]", "wrong.yaml: fit must be a group of settings, got [1]."),
        ("embed", "objective: pca", "wrong.yaml: objective must be a group of settings, got 'pca'."),
        ("train", "preset: [paper]", "wrong.yaml: preset must be a name, got ['paper']."),
        ("train", "algorithm: {name: 3}", "wrong.yaml: the name of the algorithm must be text, got 3."),
        ("plan", "settings: 3", "wrong.yaml: settings must be a group of settings, got 3."),
        ("plan", "settings: {config: 3}", "wrong.yaml: config must be a group of settings, got 3."),
        ("plan", "polish: 4", "wrong.yaml: polish must be a group of settings, got 4."),
        ("plan", "planner: {goal_bias: 7}", "`goal_bias` must be between 0 and 1, got 7.0."),
        ("plan", "planner: {name: sst, min_rounds: many}", "min_rounds must be of type int, got 'many'."),
    ],
)
def test_a_wrong_file_is_refused_with_its_name(verb: str, text: str, message: str, tmp_path: Path) -> None:
    (tmp_path / "wrong.yaml").write_text(text)
    with pytest.raises(UsageError) as error:
        parsed(verb, "x", "--config", tmp_path / "wrong.yaml", "--out", "y")
    assert message in str(error.value)


@pytest.mark.parametrize(
    ("arguments", "seam"),
    [
        (("embed", "demos"), "objective"),
        (("train", "cartpole"), "algorithm"),
        (("plan", "pendulum"), "planner"),
    ],
)
def test_a_config_file_cannot_run_code(arguments: tuple[str, ...], seam: str, tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(f"open({str(tmp_path / 'ran')!r}, 'w').close()\nMINE = 1\n")
    (tmp_path / "config.yaml").write_text(f"{seam}: {{name: '{tmp_path / 'mine.py'}:MINE'}}\n")
    with pytest.raises(UsageError, match="is your own code: name it on the"):
        parsed(*arguments, "--config", tmp_path / "config.yaml", "--out", "y")
    assert not (tmp_path / "ran").exists()
