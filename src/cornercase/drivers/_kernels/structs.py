"""State of drivers as arrays over drivers, scenarios and others, for their kernels.

The types of these tuples depend neither on the numbers of drivers, scenarios and others, nor on the roads.
"""

from __future__ import annotations

from typing import Final, NamedTuple

from cornercase._common.numba.kernel import kernel
from cornercase._common.typing import BoolArray, FloatArray, IntArray

# These kernels allocate nothing: without reference counting, which would take longer than what they compute.
plain_kernel = kernel(error_model="numpy", _nrt=False)
# For kernels that are called from one place, or are short.
inline_kernel = kernel(error_model="numpy", _nrt=False, forceinline=True)

NOT_COMPILED: Final = -1
"""Kind of a driver whose decisions are not compiled."""

BEHAVIOUR: Final = 0
"""Kind of `BehaviourDriver`."""

SIMPLE: Final = 1
"""Kind of `SimpleDriver`."""

X, Y, HEADING, SPEED, TURN, FIRST_SEEN, LAST_SEEN, CONFLICT_SINCE, AHEAD_FOR = range(9)
"""Rows of `Fleet.memory`; the first four also those of the others' true motion."""

NOTICED, KNOWN, YIELDING = range(3)
"""Rows of `Fleet.awareness`."""

HALF_LENGTH, HALF_WIDTH, CENTER_X, VULNERABLE = range(4)
"""Rows of `Fleet.boxes`; the first three also columns of `Fleet.own`."""


class Routes(NamedTuple):
    """Planned routes, one after the other.

    `row` (D, G): row of the route of a driver along a track, in scenario 0 if it differs between scenarios; -1 if not
    planned. `rows` (D, G): its number of rows, 1 or N. `begin`, `samples` (Q,): first point of each row, and number of
    points. `measures` (Q, 3): point distance in m, and `longest` and `sharpest` of `Route`. `points` (M, 6): x and y in
    m, cosine and sine of the heading, square of the highest speed in m²/s², number of following points on a straight
    line.
    """

    row: IntArray
    rows: IntArray
    begin: IntArray
    samples: IntArray
    measures: FloatArray
    points: FloatArray


class Fleet(NamedTuple):
    """D drivers in N scenarios, each among A others: all entities but its own, in their order.

    `kind` (D,): `BEHAVIOUR`, `SIMPLE` or `NOT_COMPILED`. `parameters` (D, P): fields of a `Behaviour` or
    `FollowParameters`. `own` (D, 3): half length, half width and centre of the driven box in m. `boxes` (D, 4, A): the
    same of the others, and 1 for pedestrians and cyclists. `memory` (D, N, 9, A): what drivers remember of the others:
    x, y, heading and speed as perceived, running mean of the turn rate in rad/s, times in s of the first and last
    sighting and of the start of the conflict, and how long in s they have been ahead. `awareness` (D, N, 3, A):
    noticed, known, yielded to.
    """

    kind: IntArray
    parameters: FloatArray
    own: FloatArray
    boxes: FloatArray
    memory: FloatArray
    awareness: BoolArray
    routes: Routes


class DrivenState(NamedTuple):
    """State of the driven entity in one scenario: m along its path; m, rad and m/s of its reference point.

    `target_speed` is in m/s; infinite or NaN if the scenario sets none.
    """

    distance: float
    x: float
    y: float
    heading: float
    speed: float
    target_speed: float


class DriverScene(NamedTuple):
    """One driver in one scenario at one instant.

    `cos` and `sin` are of the driven entity's heading; `own` (3,), `boxes` (4, A), `memory` (9, A) and `awareness` (3,
    A) are as in `Fleet`, and decisions update the last two. `others` (4, A): true x, y, heading and speed in m, rad and
    m/s; NaN if an entity does not exist or is not visible.
    """

    time: float
    time_step: float
    driven: DrivenState
    cos: float
    sin: float
    own: FloatArray
    boxes: FloatArray
    others: FloatArray
    memory: FloatArray
    awareness: BoolArray


class Workspace(NamedTuple):
    """Buffers of a decision; their previous content does not affect decisions.

    `boxes` (A, 5): centre in m, cosine and sine of the heading of the others' true boxes, and the heading, by which
    cosine and sine are cached. `seen` (A,). `samples` (K, 6): future samples of the driven entity: distance in m,
    centre of the box in m, cosine and sine of its heading, arrival time in s. `legs` (L, 6): predicted straight legs of
    another entity: centre of the box in m, cosine and sine of its heading, start and end in s. `arrivals` (3,): row up
    to which arrival times are known, squared speed there in m²/s², speed in m/s. `interpolated` (1, 6): a sample
    between two others.
    """

    boxes: FloatArray
    seen: BoolArray
    samples: FloatArray
    legs: FloatArray
    arrivals: FloatArray
    interpolated: FloatArray
