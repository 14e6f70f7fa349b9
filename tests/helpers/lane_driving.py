"""Every lane of a road network: whether it can be driven, and how fast that is over ground.

Steps of 0.05 s from places all along a lane are looked at, by how far they lead along its centre line, and how long the
whole line is by the shape of the road alone. Left out are steps over a place where the lane jumps aside, which takes no
time, as in esmini, and the length of lanes that have corners or steps, or are shorter than 1 m.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from cornercase.roads._lane_path import SAMPLE_DISTANCE
from cornercase.roads._network import RoadNetwork
from cornercase.roads._road import Road
from cornercase.simulators.builtin.tracks._lane import LaneTrack

Floats = npt.NDArray[np.float64]

SPEED = 10.0
"""m/s, as everybody is asked to drive."""
# s
_STEP = 0.05
# m: so far apart are the places that are looked at.
_APART = 0.5
# m: a lane that goes on so far aside jumps there.
_JUMP = 0.02
# m: so near a jump samples of both sides are mixed.
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
                    yield DrivenLane(road.road_id, lane, start, crash=f"{type(error).__name__}: {error}")


def _drive(network: RoadNetwork, r: int, section: int, lane: int) -> DrivenLane:
    road = network.roads[r]
    start, end = road.section_interval(section)
    middle = 0.5 * (start + end)
    path = network.lane_path_from(r, lane, middle, network.is_traffic_forward(r, lane, middle))
    assert path is not None
    for name in ("x", "y", "heading", "reference_distance"):
        assert np.isfinite(getattr(path, name)).all(), f"{name} is not finite"
    track = LaneTrack(path)
    begin, until = path.lane_span
    assert begin <= until, "ends before it begins"
    way = SPEED * _STEP
    distance = np.linspace(begin, until, int((until - begin) / _APART) + 2)
    distance = distance[distance + way < max(until, begin + way)]
    if not len(distance):
        return DrivenLane(road.road_id, lane, start)
    after = track.advance(distance, np.zeros(len(distance)), np.full(len(distance), way))
    assert (after > distance).all() or until - begin < _SHORT, "stands still"
    s, to = track.s_at(distance), track.s_at(after)
    jumps = _jumps(road, section, lane)[:, None]
    clear = ~((jumps > np.minimum(s, to) - _MIXED) & (jumps < np.maximum(s, to) + _MIXED)).any(axis=0)
    long = min(until - begin, end - start) > _SHORT
    error = np.where(clear & long, np.abs((after - distance) / way - 1.0), 0.0)
    worst = int(error.argmax())
    length, even = _length(road, section, lane)
    whole = abs((until - begin) / length - 1.0) if even and length > _SHORT else 0.0
    if whole > error[worst]:
        return DrivenLane(road.road_id, lane, start, float(whole), path.lane_s[0])
    return DrivenLane(road.road_id, lane, start, float(error[worst]), float(s[worst]))


def _jumps(road: Road, section: int, lane: int) -> Floats:
    """Where a lane jumps aside, in m along s, as its reference line, its offset or the widths up to it do."""
    start, lanes = road.sections[section]
    sign = 1 if lane > 0 else -1
    inner = [one for number, one in lanes.items() if 0 < number * sign <= abs(lane)]
    seams = [*(g.s for g in road.geometries), *(one[0] for one in road.lane_offsets)]
    seams += [start + line[0] for one in inner for line in one.widths or one.borders]
    at = np.array([seam for seam in sorted(set(seams)) if road.section_interval(section)[0] < seam])
    (x, y, _), (to_x, to_y, _) = (road.pose_at(s, road.lane_center(section, lane, s)) for s in (at - 1e-6, at + 1e-6))
    return at[np.hypot(to_x - x, to_y - y) > _JUMP]


def _length(road: Road, section: int, lane: int) -> tuple[float, bool]:
    """Length of a lane, from the shape of the road alone, and whether it has neither corners nor steps to cut."""
    start, end = road.section_interval(section)
    s = np.linspace(start, end, int((end - start) / (0.5 * SAMPLE_DISTANCE)) + 2)
    center = road.lane_center(section, lane, s)
    x, y, _ = road.pose_at(s, center)
    chord = np.hypot(np.diff(x), np.diff(y))
    turned = np.abs(np.diff(np.unwrap(np.arctan2(np.diff(y), np.diff(x)))))
    shrunk = 1.0 - road.reference_curvature(s) * center
    even = turned.max(initial=0.0) < _CORNER and shrunk.min() > _NARROW and chord.max() < 2.0 * SAMPLE_DISTANCE
    return float(chord.sum()), bool(even)
