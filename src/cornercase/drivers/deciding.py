"""One compiled decision for one driver in one scenario."""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, no-untyped-call, untyped-decorator"

from __future__ import annotations

import math

import numpy as np

from cornercase._common.compiling import kernel
from cornercase.drivers.foreseeing import TURN_LEGS
from cornercase.drivers.keeping import keep_distance
from cornercase.drivers.parameters import Behaviour, Keeping
from cornercase.drivers.traffic import BEHAVIOUR, SIMPLE, Driven, Scene, Workspace
from cornercase.drivers.visibility import eye_of, look, perceive
from cornercase.drivers.way import MOST_PLACES
from cornercase.drivers.yielding import decide

# Nothing is allocated, so that references need not be counted, which takes longer than what is computed.
_kernel = kernel(error_model="numpy", _nrt=False)
_part = kernel(error_model="numpy", _nrt=False, forceinline=True)


@_part
def accelerate(fleet, d, n, route, time, time_step, driven, others, work):
    """Acceleration that a driver gives its entity for the coming time step, in one scenario.

    What the driver remembers of that scenario is brought up to date.

    Parameters
    ----------
    fleet : Fleet
    d : int
        Row of the driver; not one of the kind `FOREIGN`.
    n : int
        Scenario.
    route : int
        Row of the route that it takes, as of `route_row`.
    time, time_step : float
        s.
    driven : Driven
    others : ndarray of float64, shape (4, A)
        x, y, heading and speed of the others; NaN where one does not exist or is not visible.
    work : Workspace

    Returns
    -------
    float
        m/s².
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


@_kernel
def route_row(fleet, d, track, n):
    """Row of the route that a driver takes along a track in one scenario.

    Parameters
    ----------
    fleet : Fleet
    d, track, n : int
        Row of the driver, number of the track, scenario.

    Returns
    -------
    int
        -1 if it has none yet, and needs one: see `with_route`.
    """
    if fleet.kind[d] != BEHAVIOUR:
        return 0
    routes = fleet.routes
    if track >= routes.row.shape[1] or routes.row[d, track] < 0:
        return -1
    return routes.row[d, track] + (n if routes.rows[d, track] > 1 else 0)


@kernel(error_model="numpy")
def workspace(others):
    """Make room for the decisions of one thread.

    Parameters
    ----------
    others : int
        A.

    Returns
    -------
    Workspace
    """
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
    """Acceleration that the first driver of a fleet gives its entity, in each scenario.

    Parameters
    ----------
    fleet : Fleet
    track : int
        Number of the track, along which a route is planned.
    time, time_step : float
        s.
    driven : ndarray of float64, shape (N, 6)
        The fields of `Driven`.
    others : ndarray of float64, shape (N, 4, A)
        x, y, heading and speed; NaN where one does not exist.
    active : ndarray of bool, shape (N,)
        Scenarios to decide; in the others nothing changes.

    Returns
    -------
    ndarray of float64, shape (N,)
        m/s²; 0 where not active.
    """
    result, work = np.zeros(len(active)), workspace(others.shape[2])
    for n in range(len(active)):
        if active[n]:
            s = driven[n]
            one = Driven(s[0], s[1], s[2], s[3], s[4], s[5])
            result[n] = accelerate(fleet, 0, n, route_row(fleet, 0, track, n), time, time_step, one, others[n], work)
    return result
