"""What drivers know, in the form that their compiled decisions take: arrays over drivers, scenarios and others.

The types of these tuples hang neither on the number of drivers, scenarios or others, nor on the roads.
"""

from __future__ import annotations

from typing import Final, NamedTuple

from cornercase._common.typing import BoolArray, FloatArray, IntArray

FOREIGN: Final = -1
"""Kind of a driver whose decisions are not compiled."""

BEHAVIOUR: Final = 0
"""Kind of `BehaviourDriver`."""

SIMPLE: Final = 1
"""Kind of `SimpleDriver`."""

X, Y, HEADING, SPEED, TURN, FIRST_SEEN, LAST_SEEN, SINCE, AHEAD_FOR = range(9)
"""Rows of `Fleet.memory`; the first four also those of the others' true motion."""

NOTICED, KNOWN, YIELDING = range(3)
"""Rows of `Fleet.awareness`."""

HALF_LENGTH, HALF_WIDTH, CENTER_X, VULNERABLE = range(4)
"""Rows of `Fleet.boxes`; the first three also columns of `Fleet.own`."""


class Routes(NamedTuple):
    """Planned routes, one after the other.

    Attributes
    ----------
    row : ndarray of int64, shape (D, G)
        By driver and number of the track, the route's row, in scenario 0 if it runs otherwise in each; -1 where none is
        planned.
    rows : ndarray of int64, shape (D, G)
        How many it has: 1, or N.
    begin, samples : ndarray of int64, shape (Q,)
        The first point of each row, and how many it has.
    measures : ndarray of float64, shape (Q, 3)
        Of each row the distance between its points in m, and its `longest` and `sharpest` as in `Route`.
    points : ndarray of float64, shape (M, 6)
        x and y in m, cosine and sine of the heading, the square of the highest speed in m²/s², and how many points of
        the row follow in a straight line.
    """

    row: IntArray
    rows: IntArray
    begin: IntArray
    samples: IntArray
    measures: FloatArray
    points: FloatArray


class Fleet(NamedTuple):
    """D drivers of N scenarios, each among A others: all entities but the one that it drives, in their order.

    Attributes
    ----------
    kind : ndarray of int64, shape (D,)
        `BEHAVIOUR`, `SIMPLE` or `FOREIGN`.
    parameters : ndarray of float64, shape (D, P)
        The fields of a `Behaviour` or a `Keeping`.
    own : ndarray of float64, shape (D, 3)
        Box of the entity that is driven: half length, half width and centre in m.
    boxes : ndarray of float64, shape (D, 4, A)
        Those of the others, and 1 for pedestrians and cyclists.
    memory : ndarray of float64, shape (D, N, 9, A)
        What the drivers remember of the others: x, y, heading and speed as perceived, the rate of turn as a running
        mean in rad/s; times in s at which they were first and last seen, and since when their way conflicts with the
        driver's; for how long in s they have been ahead.
    awareness : ndarray of bool, shape (D, N, 3, A)
        Whether a driver has noticed them, knows them, gives way to them.
    routes : Routes
    """

    kind: IntArray
    parameters: FloatArray
    own: FloatArray
    boxes: FloatArray
    memory: FloatArray
    awareness: BoolArray
    routes: Routes


class Driven(NamedTuple):
    """The driven entity of one scenario.

    Attributes
    ----------
    distance : float
        Place along its path in m.
    x, y, heading, speed : float
        Motion of its reference point in m, rad and m/s.
    target_speed : float
        m/s; infinite or NaN where the scenario asks for none.
    """

    distance: float
    x: float
    y: float
    heading: float
    speed: float
    target_speed: float


class Scene(NamedTuple):
    """One driver in one scenario, at one instant.

    Attributes
    ----------
    time, time_step : float
        s.
    driven : Driven
    cos, sin : float
        Of the driven entity's heading.
    own : ndarray of float64, shape (3,)
        Its box, as in `Fleet`.
    boxes : ndarray of float64, shape (4, A)
        Those of the others, as in `Fleet`.
    others : ndarray of float64, shape (4, A)
        Their true x, y, heading and speed in m, rad and m/s; NaN where one does not exist or is not visible.
    memory : ndarray of float64, shape (9, A)
        What the driver remembers of them, as in `Fleet`; brought up to date by decisions.
    awareness : ndarray of bool, shape (3, A)
        As in `Fleet`; brought up to date by decisions.
    """

    time: float
    time_step: float
    driven: Driven
    cos: float
    sin: float
    own: FloatArray
    boxes: FloatArray
    others: FloatArray
    memory: FloatArray
    awareness: BoolArray


class Workspace(NamedTuple):
    """Where a decision notes what it is about; what stood there before changes no decision.

    Attributes
    ----------
    boxes : ndarray of float64, shape (A, 5)
        Centre in m, cosine and sine of the heading of the others' boxes as they are, and the heading; cosine and sine
        are found anew only where that differs.
    seen : ndarray of bool, shape (A,)
    places : ndarray of float64, shape (K, 6)
        Where the driven entity will be: distance in m, centre of the box in m, cosine and sine of its heading, time of
        arrival in s.
    legs : ndarray of float64, shape (L, 6)
        Where another will be, in straight legs: centre of the box in m, cosine and sine of its heading, begin and end
        in s.
    arrivals : ndarray of float64, shape (3,)
        Up to which place the times of arrival are known, the square of the speed there in m²/s², and the speed in m/s.
    between : ndarray of float64, shape (1, 6)
        A place between two others.
    """

    boxes: FloatArray
    seen: BoolArray
    places: FloatArray
    legs: FloatArray
    arrivals: FloatArray
    between: FloatArray
