"""Every lane of a road network: whether it can be driven, and how fast that is over ground.

Single short steps from places all along a lane are looked at, and how long the whole lane is; nobody drives it from end
to end in steps of a run. These differences are allowed for, so that a speed that is right here may be wrong in a run:
the lane aslant to the reference line, along which a step is measured; 0.35 m around each place where the shape of the
road changes; what the bend or slant changes within a sample of 0.1 m; places near the centre of a bend; and the length
of lanes that have corners or steps, or are shorter than 1 m.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from cornercase.roads import RoadNetwork
from cornercase.roads.lane_path import STEP
from cornercase.roads.road import Road
from cornercase.simulators.builtin.tracks.lane import LaneTrack

Floats = npt.NDArray[np.float64]
Truths = npt.NDArray[np.bool_]

SPEED = 10.0
"""m/s, as everybody is asked to drive."""
# s; short, since esmini takes the bend at the begin of a step for all of it.
_STEP = 1e-3
# m: so far apart are the places that are looked at.
_APART = 0.5
# m: so near a place where the shape of a road changes at once, samples of both sides are mixed.
_MIXED = 0.35
# m: lanes that are shorter have no speed but that of the change from one to the next.
_SHORT = 1.0
# rad: a lane that turns by more from one sample to the next has a corner.
_CORNER = 0.02
# Of the reference line; where a lane is shorter, the engine leaves the reference line alone.
_NARROW = 0.15


@dataclass(frozen=True)
class DrivenLane:
    """A lane of one lane section.

    Attributes
    ----------
    road : str
    lane : int
    start : float
        Where the section begins, in m.
    error : float
        Largest relative error of its speed over ground, wherever on the lane.
    at : float
        Coordinate s of that, in m.
    crash : str
        What went wrong; empty where nothing did.
    """

    road: str
    lane: int
    start: float
    error: float = 0.0
    at: float = 0.0
    crash: str = ""

    def __str__(self) -> str:
        where = f"road {self.road}, lane {self.lane} from s = {self.start:.6g} m"
        return f"{where}: {self.crash or f'speed {self.error:.2%} off at s = {self.at:.6g} m'}"


def drive_lanes(network: RoadNetwork, every: int = 1) -> Iterator[DrivenLane]:
    """Drive every lane of every section of every road, or every so many of them."""
    count = 0
    for r, road in enumerate(network.roads):
        for k, (start, lanes) in enumerate(road.sections):
            for lane in lanes:
                count += 1
                if count % every:
                    continue
                try:
                    yield _drive(network, r, k, lane)
                except Exception as error:
                    yield DrivenLane(road.name, lane, start, crash=f"{type(error).__name__}: {error}")


def _drive(network: RoadNetwork, r: int, section: int, lane: int) -> DrivenLane:
    road = network.roads[r]
    start, end = road.section_span(section)
    middle = 0.5 * (start + end)
    path = network.path_of_lane(r, lane, middle, network.runs_along(r, lane, middle))
    assert path is not None
    for name in ("x", "y", "heading", "reference"):
        assert np.isfinite(getattr(path, name)).all(), f"{name} is not finite"
    track = LaneTrack(path)
    begin, until = path.lane_span
    assert begin <= until, "ends before it begins"
    distance = np.linspace(begin, until, int((until - begin) / _APART) + 2)
    after = track.advance(distance, np.zeros(len(distance)), np.full(len(distance), SPEED * _STEP))
    assert (after[:-1] > distance[:-1]).all() or until - begin < _SHORT, "stands still"
    (x, y, *_), (to_x, to_y, *_) = (path.at(one, np.zeros(len(one))) for one in (distance, after))
    s = path.s_at(distance)
    # As in esmini the way is that along the reference line: aslant to it, it is longer.
    asked = SPEED * _STEP / np.cos(road.slant(section, lane, s))
    error = np.abs(np.hypot(to_x - x, to_y - y) / asked - 1.0) - _ripple(road, section, lane, s)
    inside = np.minimum(distance - begin, until - distance) > _MIXED
    error = np.where(inside & _smooth(road, section, lane, s), np.maximum(error, 0.0), 0.0)
    worst = int(error.argmax())
    length, even = _length(road, section, lane)
    whole = abs((until - begin) / length - 1.0) if even and length > _SHORT else 0.0
    if whole > error[worst]:
        return DrivenLane(road.name, lane, start, float(whole), path.lane_s[0])
    return DrivenLane(road.name, lane, start, float(error[worst]), float(s[worst]))


def _smooth(road: Road, section: int, lane: int, s: Floats) -> Truths:
    """Where neither a piece of the road begins nor one of its lanes up to this one, nor a bend has its centre near."""
    start, lanes = road.sections[section]
    sign = 1 if lane > 0 else -1
    inner = [one for number, one in lanes.items() if 0 < number * sign <= abs(lane)]
    seams = [*road.section_span(section), *(g.s for g in road.geometries), *(one[0] for one in road.offsets)]
    seams += [start + line[0] for one in inner for line in one.widths or one.borders]
    shrunk = 1.0 - road.bend(s) * road.center(section, lane, s)
    # A sample of the path stands for more of the reference line, the narrower the bend is.
    near = np.abs(s[:, None] - np.array(seams)).min(axis=1)
    return np.asarray((shrunk > _NARROW) & (near > _MIXED / np.minimum(np.maximum(shrunk, _NARROW), 1.0)))


def _ripple(road: Road, section: int, lane: int, s: Floats) -> Floats:
    """How much the way along the lane changes by that along the reference line from one sample to the next."""
    before, after = (
        np.hypot(1.0 - road.bend(at) * road.center(section, lane, at), _slope(road, section, lane, at))
        for at in (s - STEP, s + STEP)
    )
    return np.asarray(0.5 * np.abs(after - before) / np.minimum(np.minimum(before, after), 1.0))


def _slope(road: Road, section: int, lane: int, s: Floats) -> Floats:
    inner, outer = road.edges(section, lane, s, rate=True)
    return 0.5 * (inner + outer)


def _length(road: Road, section: int, lane: int) -> tuple[float, bool]:
    """Length of a lane, from the shape of the road alone, and whether it has neither corners nor steps to cut."""
    start, end = road.section_span(section)
    s = np.linspace(start, end, int((end - start) / (0.5 * STEP)) + 2)
    center = road.center(section, lane, s)
    x, y, _ = road.at(s, center)
    chord = np.hypot(np.diff(x), np.diff(y))
    turned = np.abs(np.diff(np.unwrap(np.arctan2(np.diff(y), np.diff(x)))))
    shrunk = 1.0 - road.bend(s) * center
    even = turned.max(initial=0.0) < _CORNER and shrunk.min() > _NARROW and chord.max() < 2.0 * STEP
    return float(chord.sum()), bool(even)
