"""Compiled decision of one driver in one scenario."""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, no-untyped-call, untyped-decorator"

from __future__ import annotations

import math

import numpy as np

from cornercase._common.compiling import kernel
from cornercase.drivers.foreseeing import TURN_LEGS
from cornercase.drivers.keeping import keep_distance
from cornercase.drivers.parameters import Behaviour, Keeping
from cornercase.drivers.traffic import BEHAVIOUR, SIMPLE, Driven, Scene, Workspace, inline_kernel, plain_kernel
from cornercase.drivers.visibility import eye_of, look, perceive
from cornercase.drivers.way import MOST_PLACES
from cornercase.drivers.yielding import decide


@inline_kernel
def accelerate(fleet, d, n, route, time, time_step, driven, others, work):
    """Acceleration in m/s² that a driver chooses in one scenario; updates what the driver remembers.

    `driver` is not `NOT_COMPILED`; `route` comes from `find_route_row`; `others` has shape (4, A): x, y, heading and
    speed, NaN if an entity does not exist or is not visible.
    """
    cos, sin = math.cos(driven.heading), math.sin(driven.heading)
    scene = Scene(
        time, time_step, driven, cos, sin, fleet.own[d], fleet.boxes[d], others, fleet.memory[d, n],
        fleet.awareness[d, n],
    )  # fmt: skip
    p = fleet.parameters[d]
    if fleet.kind[d] == SIMPLE:
        return keep_distance(Keeping(p[0], p[1], p[2], p[3], p[4], p[5], p[6]), scene)
    behaviour = Behaviour(
        p[0], p[1], p[2], p[3], p[4], p[5], p[6], p[7], p[8], p[9], p[10], p[11], p[12], p[13], p[14], p[15], p[16]
    )
    eye = eye_of(scene.own, driven.x, driven.y, cos, sin)
    look(behaviour.field_of_view, behaviour.sight_range, eye, scene.boxes, others, work.boxes, work.seen)
    perceive(behaviour, scene, work.seen)
    a = decide(behaviour, fleet.routes, route, scene, work)
    a = min(max(a, -behaviour.max_deceleration), behaviour.acceleration)
    return max(a, -driven.speed / time_step)


@plain_kernel
def route_row(fleet, d, track, n):
    """Row of the route of a driver along a track in one scenario; -1 if `set_route` has to plan it first."""
    if fleet.kind[d] != BEHAVIOUR:
        return 0
    routes = fleet.routes
    if track >= routes.row.shape[1] or routes.row[d, track] < 0:
        return -1
    return routes.row[d, track] + (n if routes.rows[d, track] > 1 else 0)


@kernel(error_model="numpy")
def workspace(others):
    """Allocate the buffers for the decisions of one thread among `n_others` other entities."""
    return Workspace(
        np.full((others, 5), np.nan),
        np.empty(others, dtype=np.bool_),
        np.empty((MOST_PLACES, 6)),
        np.empty((TURN_LEGS + 1, 6)),
        np.empty(3),
        np.empty((1, 6)),
    )


@kernel(error_model="numpy")
def accelerate_each(fleet, track, time, time_step, driven, others, active):
    """Acceleration in m/s² of the first driver of a fleet in each scenario, shape (N,); 0 if not active.

    `driven` has shape (N, 6), the fields of `DrivenState`; `others` has shape (N, 4, A).
    """
    result, work = np.zeros(len(active)), workspace(others.shape[2])
    for n in range(len(active)):
        if active[n]:
            s = driven[n]
            state = Driven(s[0], s[1], s[2], s[3], s[4], s[5])
            result[n] = accelerate(fleet, 0, n, route_row(fleet, 0, track, n), time, time_step, state, others[n], work)
    return result
