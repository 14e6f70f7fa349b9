"""Where vehicles are along their paths."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cornercase._common.typing import FloatArray
from cornercase.drivers import DrivenPath
from cornercase.drivers._kernels.path_projection import project_onto_path
from cornercase.drivers._path_tracking import locate_on_path

STEP = 0.1


def path(heading: FloatArray) -> DrivenPath:
    x, y = (np.concatenate([[0.0], np.cumsum(STEP * f(heading[:-1]))]) for f in (np.cos, np.sin))
    return DrivenPath(STEP * np.arange(len(heading)), x, y, heading, np.gradient(heading, STEP))


BEND = path(np.concatenate([np.zeros(300), np.linspace(0.0, 1.5, 300), np.full(300, 1.5)]))


@settings(deadline=None)
@given(at=st.integers(20, 880), side=st.floats(-4.0, 4.0), back=st.floats(-3.0, 3.0))
def test_a_vehicle_near_its_path_is_where_the_whole_path_is_nearest(at, side, back):
    x = BEND.x[[at]] - side * np.sin(BEND.heading[at])
    y = BEND.y[[at]] + side * np.cos(BEND.heading[at])
    before, none = BEND.distance[[at]] - back, np.zeros(1)
    found = locate_on_path(BEND, before, x, y, none, none)
    along, offset, direction, _ = project_onto_path(BEND, before, x[:, None], y[:, None])
    assert (found.along[0], found.offset[0], -found.turn[0]) == pytest.approx(
        (along[0, 0], offset[0, 0], direction[0, 0]), abs=1e-12
    )
    assert found.offset[0] == pytest.approx(side, abs=2e-3)


def test_a_vehicle_stays_on_its_branch_where_a_path_crosses_itself():
    # A loop of three quarters of a circle between two straights, which cross at a right angle.
    radius = 20.0
    arc = np.arange(0.0, 1.5 * np.pi, STEP / radius)
    loop = path(np.concatenate([np.zeros(400), arc, np.full(600, 1.5 * np.pi)]))
    crossing = np.array([loop.x[-1]]), np.array([0.0])
    first = float(loop.x[-1])
    for before, direction in ((first - 0.7, 0.0), (40.0 + 1.5 * np.pi * radius + radius - 0.7, 1.5 * np.pi)):
        # 0.3 m beside the branch that it follows, on the other one.
        x, y = crossing[0] - 0.3 * np.sin(direction), crossing[1] + 0.3 * np.cos(direction)
        found = locate_on_path(loop, np.array([before]), x, y, np.array([direction]), np.zeros(1))
        assert found.offset[0] == pytest.approx(0.3, abs=0.05)
        assert abs(found.turn[0]) < 0.05


def test_what_is_far_from_its_path_is_searched_along_it():
    place = np.array([40.0]), np.array([30.0])
    found = locate_on_path(BEND, np.array([0.0]), *place, np.zeros(1), np.zeros(1))
    gaps = np.hypot(BEND.x - 40.0, BEND.y - 30.0)
    assert found.along[0] == pytest.approx(BEND.distance[gaps.argmin()], abs=STEP)


def test_who_is_far_beyond_the_end_of_its_path_is_seen_from_the_line_beyond_it():
    found = locate_on_path(BEND, np.array([5e3]), *(np.array([value]) for value in (500.0, 600.0, 1.5, 0.0)))
    dx, dy = 500.0 - BEND.x[-1], 600.0 - BEND.y[-1]
    assert found.along[0] == pytest.approx(BEND.distance[-1] + dx * np.cos(1.5) + dy * np.sin(1.5))
    assert found.offset[0] == pytest.approx(dy * np.cos(1.5) - dx * np.sin(1.5))
