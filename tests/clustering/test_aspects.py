"""Aspects, tested with recordings whose distances are known by construction."""

from __future__ import annotations

import math
import shutil
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from conftest import examples
from cornercase._common.errors import InputError
from cornercase.clustering import ASPECTS, Aspect, analyze, read_analysis, read_distances
from cornercase.clustering._series import read_series
from cornercase.dtw import distance_matrix
from cornercase.recordings import Recording
from cornercase.study import StudyFile
from helpers.synthetic_study import explorer, opened

TIME = np.arange(0.0, 20.0, 0.1)
NAMES = ("bearing", "behaviour", "ego-motion", "ego-speed", "ego-trajectory", "interaction", "relative")


def of(ego, other, time=TIME):
    """A recording of two points, from their positions (T, 2); headings and speeds follow from the motion."""
    places = np.stack([ego, other])
    steps = np.diff(places, axis=1, append=2 * places[:, -1:] - places[:, -2:-1])
    one = np.zeros(2)
    return Recording(
        time=time,
        names=("Ego", "B"),
        object_types=("car", "car"),
        x=places[:, :, 0],
        y=places[:, :, 1],
        heading=np.arctan2(steps[:, :, 1], steps[:, :, 0]),
        speed=np.hypot(steps[:, :, 0], steps[:, :, 1]) / 0.1,
        acceleration=np.zeros(places.shape[:2]),
        length=one + 4.0,
        width=one + 2.0,
        center_x=one + 1.0,
    )


def crossing(wait, first):
    """The ego goes east along y = 0, the other north along x = 0; one waits before the crossing."""
    way = np.minimum(8.0 * TIME, np.maximum(40.0, 8.0 * (TIME - wait)))
    late, early = np.column_stack((way - 50.0, 0.0 * way)), np.column_stack((8.0 * TIME - 50.0, 0.0 * TIME))
    return of(early if first else late, (late if first else early)[:, ::-1])


def apart(name, one, two):
    aspect = ASPECTS.create(name)
    return distance_matrix([aspect.series(each, "Ego", "B") for each in (one, two)])[0, 1]


def moved(recording, dx, dy, turn):
    x, y = recording.x, recording.y
    return Recording(
        **{
            **{name: getattr(recording, name) for name in recording.__dataclass_fields__},
            "x": math.cos(turn) * x - math.sin(turn) * y + dx,
            "y": math.sin(turn) * x + math.cos(turn) * y + dy,
            "heading": recording.heading + turn,
        }
    )


def test_these_are_the_aspects():
    assert tuple(ASPECTS.names()) == NAMES


@pytest.mark.parametrize("name", NAMES)
@settings(deadline=None, max_examples=examples(25))
@given(dx=st.floats(-500, 500), dy=st.floats(-500, 500), turn=st.floats(-math.pi, math.pi))
def test_what_does_not_say_where_does_not_depend_on_it(name, dx, dy, turn):
    base = crossing(2.0, first=False)
    away = apart(name, base, moved(base, dx, dy, turn))
    if name in ("behaviour", "bearing", "ego-speed", "relative"):
        assert away == pytest.approx(0.0, abs=1e-5)
    elif math.hypot(dx, dy) > 1.0:
        assert away > 1.0


def test_waiting_costs_nothing_by_the_trajectory_and_so_much_by_behaviour():
    short, long = crossing(2.0, first=False), crossing(5.0, first=False)
    # The same positions, except at the end, which the longer wait does not reach.
    reached = short.x[0, -1] - long.x[0, -1]
    assert reached == pytest.approx(24.0)
    ends = np.arange(1, 30).sum() * 0.8 + reached
    assert apart("ego-trajectory", short, long) == pytest.approx(ends, rel=0.01)
    assert apart("behaviour", short, long) > 3.0 * apart("ego-trajectory", short, long)


def test_who_is_first_tells_more_than_how_long_is_waited():
    first, second = (
        [crossing(wait, first=True) for wait in (2, 3, 4)],
        [crossing(wait, first=False) for wait in (2, 3, 4)],
    )
    for name in ("interaction", "relative", "bearing"):
        within = max(apart(name, one, two) for kind in (first, second) for one in kind for two in kind)
        between = min(apart(name, one, two) for one in first for two in second)
        assert between > 2.0 * within, name


def test_the_other_in_the_egos_frame():
    ego = np.column_stack((np.zeros(200), 5.0 * TIME))  # Northward.
    recording = of(ego, ego + np.array((-3.0, 10.0)))
    np.testing.assert_allclose(ASPECTS.create("relative").series(recording, "Ego", "B"), [[10.0, 3.0]] * 200)
    np.testing.assert_allclose(
        ASPECTS.create("bearing").series(recording, "Ego", "B"), np.tile([10.0, 3.0], (200, 1)) / math.sqrt(109.0)
    )


def test_speed_and_place_on_one_scale():
    ego = np.column_stack((5.0 * TIME, np.zeros(200)))
    motion = ASPECTS.create("ego-motion").series(of(ego, ego), "Ego", "B")
    # The centre of the box is 1 m ahead; 5 m/s are 15 m in 3 s.
    np.testing.assert_allclose(motion, np.column_stack((5.0 * TIME + 1.0, np.zeros(200), np.full(200, 15.0))))
    np.testing.assert_allclose(ASPECTS.create("ego-speed").series(of(ego, ego), "Ego", "B"), np.full((200, 1), 5.0))


@pytest.mark.parametrize("name", NAMES)
def test_who_is_not_there_stays_where_it_was(name):
    ego = np.column_stack((5.0 * TIME, np.zeros(200)))
    whole = of(ego, np.full_like(ego, (30.0, 4.0)))
    for gone in (slice(0, 50), slice(120, 200), slice(0, 200)):
        x, y, heading, speed = (getattr(whole, key).copy() for key in ("x", "y", "heading", "speed"))
        for values in (x, y, heading, speed):
            values[1, gone] = np.nan
        part = Recording(
            **{
                **{key: getattr(whole, key) for key in whole.__dataclass_fields__},
                **{"x": x, "y": y, "heading": heading, "speed": speed},
            }
        )
        series = ASPECTS.create(name).series(part, "Ego", "B")
        assert np.isfinite(series).all()
        if gone.stop - gone.start < 200:
            # The other stands still, so nothing is lost.
            np.testing.assert_allclose(series, ASPECTS.create(name).series(whole, "Ego", "B"))


class Odd(Aspect):
    name, unit = "odd", "m"
    shape = (3, 1)

    def series(self, recording, ego, other):
        return np.zeros(self.shape)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    path = tmp_path_factory.mktemp("whole") / "s.db"
    with opened(path) as study:
        explorer(study, metrics=("distance", "wttc"), optimizer="sobol").run()
    return path


@pytest.fixture
def path(whole, tmp_path):
    """A copy, since tests change it."""
    return Path(shutil.copy(whole, tmp_path / "s.db"))


def test_a_study_is_analysed_by_any_of_them(path):
    found = analyze(path, [*NAMES, "distance"])
    with StudyFile.open(path, readonly=True) as study:
        assert study.analyzed_aspects() == ["ego-trajectory", *sorted(set(NAMES) - {"ego-trajectory"}), "distance"]
        for name, one in found.items():
            # Studies are compared in single precision.
            expected = distance_matrix(read_series(study, name))
            np.testing.assert_allclose(read_distances(study, name), expected, rtol=1e-5, atol=1e-5)
            again = read_analysis(study, name)
            assert (again.unit, again.window) == (one.unit, None)
    assert {name: one.unit for name, one in found.items()} == {
        **dict.fromkeys(NAMES, "m"),
        **{"bearing": "1", "ego-speed": "m/s", "distance": "m"},
    }


def test_a_window_is_in_seconds_and_stored_and_kept(path):
    # The recordings have instants 1 s apart.
    analyze(path, "distance", window=2.0)
    with StudyFile.open(path, readonly=False) as study:
        expected = distance_matrix(read_series(study, "distance"), window=3)
        np.testing.assert_allclose(read_distances(study, "distance"), expected, rtol=1e-5, atol=1e-5)
        assert read_analysis(study, "distance").window == 2.0
        assert analyze(study, "distance", keep_clusters=True)["distance"].window == 2.0
        with pytest.raises(InputError, match=r"leave out .*`window`"):
            analyze(study, "distance", window=1.0, keep_clusters=True)


def test_a_window_of_any_width_is_one(path):
    analyze(path, "distance", window=1e308)
    with StudyFile.open(path) as study:
        assert read_analysis(study, "distance").window == 1e308


@pytest.mark.parametrize("window", [-1.0, math.inf, math.nan, "2", True])
def test_refuses_what_is_no_window(path, window):
    with pytest.raises(InputError, match=r"`window` .*: give a time in s"):
        analyze(path, window=window)


def test_refuses_what_is_no_aspect(path):
    with pytest.raises(InputError, match=r"`by` ego-spede: .* did you mean 'ego-speed'"):
        analyze(path, "ego-spede")


def test_refuses_an_aspect_that_gives_something_else(path, monkeypatch):
    monkeypatch.setitem(ASPECTS._factories, "odd", (Odd, {}))
    with pytest.raises(InputError, match=r"The aspect 'odd' returns shape \(3, 1\) for scenario"):
        analyze(path, "odd")


class Texts(Aspect):
    name, unit = "odd", "m"

    def series(self, recording, ego, other):
        return [["fast"]] * len(recording.time)


class Writes(Aspect):
    name, unit = "odd", "m"

    def series(self, recording, ego, other):
        recording.x[:] = 0.0
        return recording.x.T


def test_refuses_an_aspect_that_gives_no_numbers(path, monkeypatch):
    monkeypatch.setitem(ASPECTS._factories, "odd", (Texts, {}))
    with pytest.raises(InputError, match=r"The aspect 'odd' returns no numbers for scenario 1"):
        analyze(path, "odd")


def test_no_aspect_can_change_what_others_compare(path, monkeypatch):
    monkeypatch.setitem(ASPECTS._factories, "odd", (Writes, {}))
    with pytest.raises(InputError, match=r"The aspect 'odd' fails for scenario 1 of .*read-only"):
        analyze(path, ["odd", "relative"])


class Fails(Aspect):
    name, unit = "odd", "m"

    def series(self, recording, ego, other):
        if recording.x[1, 0] < 5.0:
            raise KeyError("no such\nthing")
        return recording.x.T


class Widens(Fails):
    def series(self, recording, ego, other):
        return recording.x.T[:, : 1 if recording.x[1, 0] > 5.0 else 2]


class Refuses(Fails):
    def __init__(self):
        raise RuntimeError("not today")


class WithoutUnit(Aspect):
    name = "odd"

    def series(self, recording, ego, other):
        return recording.x.T


class WithoutSeries(Aspect):
    name, unit = "odd", "m"


class NumberForUnit(Aspect):
    name, unit = "odd", 3  # type: ignore[assignment]

    def series(self, recording, ego, other):
        return recording.x.T


@pytest.mark.parametrize(
    ("aspect", "words"),
    [
        (Fails, r"^The aspect 'odd' fails for scenario \d+ of .*s\.db: KeyError: 'no such\\nthing'\.$"),
        (
            Widens,
            r"^The aspect 'odd' returns [12] channels for scenario \d+ of .*, and [12] for scenario 1;",
        ),
        (
            Refuses,
            r"^The aspect 'odd' failed when it was created: RuntimeError: not today \(test_aspects\.py line .*; fix its code\.$",
        ),
        (WithoutUnit, r"^The aspect 'odd' cannot be created: AttributeError: .*unit"),
        (WithoutSeries, r"^The aspect 'odd' failed when it was created: TypeError: .*series"),
        (NumberForUnit, r"^The aspect 'odd' has 3 as its unit; it has to be a string\.$"),
    ],
)
def test_an_aspect_that_fails_is_named_in_one_sentence(path, monkeypatch, aspect, words):
    monkeypatch.setitem(ASPECTS._factories, "odd", (aspect, {}))
    with pytest.raises(InputError, match=words):
        analyze(path, ["ego-speed", "odd"])
    with StudyFile.open(path, readonly=True) as study:
        assert study.analyzed_aspects() == []
        with pytest.raises(InputError, match=words):
            read_series(study, "odd")
