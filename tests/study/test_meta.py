"""What a study is about."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from cornercase._common.errors import InputError
from cornercase.scenario import ParameterSpace
from cornercase.study import StudyMeta
from helpers.synthetic_study import about

SPACE = ParameterSpace.from_ranges(["a=0:10", "b=0:1:0.1"])
PLAIN = about(SPACE, "distance")
FULL = about(
    SPACE, "distance", "wttc", settings={"drivers": {"Ego": "normal"}}, critical=0.5, weights={"wttc": 2.0}, seed=3,
    repeats=4, most_repeats=9, files=("a.csv", "b.csv"),
)  # fmt: skip


@pytest.mark.parametrize("meta", [PLAIN, FULL])
def test_what_was_written_is_read_back(meta):
    assert StudyMeta.from_json(json.loads(json.dumps(meta.to_json()))) == meta


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"ego": "Other"}, "another ego"),
        ({"space": ParameterSpace.from_ranges(["a=0:11", "b=0:1:0.1"])}, "other parameter ranges"),
        ({"metrics": ("wttc", "distance")}, "other metrics"),
        ({"settings": {}}, "other simulator settings"),
        ({"repeats": 1}, "another number of repeats"),
        ({"most_repeats": None}, "another largest number of repeats"),
        ({"simulator": "other:host=a"}, "another simulator"),
        ({"critical": 0.6}, r"a search with the threshold 0.5"),
    ],
)
def test_a_study_of_something_else_is_refused(change, words):
    with pytest.raises(InputError, match=f"s.db: belongs to {words}"):
        FULL.require_resumable(replace(FULL, **change), Path("s.db"))


def test_a_range_without_a_unit_is_the_same_range():
    """A range given as an option has no unit; `show --config` writes such options, also for files with units."""
    in_metres = ParameterSpace((replace(SPACE.parameters[0], unit="m"), SPACE.parameters[1]))
    for mine, given in ((in_metres, SPACE), (SPACE, in_metres)):
        replace(FULL, space=mine).require_resumable(replace(FULL, space=given), Path("s.db"))
    in_seconds = ParameterSpace((replace(SPACE.parameters[0], unit="s"), SPACE.parameters[1]))
    with pytest.raises(InputError, match="other parameter ranges"):
        replace(FULL, space=in_metres).require_resumable(replace(FULL, space=in_seconds), Path("s.db"))


def test_the_budget_may_grow_and_the_simulator_run_elsewhere():
    more = replace(FULL, budget=500, simulator="synthetic:host=a", version="0.0.1")
    FULL.require_resumable(more, Path("s.db"))
    replace(FULL, critical=None).require_resumable(more, Path("s.db"))
    with pytest.raises(InputError, match="a budget of 0 scenarios; give the same `budget`"):
        FULL.require_resumable(more, Path("s.db"), same_budget=True)
