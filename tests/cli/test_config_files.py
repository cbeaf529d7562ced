"""`--config FILE`, and the options that decide which settings exist."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar, Literal

import pytest

from planspace.cli.config_files import given_option, read_config, with_settings
from planspace.errors import PlanspaceError, UsageError
from planspace.rl.config import TrainConfig


@dataclass(frozen=True)
class Inner:
    name: ClassVar[str] = "inner"
    rate: float = 0.5
    sizes: tuple[int, ...] = (64, 64)
    norm: float | None = None


@dataclass(frozen=True)
class Outer:
    steps: int = 10
    mode: Literal["fast", "exact"] = "fast"
    layer_norm: bool = False
    inner: Inner = field(default_factory=Inner)

    def __post_init__(self) -> None:
        if self.steps < 1:
            raise UsageError(f"steps must be at least 1, got {self.steps}.")


@pytest.mark.parametrize(
    ("arguments", "value"),
    [
        (["a", "--preset", "paper"], "paper"),
        (["--preset=paper"], "paper"),
        (["--preset", "paper", "--preset", "modern"], "modern"),
        (["--presets", "paper"], None),
        (["--preset"], None),
    ],
)
def test_an_option_is_found_before_parsing(arguments: list[str], value: str | None) -> None:
    assert given_option(arguments, "--preset") == value


def test_yaml_and_json_change_nested_settings(tmp_path: Path) -> None:
    (tmp_path / "c.yaml").write_text("steps: 3\ninner:\n  rate: 1\n  sizes: [8]\n  norm: 2.5\n")
    (tmp_path / "c.json").write_text(
        '{"steps": 3, "inner": {"name": "inner", "rate": 1, "sizes": [8], "norm": 2.5}}'
    )
    for file in ("c.yaml", "c.json"):
        settings = read_config(tmp_path / file)
        changed = with_settings(Outer(), settings, file)
        assert changed == Outer(steps=3, inner=Inner(1.0, (8,), 2.5))
        assert type(changed.inner.rate) is float


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"step": 3}, "f.yaml: unknown setting 'step'. Did you mean 'steps'?"),
        ({"steps": "3"}, "f.yaml: steps must be of type int, got '3'."),
        ({"steps": True}, "f.yaml: steps must be of type int, got True."),
        ({"steps": 0}, "f.yaml: steps must be at least 1, got 0."),
        ({"mode": "slow"}, "f.yaml: mode must be one of 'fast', 'exact', got 'slow'."),
        ({"inner": {"sizes": 8}}, "f.yaml: sizes must be a list, got 8."),
        ({"inner": {"norm": "none"}}, "f.yaml: norm must be of type float, got 'none'."),
        ({"inner": 3}, "f.yaml: inner must be a group of settings, got 3."),
    ],
)
def test_wrong_settings_are_refused_with_file_and_name(settings: dict, message: str) -> None:
    with pytest.raises(UsageError) as error:
        with_settings(Outer(), settings, "f.yaml")
    assert str(error.value).startswith(message)


def test_a_file_may_call_a_setting_what_the_command_line_calls_it() -> None:
    assert with_settings(TrainConfig(), {"seeds": 3}, "a.yaml").num_seeds == 3
    for names in (("seeds", "num_seeds"), ("num_seeds", "seeds")):
        with pytest.raises(UsageError, match=f"a.yaml: {names[0]} and {names[1]} are the same setting"):
            with_settings(TrainConfig(), dict.fromkeys(names, 3), "a.yaml")


def test_a_file_that_is_no_mapping_is_refused(tmp_path: Path) -> None:
    (tmp_path / "list.yaml").write_text("- 1\n")
    with pytest.raises(PlanspaceError, match="must hold keys and values"):
        read_config(tmp_path / "list.yaml")
    (tmp_path / "broken.yaml").write_text("{")
    with pytest.raises(PlanspaceError, match="is not valid YAML"):
        read_config(tmp_path / "broken.yaml")
