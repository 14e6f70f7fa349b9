"""The search that is taken where none is named."""

from __future__ import annotations

from typing import Any

import pytest

from cornercase import Problem, Study, explore
from cornercase._common.errors import InputError
from cornercase.exploration._config import ExplorationConfig
from cornercase.exploration._paper_examples import paper_experiment_config
from cornercase.optimizers import Sobol
from cornercase.report._repeat_command import format_repeat_command
from cornercase.study import StudyFile
from helpers.synthetic_study import LOGICAL

CROSSING = paper_experiment_config("t-intersection").logical
ROLES: dict[str, Any] = {"ego": "Ego", "other": "C"}


@pytest.mark.parametrize(
    ("given", "name"),
    [
        ({"metrics": "ttc"}, "auto"),
        ({"metrics": "distance"}, "bayes"),
        ({"metrics": "distance", "critical": 2.0}, "auto"),
        ({"metrics": "distance", "critical_if": "ttc < 1"}, "auto"),
        ({"metrics": ("ttc", "distance"), "weights": {"ttc": 1.0, "distance": 0.1}}, "bayes"),
        ({"metrics": ("ttc", "distance"), "weights": {"ttc": 1.0, "distance": 0.1}, "critical": 1.0}, "auto"),
        ({"metrics": "distance", "optimizer": "sobol", "critical": 2.0}, "sobol"),
    ],
)
def test_it_is_auto_if_it_is_known_what_is_critical_and_bayes_otherwise(given, name):
    config = ExplorationConfig(LOGICAL, ego="Ego", other="B", **given)
    assert str(config.search) == name
    assert config.make_study_meta(config.make_objective(), {}).optimizer == name


def test_a_study_names_it_and_so_does_the_command_that_repeats_it(tmp_path):
    study = Study.create(tmp_path / "s.db", Problem(CROSSING, **ROLES, metrics="ttc"))
    study.explore(budget=2)
    assert study.optimizer == "auto"
    with StudyFile.open(study.path) as file:
        assert "--optimizer auto" in format_repeat_command(file.meta)
    explore(CROSSING, tmp_path / "without.db", **ROLES, metrics="distance", budget=2)
    assert Study.open(tmp_path / "without.db").optimizer == "bayes"


def test_a_study_goes_on_with_the_search_that_it_began_with(tmp_path):
    given: dict[str, Any] = {**ROLES, "metrics": "ttc"}
    explore(CROSSING, tmp_path / "whole.db", **given, optimizer="bayes:filling=0", budget=26)
    explore(CROSSING, tmp_path / "later.db", **given, optimizer="bayes:filling=0", budget=20)
    explore(CROSSING, tmp_path / "later.db", **given, budget=26)
    with StudyFile.open(tmp_path / "whole.db") as whole, StudyFile.open(tmp_path / "later.db") as later:
        assert later.meta.optimizer == "bayes:filling=0"
        assert [row.point.tolist() for row in later.rows()] == [row.point.tolist() for row in whole.rows()]
    assert explore(CROSSING, tmp_path / "later.db", **given, budget=26, check_proposals=True).reproducible


class OwnSearch(Sobol):
    """A search of the user's own."""

    name = "own-search"


def test_a_search_of_the_users_own_is_to_be_given_again(tmp_path):
    given: dict[str, Any] = {**ROLES, "metrics": "ttc"}
    explore(CROSSING, tmp_path / "own.db", **given, optimizer=OwnSearch(), budget=2)
    with pytest.raises(InputError, match="which is not among those of cornercase"):
        explore(CROSSING, tmp_path / "own.db", **given, budget=4)
    explore(CROSSING, tmp_path / "own.db", **given, optimizer=OwnSearch(), budget=4)


def test_other_metrics_than_those_of_the_study_are_named_though_its_search_needs_a_threshold(tmp_path):
    explore(CROSSING, tmp_path / "s.db", **ROLES, metrics="ttc", optimizer="level-set", budget=2)
    with pytest.raises(InputError, match=r"other metrics \(ttc in the study, distance given\)"):
        explore(CROSSING, tmp_path / "s.db", **ROLES, metrics="distance", budget=4)


def test_other_metrics_than_those_of_a_front_are_named(tmp_path):
    given: dict[str, Any] = {**ROLES, "pareto": True}
    explore(CROSSING, tmp_path / "s.db", **given, metrics=["distance", "ttc"], optimizer="evolutionary", budget=2)
    with pytest.raises(InputError, match=r"other metrics \(distance, ttc in the study, distance, pet given\)"):
        explore(CROSSING, tmp_path / "s.db", **given, metrics=["distance", "pet"], budget=4)
