"""Pages of the reference that are made from the program."""

from __future__ import annotations

import importlib
import inspect
import sys
from pathlib import Path

import pytest

DOCS = Path(__file__).parents[2] / "docs"


@pytest.fixture
def pages(monkeypatch):
    monkeypatch.syspath_prepend(str(DOCS))
    yield importlib.import_module("generated_pages")
    sys.modules.pop("generated_pages", None)


def test_every_public_name_is_on_the_page_of_its_room_and_every_value_is_described(pages, tmp_path):
    pages.write_names(tmp_path / "api.rst", tmp_path / "api")
    described = 0
    for room in pages.ROOMS:
        text = (tmp_path / "api" / f"{room}.rst").read_text("utf-8")
        module = importlib.import_module(f"cornercase.{room}")
        for name in dir(module):
            shown = getattr(module, name)
            if inspect.isclass(shown) or inspect.isfunction(shown):
                assert f"\n   {name}\n" in text, name
            elif f".. py:data:: {name}\n" in text:
                described += 1
    assert described > 10
    start = (tmp_path / "api.rst").read_text("utf-8")
    for name, room in {"optimizers": "optimizers", "stop": "stop", "simulators": "simulators"}.items():
        assert f":doc:`cornercase.{name} <api/{room}>`" in start
        assert (tmp_path / "api" / f"{room}.rst").exists()
    # What `help` says of any text or union is nothing about it.
    made = "".join(page.read_text("utf-8") for page in tmp_path.rglob("*.rst"))
    assert "str(object" not in made
    assert "Criticality metrics by name." in made


def test_the_page_of_commands_has_each_with_its_help(pages, tmp_path):
    pages.write_commands(tmp_path / "commands.md")
    text = (tmp_path / "commands.md").read_text("utf-8")
    assert text.count("\nUsage: cornercase ") == text.count("\n## ") > 15
    # Each leads to a page that says what to do with it.
    assert text.count("\nGuide: [") == text.count("\n## ")
    assert all((DOCS / guide).exists() for guide in pages.GUIDES.values())


def test_the_page_of_each_metric_and_optimizer_says_its_name_as_text(pages):
    from cornercase import metrics, optimizers, simulators

    described = {
        name: pages.describe_registration(getattr(room, name))
        for room, base in ((metrics, metrics.Metric), (optimizers, optimizers.Optimizer))
        for name in dir(room)
        if inspect.isclass(shown := getattr(room, name)) and issubclass(shown, base) and shown is not base
    }
    assert [name for name, text in described.items() if not text.startswith("As text: ``")] == []
    assert described["Wttc"] == "As text: ``wttc``. Default threshold: 1 s."
    assert described["Drac"] == "As text: ``drac``. Without a default threshold."
    assert described["LevelSet"] == "As text: ``level-set``."
    assert pages.describe_registration(simulators.Builtin) == "As text: ``builtin``."
    assert pages.describe_registration(metrics.Metric) == ""
    lines = ["First line.", "", "Parameters"]
    pages.add_registration(None, "class", "", metrics.Wttc, None, lines)
    assert lines == ["First line.", "", described["Wttc"], "", "Parameters"]
