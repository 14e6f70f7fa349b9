"""State of drivers as arrays over drivers, scenarios and other entities, for kernels.

The types of these tuples are the same for all numbers of drivers, scenarios and entities, and for all roads, so that
each kernel (compiled function) is compiled only once.
"""

from __future__ import annotations

from typing import Final, NamedTuple

from cornercase._common.numba.kernel import kernel
from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.drivers.vehicles._kernels.actuators import Vehicles

# For kernels that allocate nothing: without reference counting, which would take longer than the computation.
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
"""Rows of `Fleet.memory`; the first four are also the rows of the others' true motion."""

NOTICED, KNOWN, YIELDING = range(3)
"""Rows of `Fleet.awareness`."""

HALF_LENGTH, HALF_WIDTH, CENTER_X, VULNERABLE = range(4)
"""Rows of `Fleet.boxes`; the first three also columns of `Fleet.own`."""


class Routes(NamedTuple):
    """Planned routes of D drivers along G tracks (numbered paths), as Q rows with M points in all.

    A route that is the same in all N scenarios has one row. Any other route has one row per scenario, in order.

    `row` (D, G): the first row of the route; -1 if none is planned. `rows` (D, G): number of rows of the route, 1 or N.
    `begin`, `samples` (Q,): first point of a row, and number of its points. `measures` (Q, 3): distance between points
    along the path in m, and the fields `max_spacing` and `max_turn` of `Route`. `points` (M, 6): x and y in m, cosine
    and sine of the heading, square of the highest speed in m²/s², and number of the following points that lie on a
    straight line with this one.
    """

    row: IntArray
    rows: IntArray
    begin: IntArray
    samples: IntArray
    measures: FloatArray
    points: FloatArray


class Fleet(NamedTuple):
    """State of D drivers in N scenarios, as arrays for kernels.

    For each driver, the A others are all other entities, in order.

    `kind` (D,): `BEHAVIOUR`, `SIMPLE` or `NOT_COMPILED`. `parameters` (D, N, P): fields of a `Behaviour` or of
    `FollowParameters`. `own` (D, 3): half length, half width and centre of the driven box in m. `boxes` (D, 4, A): half
    length, half width and centre of the others' boxes in m, and 1 for pedestrians and cyclists (else 0).

    `memory` (D, N, 9, A): perceived x, y, heading and speed of the others; running mean of their turn rate in rad/s;
    times in s of the first and the last sighting, and of the start of the conflict; how long in s they have been ahead.
    `awareness` (D, N, 3, A): whether each other entity is noticed, known, and yielded to. `kernels` (2,): addresses of
    the kernels that decide, by kind.

    `vehicles`: vehicle models, N rows for each driver that has one. `first_vehicle` (D,): the first of these rows; -1
    for an entity that does at once what its driver decides. `vehicle_kind` (D,): `ACTUATORS` and so on.
    `vehicle_kernels` (3,): addresses of the kernels that move vehicles, by kind. `half_widths` (D, G): for vehicles
    that steer along a lane, address of an array with half the lane width in m at each sample of a track; 0 if not
    known. `friction` (N,): friction coefficient of the road.
    """

    kind: IntArray
    parameters: FloatArray
    own: FloatArray
    boxes: FloatArray
    memory: FloatArray
    awareness: BoolArray
    routes: Routes
    kernels: IntArray
    vehicles: Vehicles
    first_vehicle: IntArray
    vehicle_kind: IntArray
    vehicle_kernels: IntArray
    half_widths: IntArray
    friction: FloatArray


class DrivenState(NamedTuple):
    """State of the driven entity in one scenario, in m, rad and m/s.

    `distance` is the position along the path; `x`, `y` and `heading` are the pose of the reference point.
    `target_speed` is infinite or NaN if the scenario sets none.
    """

    distance: float
    x: float
    y: float
    heading: float
    speed: float
    target_speed: float


class DriverScene(NamedTuple):
    """State of a driver and the entities around it, in one scenario at one instant.

    `cos` and `sin` belong to the driven entity's heading. `own` (3,), `boxes` (4, A), `memory` (9, A) and
    `awareness` (3, A) are slices of the arrays in `Fleet`; decisions update `memory` and `awareness`. `others` (4, A):
    true x, y, heading and speed in m, rad and m/s, NaN if an entity does not exist or is not visible.
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
    """Buffers for the decisions of one thread; their previous content has no effect on decisions.

    `boxes` (A, 5): centres of the others' true boxes in m, cosine and sine of their headings, and the headings for
    which these were computed. `seen` (A,): True for the others that the driver sees. `samples` (K, 6): samples of the
    path ahead: distance in m, centre of the box in m, cosine and sine of the heading, arrival time in s. `legs` (L, 6):
    predicted legs of another entity (straight pieces of its motion): centre of the box in m, cosine and sine of the
    heading, start and end in s. `arrivals` (3,): last row with known arrival time, squared speed there in m²/s², speed
    in m/s. `interpolated` (1, 6): a sample between two others.
    """

    boxes: FloatArray
    seen: BoolArray
    samples: FloatArray
    legs: FloatArray
    arrivals: FloatArray
    interpolated: FloatArray
