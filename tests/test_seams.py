"""Objects that users hand over: imported, checked, and described as plain data."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar, Protocol, runtime_checkable

import pytest

from planspace.errors import UsageError
from planspace.seams import check_fits, load_object, name_of, plain_settings


@runtime_checkable
class Walker(Protocol):
    def start(self) -> None: ...
    def step(self) -> None: ...


@dataclass(frozen=True)
class Fits:
    name: ClassVar[str] = "fits"
    speed: float = 2.0

    def start(self) -> None: ...
    def step(self) -> None: ...


@dataclass(frozen=True)
class Group:
    walker: Walker = field(default_factory=Fits)
    sizes: tuple[int, ...] = (1, 2)


def test_a_file_and_a_name_give_the_object(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "seams_example.py").write_text("ANSWER = 42\n")
    monkeypatch.chdir(tmp_path)
    assert load_object("seams_example.py:ANSWER") == 42
    assert load_object("seams_example:ANSWER") == 42


@pytest.mark.parametrize(
    ("where", "message"),
    [
        ("nothing", "expected module.py:NAME, got 'nothing'."),
        ("missing.py:X", "missing.py does not exist, so X cannot be imported from it."),
        ("seams_named.py:ANSWR", "seams_named has no 'ANSWR'. Did you mean 'ANSWER'?"),
        ("seams_broken.py:X", "importing seams_broken failed: ZeroDivisionError: division by zero"),
    ],
)
def test_what_cannot_be_imported_is_explained(
    where: str, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "seams_named.py").write_text("ANSWER = 42\n")
    (tmp_path / "seams_broken.py").write_text("1 / 0\n")
    monkeypatch.chdir(tmp_path)
    with pytest.raises(UsageError) as error:
        load_object(where)
    assert str(error.value).startswith(message)


def test_an_object_that_fits_is_returned() -> None:
    given = Fits()
    assert check_fits(given, Walker, "docs/howto/own-walker.md") is given


def test_a_misfit_is_refused_with_the_protocol_and_the_page() -> None:
    with pytest.raises(UsageError) as error:
        check_fits(3, Walker, "docs/howto/own-walker.md")
    assert str(error.value) == (
        "A Walker needs the methods start, step; 3 has no start, step. See docs/howto/own-walker.md."
    )
    with pytest.raises(UsageError) as error:
        check_fits(Fits, Walker, "docs/howto/own-walker.md")
    assert str(error.value) == (
        "expected a Walker, got the class Fits: pass an instance. See docs/howto/own-walker.md."
    )


def test_settings_name_their_seam_object_and_hash_foreign_code() -> None:
    settings = plain_settings(Group())
    assert settings["sizes"] == [1, 2]
    walker = settings["walker"]
    assert (walker["name"], walker["speed"], len(walker["source_sha256"])) == ("fits", 2.0, 64)


def test_an_object_without_a_name_is_known_by_where_it_is_defined() -> None:
    assert name_of(test_an_object_that_fits_is_returned) == (
        f"{__name__}:test_an_object_that_fits_is_returned"
    )
