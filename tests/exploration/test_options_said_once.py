"""An option of an exploration is one entry of a table, from which everything else is made."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from dataclasses import fields
from pathlib import Path

import pytest

import cornercase
from cornercase.exploration._explore_options import (
    OPTIONS,
    ExplorationOptions,
    ExploreOptions,
    OneTimeOptions,
    SpaceOptions,
)

PACKAGE = Path(cornercase.__file__).parent
ROOT = Path(__file__).parents[2]
TABLE = "_explore_options.py"
ENTRY = '    mood: int = _search(3, "How bold the search is.", metavar="N", minimum=1, maximum=9, stored="settings")\n'
TRY = """
import importlib, json, sys
from pathlib import Path
from typer.testing import CliRunner
import cornercase
from cornercase.cli import app
from cornercase.cli.config_file import read_explore_options
from cornercase.cli.option_names import use_option_names
from cornercase.exploration._config import ExplorationConfig, config_from_study
from cornercase.report._repeat_command import format_repeat_command, format_toml_study_file
from cornercase.study import StudyFile

folder, files = Path(sys.argv[1]), "examples/x_intersection/x_intersection"
found = {"help": CliRunner().invoke(app, ["explore", "--help"], env={"COLUMNS": "100"}).stdout}
sys.path.insert(0, "docs")
importlib.import_module("generated_pages").write_options(folder / "options.md")
found["page"] = (folder / "options.md").read_text(encoding="utf-8")
found["docstring"] = cornercase.explore.__doc__
found["message"] = use_option_names("`mood` is too bold")
(folder / "good.toml").write_text("mood = 5", encoding="utf-8")
found["file"] = read_explore_options(folder / "good.toml")
(folder / "bad.toml").write_text("mood = 'good'", encoding="utf-8")
options = dict(ego="Ego", other="Pedestrian", metrics=["distance"], space=f"{files}.space.xosc")
for name, attempt in {
    "bad file": lambda: read_explore_options(folder / "bad.toml"),
    "bad value": lambda: cornercase.explore(f"{files}.xosc", folder / "bad.db", mood=10, **options),
}.items():
    try:
        attempt()
    except cornercase.InputError as error:
        found[name] = str(error)
for name, given in {"given": {"mood": 7}, "default": {}}.items():
    study = folder / f"{name}.db"
    logical = cornercase.LogicalScenario.read(f"{files}.xosc", options["space"])
    config = ExplorationConfig(logical, ego="Ego", other="Pedestrian", metrics=("distance",), **given)
    StudyFile.create(study, config.make_study_meta(config.make_objective(), {"time_step": 0.1}, study=study)).close()
    with StudyFile.open(study, readonly=True) as opened:
        found[name] = {
            "settings": opened.meta.settings.get("mood"), "command": format_repeat_command(opened.meta),
            "config": config_from_study(opened, study, None, None, {}).mood,
        }
    found[name]["toml"] = format_toml_study_file(study)
print(json.dumps(found))
"""


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    """What the package says and does after one line more in the table."""
    folder = tmp_path_factory.mktemp("option")
    package = folder / "package" / "cornercase"
    shutil.copytree(PACKAGE, package, ignore=lambda at, names: [name for name in names if name.endswith(".nbi")])
    table = package / "exploration" / TABLE
    text = table.read_text(encoding="utf-8")
    assert text.count("    patience: int | None = _search(") == 1
    table.write_text(text.replace("    patience: int", f"{ENTRY}    patience: int", 1), encoding="utf-8")
    done = subprocess.run(
        [sys.executable, "-c", TRY, folder], cwd=ROOT, capture_output=True, text=True, check=False, timeout=60,
        env=os.environ | {"PYTHONPATH": str(folder / "package")},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_an_added_option_is_in_the_help_the_page_and_python(found):
    assert re.search(r"--mood N +How bold the search is\. +\[default: 3; x>=1\]", found["help"])
    assert "| `--mood N` | `mood` | `3` | yes | How bold the search is. |" in found["page"]
    assert "    mood : int, default 3\n        How bold the search is." in found["docstring"]
    assert found["message"] == "--mood is too bold"
    assert found["bad value"] == "`mood` 10: give a whole number from 1 to 9."


def test_an_added_option_is_read_from_and_checked_in_a_study_file(found):
    assert found["file"] == {"mood": 5}
    assert found["bad file"].endswith("'mood' is not a whole number.")


def test_an_added_option_is_stored_and_repeated(found):
    assert found["given"]["settings"] == found["given"]["config"] == 7
    assert " --mood 7 " in found["given"]["command"]
    assert "\nmood = 7\n" in found["given"]["toml"]


def test_an_added_option_changes_no_study_that_does_not_use_it(found):
    assert found["default"]["settings"] is None
    assert found["default"]["config"] == 3
    assert "mood" not in found["default"]["command"] + found["default"]["toml"]


def test_type_checkers_know_the_options_of_the_table():
    """A sequence is taken where a tuple is stored, and None where an empty mapping is."""
    typed = {name: str(getattr(kind, "__forward_arg__", kind)) for name, kind in ExploreOptions.__annotations__.items()}
    table = {
        item.name: str(item.type)
        for group in (SpaceOptions, ExplorationOptions, OneTimeOptions)
        for item in fields(group)
    }
    required = {name for name, option in OPTIONS.items() if option.default is ...}
    assert required == {"ego", "other", "metrics"}
    assert {name: kind.removesuffix(" | None") for name, kind in typed.items()} == {
        name: kind.replace("tuple[str, ...]", "Sequence[str]").removesuffix(" | None")
        for name, kind in table.items()
        if name not in required
    }


def test_an_unknown_option_is_refused_with_a_suggestion(tmp_path):
    with pytest.raises(
        TypeError, match=r"explore\(\) got an unexpected keyword argument 'budjet'; did you mean 'budget'"
    ):
        cornercase.explore("a.xosc", tmp_path / "s.db", ego="Ego", other="B", metrics=["ttc"], budjet=3)  # type: ignore[call-arg]
    with pytest.raises(TypeError, match=r"estimate\(\) got an unexpected keyword argument 'worker'"):
        cornercase.estimate(tmp_path / "s.db", tmp_path / "e.db", worker=3)  # type: ignore[call-arg]
    with pytest.raises(TypeError, match=r"run_suite\(\) got an unexpected keyword argument 'worker'"):
        cornercase.run_suite(tmp_path, tmp_path / "e.db", worker=3)  # type: ignore[call-arg]
    assert not list(tmp_path.iterdir())
