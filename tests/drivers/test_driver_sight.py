"""What drivers see and remember."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from conftest import examples
from cornercase.drivers import (
    NORMAL,
    BehaviourDriver,
)
from helpers.closed_loop import BOXES, DT, EGO, Other, corners, inside, line_is_free, looking, who_is_seen


@given(
    places=st.lists(
        st.tuples(st.floats(4.0, 40.0), st.floats(-20.0, 20.0), st.floats(-3.1, 3.1)), min_size=3, max_size=3
    ),
    kinds=st.lists(st.sampled_from(sorted(BOXES)), min_size=3, max_size=3),
)
@settings(max_examples=examples(80), deadline=None)
def test_sight_agrees_with_points_along_the_lines(places, kinds):
    x, y, heading = np.array(places).T
    eye = np.array([1.4 + 0.25 * EGO["length"], 0.0])
    others = [Other(kind, *place) for kind, place in zip(kinds, places, strict=True)]
    boxes = corners(looking(x, y, heading, kinds))[1][0]
    if any(inside(eye[None], box).any() for box in boxes):
        return
    seen = who_is_seen(looking(x, y, heading, kinds), sight_range=100.0)
    for k in range(3):
        # Lines that graze a box may fall on either side: grow and shrink all boxes slightly.
        if seen[k] != line_is_free(eye, others, k, 0.0):
            assert grazes(eye, boxes, k)


def grazes(eye, boxes, k):
    targets = np.vstack([boxes[k], boxes[k].mean(0)])
    along = np.linspace(0.0, 1.0, 4001)[:, None]
    for factor in (0.98, 1.02):
        grown = [b.mean(0) + factor * (b - b.mean(0)) for i, b in enumerate(boxes) if i != k]
        free = any(not any(inside(eye + along * (t - eye), b).any() for b in grown) for t in targets)
        if factor == 0.98:
            with_less = free
    return with_less != free


def test_field_of_view_and_range():
    kinds = ["misc", "misc", "misc", "misc"]
    situation = looking([30.0, -10.0, 3.0, 120.0], [0.0, 0.0, 20.0, 30.0], [0.0] * 4, kinds)
    wide = who_is_seen(situation, field_of_view=math.pi, sight_range=100.0)
    assert wide == [True, False, True, False]
    narrow = who_is_seen(situation, field_of_view=math.radians(60), sight_range=200.0)
    assert narrow == [True, False, False, True]


def test_absent_entities_neither_hide_nor_matter():
    hidden = looking([20.0, 10.0], [0.0, 0.0], [0.0, 0.0], ["pedestrian", "truck"])
    free = looking([20.0, np.nan], [0.0, np.nan], [0.0, np.nan], ["pedestrian", "truck"])
    options = {"field_of_view": math.pi, "sight_range": 100.0}
    assert who_is_seen(hidden, **options) == [False, True]
    assert who_is_seen(free, **options) == [True, False]
    driver = BehaviourDriver(NORMAL._replace(reaction_time=0.0))
    driver.start(1, 2)
    empty = replace(free, others_x=np.full((1, 2), np.nan), speed=np.array([5.0]), target_speed=np.array([5.0]))
    assert driver.acceleration(empty).tolist() == [0.0]


def test_remembers_for_a_while_who_got_out_of_sight():
    driver = BehaviourDriver(NORMAL)
    driver.start(1, 2)
    known = []
    for step in range(80):
        # The truck blocks the view at 1 s.
        blocked = 10.0 if step >= 20 else 200.0
        situation = looking([20.0, blocked], [0.0, 0.0], [0.0, 0.0], ["misc", "truck"])
        driver.acceleration(replace(situation, time=step * DT))
        known.append(bool(driver.known_mask[0, 0]))
    assert known.index(True) * DT == pytest.approx(NORMAL.reaction_time)
    assert (len(known) - known[::-1].index(True)) * DT == pytest.approx(1.0 + NORMAL.memory, abs=DT + 1e-9)
