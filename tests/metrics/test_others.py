"""Metrics against several others, compared with each of them alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given

from cornercase import InputError
from cornercase.metrics import METRICS, compute_features, measure, registered_features
from cornercase.metrics._measure import evaluate_metrics
from cornercase.metrics._other_entities import nearest_other, resolve_others
from cornercase.recordings import Collision
from cornercase.recordings._recording import MOTION_ARRAYS
from helpers.random_scenes import drive, quick, scenes
from helpers.two_cars import met

# Low and high critical, with and without a contact score, integrated over time, of the scene.
NAMES = ("distance", "clearance", "wttc", "ttc", "drac", "pet", "tet", "delta-v", "traffic-quality")


@quick
@given(scenes)
def test_of_several_the_most_critical_counts_and_is_named(scene):
    metrics = [METRICS.create(name) for name in NAMES]
    others = scene.names[1:]
    together = evaluate_metrics(metrics, scene, "0", others)
    alone = {name: evaluate_metrics(metrics, scene, "0", name) for name in others}
    for metric in metrics:
        found = together[metric.name]
        worst = min if metric.lower_is_critical else max
        each = {name: alone[name][metric.name] for name in others}
        assert found.score == worst(one.score for one in each.values())
        for k, value in enumerate(found.course):
            known = [one.course[k] for one in each.values() if not np.isnan(one.course[k])]
            assert value == worst(known) if known else np.isnan(value)
        if found.against is not None:
            assert len(others) > 1
            assert each[found.against].score == found.score != metric.cap
        elif len(others) > 1 and found.score != metric.cap:
            assert len({one.course.tobytes() for one in each.values()}) == 1


def crowd():
    """Ego drives towards a car 40 m ahead; one is beside it, and one never exists."""
    drives = {"y": 0, "heading": 0.0, "turn": 0.0, "acceleration": 0.0, "length": 4.0, "width": 2.0, "center_x": 0.0}
    rows = [(0, 0, 4.0), (40, 0, 0.0), (5, 6, 4.0), (0, 20, 0.0)]
    found = drive([drives | {"x": x, "y": y, "speed": speed, "kind": "car"} for x, y, speed in rows])
    motion = {name: getattr(found, name).copy() for name in MOTION_ARRAYS}
    for rows_of in motion.values():
        rows_of[3] = np.nan
    return replace(found, names=("Ego", "Ahead", "Beside", "Ghost"), **motion)


def test_one_that_is_never_there_counts_as_nothing():
    scene = crowd()
    metrics = [METRICS.create(name) for name in ("clearance", "ttc", "tet")]
    without = evaluate_metrics(metrics, scene, "Ego", ["Ahead", "Beside"])
    with_it = evaluate_metrics(metrics, scene, "Ego", ["Ghost", "Ahead", "Beside"])
    for name, one in without.items():
        np.testing.assert_array_equal(one.course, with_it[name].course)
        assert (one.score, one.against) == (with_it[name].score, with_it[name].against)
    assert without["clearance"].against == "Beside"
    assert without["ttc"].against == "Ahead"
    # The time to collision is never short here, with any entity.
    assert without["tet"].against is None
    nobody = evaluate_metrics(metrics, scene, "Ego", ["Ghost", "Phantom"])
    assert nobody["ttc"].score == METRICS.create("ttc").cap
    assert nobody["ttc"].against is None


def test_whom_the_ego_touches_decides_the_scores_of_a_contact():
    scene = replace(crowd(), collisions=(Collision(1.0, ("Ego", "Beside")),))
    found = evaluate_metrics([METRICS.create("pet"), METRICS.create("ttc")], scene, "Ego", ["Ahead", "Beside"])
    assert (found["pet"].score, found["pet"].against) == (0.0, "Beside")
    assert (found["ttc"].score, found["ttc"].against) == (0.0, "Beside")


def test_a_measurement_names_whom_it_is_against_only_where_there_are_several():
    scene = crowd()
    assert measure(scene, "Ego", ["Ahead"], ["ttc"]).rows() == measure(scene, "Ego", "Ahead", ["ttc"]).rows()
    assert "against" not in repr(measure(scene, "Ego", "Ahead", ["ttc"]))
    everybody = measure(scene, "Ego", "*", ["ttc", "traffic-quality"])
    assert everybody.against == {"ttc": "Ahead", "traffic-quality": None}
    assert everybody.column_names()[-1] == "against"
    assert [row[-1] for row in everybody.rows()] == ["Ahead", "–"]


@pytest.mark.parametrize(
    ("other", "words"),
    [
        ("Ahed", "no entity 'Ahed'; did you mean 'Ahead'?"),
        (["Ahead", "Beyond"], "no entity 'Beyond'"),
        ("Ego", "`other` Ego: this is the ego itself"),
        (["Ahead", "Ego"], "`other` Ego: this is the ego itself"),
        ([], "`other` is empty"),
        (3, "`other` 3: give a list of texts"),
    ],
)
def test_whom_nobody_can_measure_against_is_refused(other, words):
    with pytest.raises(InputError) as error:
        measure(crowd(), "Ego", other, ["ttc"])
    assert words in str(error.value)


def test_names_are_taken_once_and_a_star_is_everybody_else():
    assert resolve_others(["B", "A", "B"], "Ego", ()) == ("B", "A")
    assert resolve_others("*", "Ego", ("A", "Ego", "B")) == ("A", "B")
    assert resolve_others(["B", "*"], "Ego", ("A", "Ego", "B")) == ("B", "A")
    assert resolve_others("A,B", "Ego", ("A,B", "A", "B", "Ego")) == ("A,B",)
    with pytest.raises(
        InputError, match="`other` A, B: this is a list, not the name of an entity; give each entity by itself"
    ):
        resolve_others("A, B", "Ego", ("A", "Ego", "B"))
    with pytest.raises(InputError, match="there is no entity besides Ego"):
        resolve_others("*", "Ego", ("Ego",))


def test_features_are_of_the_one_that_is_touched_or_comes_nearest():
    scene = crowd()
    assert nearest_other(scene, "Ego", ["Ghost", "Ahead", "Beside"]) == "Beside"
    np.testing.assert_array_equal(
        compute_features([scene], "Ego", ["Ghost", "Ahead", "Beside"]), compute_features([scene], "Ego", "Beside")
    )
    hit = replace(scene, collisions=(Collision(2.0, ("Ego", "Ahead")),))
    found = compute_features([hit], "Ego", ["Beside", "Ahead"])[0]
    contact = [one.name for one in registered_features()].index("contact")
    assert found[contact] == 1.0
    np.testing.assert_array_equal(found, compute_features([hit], "Ego", "Ahead")[0])


def test_an_entity_that_a_recording_lacks_is_added_as_one_that_is_never_there():
    known = met((np.arange(3.0), 0.0, 0.0, 10.0), (np.full(3, 20.0), 0.0, 0.0, 0.0))
    assert known.with_absent_entities(["Other"]) is known
    more = known.with_absent_entities(["Third", "Other"])
    assert more.names == ("Ego", "Other", "Third")
    assert np.isnan(more.x[2]).all()
    assert more.x[:2].tolist() == known.x.tolist()
    alone = evaluate_metrics([METRICS.create("ttc")], known, "Ego", "Other")["ttc"]
    both = evaluate_metrics([METRICS.create("ttc")], known, "Ego", ["Third", "Other"])["ttc"]
    assert (both.score, both.against) == (alone.score, "Other")
