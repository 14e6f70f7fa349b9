"""When stop criteria are checked."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pytest

from cornercase.evidence._critical_set_estimate import CriticalSet
from cornercase.exploration._stop_criteria import StopCriteria
from cornercase.optimizers import Sobol
from cornercase.scenario import ParameterSpace
from cornercase.stop._stop_rules import StopCriterion
from cornercase.study import StudyFile
from cornercase.study._criterion import Criterion
from helpers import synthetic_study as synthetic
from helpers.synthetic_study import SPACE

SQUARE = ParameterSpace.from_ranges(["a=0:1", "b=0:1"])


@dataclass(frozen=True)
class NeverReached(StopCriterion):
    """Criterion that remembers how often it was checked."""

    checked: list[CriticalSet] = field(default_factory=list)

    def evaluate(self, critical_set: CriticalSet) -> float:
        self.checked.append(critical_set)
        return 1.0


@pytest.mark.parametrize("at_once", [1, 10])
def test_criteria_are_checked_whenever_the_scenarios_have_grown_by_a_tenth(at_once):
    points = Sobol().start(SQUARE, 0).ask(200)
    scores = np.hypot(*points.T) - 0.5
    rule, checks = NeverReached("missed", 0.05), []
    criteria = StopCriteria([rule], SQUARE, Criterion(0.0), 0, "sobol")
    for first in range(0, 200, at_once):
        criteria.add_results(points[first : first + at_once], scores[first : first + at_once])
        before = len(rule.checked)
        assert criteria.describe_if_all_reached() is None
        if len(rule.checked) > before:
            checks.append(first + at_once)
    assert checks[0] == 40
    growth = np.array(checks[1:]) / np.array(checks[:-1])
    assert (growth < 1.1 + at_once / 40).all()
    # Up to 100 scenarios after each round of ten.
    assert checks[:7] == ([40, 44, 49, 54, 59, 65, 71] if at_once == 1 else [40, 50, 60, 70, 80, 90, 100])
    assert len(checks) == (17 if at_once == 1 else 14)


def test_criteria_that_are_new_to_a_study_are_checked_before_it_goes_on(tmp_path):
    rule = {"stop_when": ("unvisited(0.05)<0.5",), "critical": 1.0}
    with StudyFile.create(tmp_path / "s.db", synthetic.about(SPACE, "distance", critical=1.0)) as study:
        synthetic.explorer(study, optimizer="sobol", batch=1, budget=70).run()
        result = synthetic.explorer(study, optimizer="sobol", batch=1, budget=200, **rule).run()
    # The last check was due before these 70 scenarios.
    assert result.n_finished == 70
    assert "the space" in result.reason


def test_a_resumed_search_repeats_the_last_check_and_no_other():
    points = Sobol().start(SQUARE, 0).ask(70)
    scores = np.hypot(*points.T) - 0.5
    rules = [NeverReached("missed", 0.05), NeverReached("missed", 0.05)]
    going_on, resumed = (StopCriteria([rule], SQUARE, Criterion(0.0), 0, "sobol") for rule in rules)
    for point, score in zip(points, scores, strict=True):
        going_on.add_results(point[None], score[None])
        assert going_on.describe_if_all_reached() is None
        resumed.add_results(point[None], score[None])
    assert resumed.describe_if_all_reached() is resumed.describe_if_all_reached() is None
    (repeated,) = rules[1].checked
    assert repeated.unexplored_fraction() == rules[0].checked[-1].unexplored_fraction()
