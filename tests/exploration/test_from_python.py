"""Exploring from Python: accepted and refused arguments."""

from __future__ import annotations

import contextlib
import sqlite3
from functools import partial
from typing import Any

import numpy as np
import pytest

from cornercase._common.errors import InputError
from cornercase.drivers._resolve import driver_by_name
from cornercase.exploration import examples_folder, explore
from cornercase.exploration._config import ExplorationConfig
from cornercase.exploration._paper_examples import paper_experiment_config
from cornercase.scenario import LogicalScenario
from cornercase.study import StudyFile

T = examples_folder() / "t_intersection"


def test_from_python_a_scenario_is_explored_by_its_path_or_as_it_was_read(tmp_path):
    search = partial(explore, ego="Ego", other="C", metrics=["distance"], optimizer="sobol", seed=1)
    file, space = T / "t_intersection.xosc", T / "t_intersection.space.xosc"
    found = search(file, tmp_path / "a.db", space=space, budget=3)
    assert (found.study, found.done, found.failed, found.n_finished) == (tmp_path / "a.db", 3, 0, 3)
    assert "3 scenarios done" in repr(found)
    assert "budget of 3" in repr(found)
    logical = LogicalScenario.read(file, space)
    normal = driver_by_name("normal")
    search(logical, str(tmp_path / "b.db"), budget=2)
    # A larger budget continues it.
    assert search(logical, tmp_path / "b.db", budget=3).n_finished == 3
    driven = search(logical, tmp_path / "c.db", budget=2, drivers={"Ego": normal})
    with StudyFile.open(driven.study, readonly=True) as study:
        assert study.meta.settings["drivers"] == {"Ego": "normal"}
    with (
        StudyFile.open(tmp_path / "a.db", readonly=True) as one,
        StudyFile.open(tmp_path / "b.db", readonly=True) as two,
    ):
        np.testing.assert_array_equal(one.scores("distance"), two.scores("distance"))
    with pytest.raises(InputError, match="apply to scenario files only"):
        search(logical, tmp_path / "d.db", space=space)


@pytest.mark.parametrize("given", [{"budget": 0}, {"batch": 0}, {"seed": -1}, {"repeats": 0}, {"patience": 0}])
def test_numbers_out_of_range_are_refused(given):
    (name,) = given
    with pytest.raises(InputError, match=f"`{name}`"):
        ExplorationConfig(
            paper_experiment_config("t-intersection").logical, ego="Ego", other="C", metrics=("distance",), **given
        )


NAN = float("nan")


T_SEARCH = {
    "scenario": T / "t_intersection.xosc",
    "space": T / "t_intersection.space.xosc",
    "ego": "Ego",
    "other": "C",
    "metrics": ["distance"],
    "optimizer": "sobol",
    "budget": 2,
}


WRONG = {
    "scenario": (3,),
    "space": (3, ["a"]),
    "ego": (None, 3),
    "other": (None, 3),
    "metrics": (None, [3], [None], 3),
    "ranges": ([("a", 0, 1)], None, 3),
    "continuous": ("yes",),
    "optimizer": (3,),
    "critical": ("x", NAN),
    "weights": ({"distance": "x"}, [("distance", 1)], "distance", {3: 1.0}),
    "pareto": ("yes",),
    "stop_when": (None, [3]),
    "budget": (NAN, "4", None, 2.5, True, float("inf")),
    "batch": ("4", 1.5, None),
    "patience": ("4", 1.5),
    "max_seconds": (NAN, -1, "4"),
    "seed": ("4", 1.5, None),
    "simulator": (None, 3),
    "workers": ("4", 1.5, None, 99_999_999),
    "timeout": ("4", NAN, 0),
    "retries": ("4", 1.5),
    "repeats": ("4", 1.5),
    "max_repeats": ("4", 1.5, 0, True),
    "time_step": ("4", None, NAN),
    "duration": ("4", None, NAN),
    "on_collision": (None, 3, "stopp"),
    "drivers": (
        "normal",
        ["normal"],
        {"Ego": 3},
        {"Ego": type(driver_by_name("normal"))},
        {"Ego": None},
        {3: "normal"},
    ),
    "progress": ("yes",),
}


@pytest.mark.parametrize(("name", "wrong"), [(name, wrong) for name, several in WRONG.items() for wrong in several])
def test_what_is_of_another_type_is_refused_in_one_sentence_and_nothing_is_written(tmp_path, name, wrong):
    given: dict[str, Any] = T_SEARCH | {name: wrong}
    with pytest.raises(InputError, match=f"^`{name}` .*: .*[.?]$"):
        explore(given.pop("scenario"), tmp_path / "s.db", **given)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("study", [None, 3])
def test_a_study_without_a_path_is_refused(study):
    given: dict[str, Any] = dict(T_SEARCH)
    with pytest.raises(InputError, match=r"^`study` .*: give the path"):
        explore(given.pop("scenario"), study, **given)


def test_numbers_of_numpy_are_numbers(tmp_path):
    of_numpy: dict[str, Any] = {
        "seed": np.int64(3), "budget": np.int32(2), "batch": np.uint8(2), "critical": np.float32(2.5),
        "time_step": np.float64(0.1), "duration": np.int64(5),
    }  # fmt: skip
    usual = {name: value.item() for name, value in of_numpy.items()}
    for name, numbers in (("a.db", of_numpy), ("b.db", usual)):
        given: dict[str, Any] = T_SEARCH | numbers
        explore(given.pop("scenario"), tmp_path / name, **given)
    with (
        StudyFile.open(tmp_path / "a.db", readonly=True) as one,
        StudyFile.open(tmp_path / "b.db", readonly=True) as two,
    ):
        assert one.meta == two.meta


def test_a_driven_entity_that_is_not_there_is_refused_before_there_is_a_study(tmp_path):
    given: dict[str, Any] = dict(T_SEARCH)
    scenario = given.pop("scenario")
    with pytest.raises(InputError, match="has no entity 'Nobody' to be the driven entity"):
        explore(scenario, tmp_path / "typo.db", drivers={"Nobody": "normal"}, **given)
    assert not list(tmp_path.iterdir())
    assert explore(scenario, tmp_path / "typo.db", drivers={"Ego": "normal"}, **given).n_finished == 2


def test_a_study_whose_budget_grew_is_that_of_the_larger_budget_byte_for_byte(tmp_path):
    def stored(name, *budgets):
        for budget in budgets:
            given: dict[str, Any] = T_SEARCH | {"budget": budget, "batch": 2}
            explore(given.pop("scenario"), tmp_path / name, **given)
        with contextlib.closing(sqlite3.connect(tmp_path / name)) as connection:
            return [
                sorted(connection.execute(f"SELECT * FROM {table}").fetchall())
                for table in ("meta", "scenarios", "courses")
            ]

    grown = stored("grown.db", 2, 5)
    assert grown == stored("at_once.db", 5)
    assert grown == stored("grown.db", 3)
