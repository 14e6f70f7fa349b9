"""Options of registered objects."""

from __future__ import annotations

import shutil
from types import SimpleNamespace
from typing import Any

import pytest

from cornercase._common.errors import InputError
from cornercase._common.registry import Registry
from cornercase.drivers import DRIVERS
from cornercase.metrics import METRICS


class Annotated:
    def __init__(
        self, fast: bool = False, count: int = 1, width: float = 1.0, text: str = "", free: Any = None
    ) -> None:
        self.given = (fast, count, width, text, free)


class Plain:
    def __init__(self, fast=False, count=1, width=1.0, text="", free=None):
        self.given = (fast, count, width, text, free)


def registry(factory: Any) -> Registry[Any]:
    made: Registry[Any] = Registry("thing", "cornercase.none")
    made.register("thing", factory)
    return made


@pytest.mark.parametrize("factory", [Annotated, Plain])
def test_an_option_has_the_type_of_its_parameter(factory):
    made = registry(factory).create("thing:fast=True,count=3,width=2,text=7,free=7")
    assert made.given == (True, 3, 2, "7", 7)
    assert made.given[0] is True
    assert registry(factory).create("thing:width=2.5,free=true").given == (False, 1, 2.5, "", True)


@pytest.mark.parametrize(
    ("option", "taken"),
    [
        ("fast=no", "true or false"),
        ("fast=maybe", "true or false"),
        ("fast=0", "true or false"),
        ("count=true", "a (whole )?number"),
        ("count=many", "a (whole )?number"),
        ("width=false", "a number"),
        ("width=wide", "a number"),
    ],
)
@pytest.mark.parametrize("factory", [Annotated, Plain])
def test_a_value_of_another_type_is_refused(factory, option, taken):
    name, _, value = option.partition("=")
    with pytest.raises(InputError, match=f"The thing 'thing' takes {taken} for '{name}', not '{value}'"):
        registry(factory).create(f"thing:{option}")


def test_an_unknown_option_is_told_alike_as_keyword_and_as_text():
    for options in ({"widht": 2.0}, {}):
        with pytest.raises(InputError, match="The thing 'thing' has no option 'widht'; did you mean 'width'"):
            registry(Annotated).create("thing" if options else "thing:widht=2", **options)
    with pytest.raises(InputError, match="has no option 'width'; its constructor declares none"):
        registry(lambda: None).create("thing", width=2.0)


def test_nothing_after_the_colon_is_told_by_what_takes_the_whole_text():
    for name, words in (
        ("fmu:", "give its file as in"),
        ("exec:", "needs a command"),
        ("stl:", "give a bound such as"),
    ):
        with pytest.raises(InputError, match=words):
            (METRICS if name == "stl:" else DRIVERS).create(name)
    with pytest.raises(InputError, match="ends in a colon; give options as in 'thing:name=value'"):
        registry(Annotated).create("thing:")


def test_what_takes_whole_numbers_takes_no_others():
    with pytest.raises(InputError, match="takes a whole number for 'count'"):
        registry(Annotated).create("thing:count=2.5")
    assert registry(Plain).create("thing:count=2.5").given[1] == 2.5


def test_an_option_that_may_be_none_has_the_type_beside():
    def make(count: int | None = None, text: str | None = None, free: int | str = 0):
        return SimpleNamespace(given=(count, text, free))

    assert registry(make).create("thing:count=2.0,text=7,free=7").given == (2, "7", 7)
    with pytest.raises(InputError, match="takes a whole number for 'count', not 'none'"):
        registry(make).create("thing:count=none")


def test_a_package_that_is_installed_or_removed_meanwhile_is_noticed(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(tmp_path))
    assert registry(Plain).names() == ["thing"]
    about = tmp_path / "late-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: late\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text("[cornercase.none]\nlate = late:Late\n")
    assert registry(Plain).names() == ["late", "thing"]
    shutil.rmtree(about)
    assert registry(Plain).names() == ["thing"]


def test_a_broken_package_is_named_in_one_sentence(tmp_path, monkeypatch):
    (tmp_path / "broken-1.0.dist-info").mkdir()
    (tmp_path / "broken_thing.py").write_text("raise OSError('no such\\nlibrary.')")
    (tmp_path / "broken-1.0.dist-info" / "METADATA").write_text("Metadata-Version: 2.1\nName: broken\nVersion: 1.0\n")
    (tmp_path / "broken-1.0.dist-info" / "entry_points.txt").write_text("[cornercase.none]\nbent = broken_thing:Bent\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    with pytest.raises(InputError) as refused:
        registry(Plain).create("bent")
    assert str(refused.value) == (
        "The thing 'bent' cannot be loaded since broken_thing:Bent fails: OSError: no such library."
    )
