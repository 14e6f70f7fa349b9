"""What a page holds to predict scores between its scenarios."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cornercase.report._predictor_payload import predictor_payload
from cornercase.report._report_data import read_report_data
from cornercase.scenario import Parameter, ParameterSpace
from cornercase.scenario._distributions import Distribution
from cornercase.study import StudyFile
from helpers.synthetic_study import SPACE, Synthetic, about

LAWS = ParameterSpace(
    [
        Parameter("way", 0, 2, choices=("left", "right", "straight on")),
        Parameter("speed", 5.0, 15.0, 0.5, unit="m/s", distribution=Distribution("normal", 5.0, 15.0, (10.0, 2.0))),
        Parameter("gap", 1.0, 4.0),
    ]
)


def payload_of(path, scores, space=SPACE, count=60, **more):
    """The payload of a study whose scores by distance are a function of its points."""
    with StudyFile.create(path, replace(about(space, "distance", "wttc"), **more)) as study:
        points = space.snap(np.random.default_rng(1).random((count, space.dimension)))
        values = scores(points)
        for k, row in enumerate(study.writer.add_pending(1, points, space.values(points))):
            (found,) = Synthetic().run([type("C", (), {"values": {"a": 0.5, "b": 0.2}})])
            result = {name: (np.full(5, values[k]), float(values[k])) for name in ("distance", "wttc")}
            study.writer.record_result(row.id, found, result)
    with StudyFile.open(path, readonly=True) as study:
        return predictor_payload(read_report_data(study, charts=False))


def test_what_is_predicted_is_told_with_how_well(tmp_path):
    payload = payload_of(tmp_path / "s.db", lambda points: 10.0 * points[:, 0] + points[:, 1])
    predictor = payload["predictor"]
    assert payload["predictor_missing"] == ""
    assert predictor["predicted"] > 0.9
    assert (predictor["metric"], predictor["unit"], predictor["count"]) == ("distance", "m", 60)
    # Each of 101 steps is in the middle of its part of the unit interval.
    assert predictor["positions"] == [[[0.0, 1.0], [0.5 / 101, 100.5 / 101]], [[0.0, 1.0], [0.0, 1.0]]]


def test_where_hardly_anything_is_predicted_that_is_said_instead(tmp_path):
    noise = np.random.default_rng(0).normal(size=60)
    payload = payload_of(tmp_path / "s.db", lambda points: noise + 5.0)
    assert payload["predictor"] is None
    assert "predict hardly anything of distance" in payload["predictor_missing"]


@pytest.mark.parametrize(("count", "more"), [(60, {"pareto": True}), (9, {})])
def test_a_front_and_few_scenarios_have_nothing_to_predict(tmp_path, count, more):
    payload = payload_of(tmp_path / "s.db", lambda points: points[:, 0] + 1.0, count=count, **more)
    assert payload == {"predictor": None, "predictor_missing": ""}


def test_positions_follow_the_distribution(tmp_path):
    payload = payload_of(tmp_path / "s.db", lambda points: points.sum(axis=1), LAWS)
    way, speed, gap = payload["predictor"]["positions"]
    assert way is None
    assert gap == [[1.0, 4.0], [0.0, 1.0]]
    values, positions = speed
    assert np.interp(10.0, values, positions) == pytest.approx(0.5, abs=0.01)
    assert np.interp(12.0, values, positions) == pytest.approx(LAWS.parameters[1].unit_position(12.0))
