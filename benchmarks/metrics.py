"""Criticality metrics beside CommonRoad-CriMe: same scenes, values and time per instant.

python benchmarks/metrics.py [--quick] [--json FILE]

CommonRoad-CriMe needs an older protobuf and numpy than other extras do, so give it an environment of its own:

    python -m venv crime && crime/bin/pip install -e '.[bench-metrics]' && crime/bin/python benchmarks/metrics.py

Each metric that both have is computed at the beginning of each scene. Where the two differ, the value that
CommonRoad-CriMe's own definition gives is computed from cornercase's state and set beside; the definition is
named below the table. A difference that no definition explains is marked. Its roads run (nearly) along +x, since
most of its metrics hold on such roads only.
"""

# mypy: disable-error-code="import-not-found, import-untyped"

from __future__ import annotations

import argparse
import io
import json
import logging
import math
import sys
import time
from collections.abc import Callable
from contextlib import redirect_stdout
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from cornercase.metrics import (
    METRICS,
    Btn,
    Dce,
    DeltaV,
    Dst,
    EncroachmentTime,
    Headway,
    LateralAcceleration,
    LongitudinalAcceleration,
    Pet,
    Stn,
    StoppingDistance,
    Tet,
    Thw,
    Tit,
    Ttc,
    Ttce,
    Wttc,
)
from cornercase.metrics._wttc import earliest_circle_contact
from cornercase.recordings import Recording

STEP = 0.1
A_MAX = 11.5
A_LATERAL = 8.0
# At a heading of exactly 0 CommonRoad-CriMe takes the angle for a missing one.
TURN = math.radians(0.05)
LENGTH, WIDTH = 4.0, 2.0

# Ego, then other: x, y, heading, speed, acceleration; both go straight and brake to a stop.
FOLLOWING = {
    "closing": ((0, 0, 0, 20, 0), (34, 0, 0, 10, 0)),
    "equal speed": ((0, 0, 0, 20, 0), (34, 0, 0, 20, 0)),
    "opening": ((0, 0, 0, 20, 0), (34, 0, 0, 25, 0)),
    "standing leader": ((0, 0, 0, 20, 0), (64, 0, 0, 0, 0)),
    "standing follower": ((0, 0, 0, 0, 0), (34, 0, 0, 10, 0)),
    "both stand": ((0, 0, 0, 0, 0), (20, 0, 0, 0, 0)),
    "ego brakes in time": ((0, 0, 0, 20, -2), (34, 0, 0, 10, 0)),
    "ego brakes too late": ((0, 0, 0, 20, -1), (34, 0, 0, 10, 0)),
    "leader brakes": ((0, 0, 0, 20, 0), (34, 0, 0, 10, -2)),
    "nearly in contact": ((0, 0, 0, 30, 0), (4.5, 0, 0, 0, 0)),
    "offset in the lane": ((0, 0, 0, 20, 0), (34, 0.5, 0, 10, 0)),
    "slow and near": ((0, 0, 0, 5, 0), (8, 0, 0, 3, 0)),
}
CROSSING = {
    "ego first": ((-30, 0, 0, 10, 0), (0, -50, math.pi / 2, 10, 0)),
    "ego first by far": ((-30, 0, 0, 10, 0), (0, -70, math.pi / 2, 10, 0)),
    "other first": ((-60, 0, 0, 12, 0), (0, -20, math.pi / 2, 8, 0)),
    "other first by far": ((-80, 0, 0, 12, 0), (0, -15, math.pi / 2, 9, 0)),
    "ego fast": ((-40, 0, 0, 20, 0), (0, -60, math.pi / 2, 12, 0)),
    "other slow": ((-30, 0, 0, 10, 0), (0, -40, math.pi / 2, 6, 0)),
    "ego slow": ((-25, 0, 0, 6, 0), (0, -70, math.pi / 2, 11, 0)),
    "collision": ((-30, 0, 0, 10, 0), (0, -31, math.pi / 2, 10, 0)),
    "just behind": ((-30, 0, 0, 10, 0), (0, -41, math.pi / 2, 10, 0)),
    "ego brakes": ((-60, 0, 0, 14, -1), (0, -25, math.pi / 2, 9, 0)),
}
AREA = (0.0, 0.0, 0.0, 4.0, 4.0)


def recorded(actors: tuple[tuple[float, ...], ...], steps: int, turn: float) -> Recording:
    t = np.arange(steps + 1) * STEP
    x, y, heading, speed, acceleration = (
        np.array(column, dtype=float)[:, None] for column in zip(*actors, strict=True)
    )
    stop = np.where(acceleration * speed < 0, -speed / np.where(acceleration == 0, 1, acceleration), np.inf)
    driven = np.minimum(t, stop)
    way = speed * driven + 0.5 * acceleration * driven**2
    x, y = x + way * np.cos(heading), y + way * np.sin(heading)
    box = np.full(len(actors), 1.0)
    return Recording(
        time=t,
        names=tuple(str(k + 1) for k in range(len(actors))),
        object_types=("car",) * len(actors),
        x=math.cos(turn) * x - math.sin(turn) * y,
        y=math.sin(turn) * x + math.cos(turn) * y,
        heading=heading + turn + 0 * t,
        speed=np.where(t < stop, speed + acceleration * t, 0.0),
        acceleration=np.where(t < stop, acceleration, 0.0),
        length=LENGTH * box,
        width=WIDTH * box,
        center_x=0.0 * box,
    )


def scenario(recording: Recording, crossing: bool) -> Any:
    """The same as a CommonRoad scenario, on one road or on two that cross."""
    from commonroad.geometry.shape import Rectangle
    from commonroad.prediction.prediction import TrajectoryPrediction
    from commonroad.scenario.intersection import Intersection, IntersectionIncomingElement
    from commonroad.scenario.lanelet import Lanelet, LaneletNetwork, LaneletType
    from commonroad.scenario.obstacle import DynamicObstacle, ObstacleType
    from commonroad.scenario.scenario import Scenario, ScenarioID, Tag
    from commonroad.scenario.state import CustomState, InitialState
    from commonroad.scenario.trajectory import Trajectory

    def lanelet(number: int, begin: float, end: float, turn: float, **links: Any) -> Any:
        along = np.linspace(begin, end, max(int(end - begin) // 2, 2))
        forward, left = np.array([math.cos(turn), math.sin(turn)]), np.array([-math.sin(turn), math.cos(turn)])
        edge = along[:, None] * forward
        return Lanelet(edge + 2 * left, edge, edge - 2 * left, number, **links)

    made = Scenario(STEP, ScenarioID(country_id="DEU", map_name="Bench"))
    if crossing:
        made.tags = {Tag.INTERSECTION}
        inside = {"lanelet_type": {LaneletType.INTERSECTION}}
        lanelets = [
            lanelet(11, -100, -2, 0.0, successor=[12]),
            lanelet(12, -2, 2, 0.0, predecessor=[11], successor=[13], **inside),
            lanelet(13, 2, 200, 0.0, predecessor=[12]),
            lanelet(21, -100, -2, math.pi / 2, successor=[22]),
            lanelet(22, -2, 2, math.pi / 2, predecessor=[21], successor=[23], **inside),
            lanelet(23, 2, 200, math.pi / 2, predecessor=[22]),
        ]
        incomings = [
            IntersectionIncomingElement(31, {11}, successors_straight={12}),
            IntersectionIncomingElement(32, {21}, successors_straight={22}),
        ]
        network = LaneletNetwork.create_from_lanelet_list(lanelets)
        network.add_intersection(Intersection(30, incomings))
    else:
        network = LaneletNetwork.create_from_lanelet_list([lanelet(11, -100, 500, TURN)])
    made.add_objects(network)
    for row, name in enumerate(recording.names):
        states = [
            {
                "position": np.array([recording.x[row, k], recording.y[row, k]]),
                "orientation": float(recording.heading[row, k]),
                "velocity": float(recording.speed[row, k]),
                "time_step": k,
            }
            for k in range(len(recording.time))
        ]
        shape = Rectangle(LENGTH, WIDTH)
        trajectory = Trajectory(1, [CustomState(**one) for one in states[1:]])
        found = [network.find_lanelet_by_position([one["position"]])[0] for one in states]
        assignment = {k: set(lanelets) for k, lanelets in enumerate(found)}
        prediction = TrajectoryPrediction(trajectory, shape, assignment, assignment)
        start = InitialState(**states[0], yaw_rate=0.0, slip_angle=0.0)
        made.add_objects(
            DynamicObstacle(int(name), ObstacleType.CAR, shape, start, prediction, assignment[0], assignment[0])
        )
    return made


def theirs(name: str, made: Any, configuration: Any) -> Callable[[int], float]:
    """A measure of CommonRoad-CriMe by its class name, ready to be asked for a step."""
    import commonroad_crime.measure as measures

    measure = getattr(measures, name)(configuration)

    def value(step: int) -> float:
        with redirect_stdout(io.StringIO()):
            found = measure.compute(vehicle_id=2, time_step=step, verbose=False)
        return math.nan if found is None else float(found)

    return value


def configured(made: Any) -> Any:
    from commonroad_crime.data_structure.configuration import CriMeConfiguration

    configuration = CriMeConfiguration()
    configuration.update(ego_id=1, sce=made)
    configuration.vehicle.ego_id = 1
    return configuration


# --- their definitions, from our states ---------------------------------------------------------------------


def _state(recording: Recording) -> dict[str, Any]:
    """What their formulas take, at the first instant; the gap is that of the boxes along the road."""
    forward = np.array([math.cos(TURN), math.sin(TURN)])
    start = recording.box_center("2")[0] - recording.box_center("1")[0]
    return {
        "apart": start,
        "gap": float(start @ forward) - LENGTH,
        "v1": recording.speed[0, 0],
        "v2": recording.speed[1, 0],
        "a1": recording.acceleration[0, 0],
        # The sign of the other's acceleration is lost in a square root of squares.
        "a2": abs(recording.acceleration[1, 0]),
    }


def _their_ttc(recording: Recording) -> float:
    s = _state(recording)
    v, a, gap = s["v2"] - s["v1"], s["a2"] - s["a1"], s["gap"]
    if v < 0 and abs(a) <= 0.1:
        return float(-gap / v)
    if v * v - 2 * gap * a < 0 or not ((v < 0 and a != 0) or v >= 0 > a):
        return math.inf
    return float(-v / a - math.sqrt(v * v - 2 * gap * a) / a)


def _their_wttc(recording: Recording) -> float:
    """All roots of the quartic in the order of the solver; the first that is real and positive."""
    s = _state(recording)
    heading = recording.heading[:, 0]
    way = np.stack([recording.speed[:, 0] * np.cos(heading), recording.speed[:, 0] * np.sin(heading)], -1)
    p, v = s["apart"], way[1] - way[0]
    radius, growth = 2 * math.hypot(LENGTH / 6, WIDTH / 2), 2 * A_MAX
    roots = np.roots([-(growth**2) / 4, 0, v @ v - radius * growth, 2 * (p @ v), p @ p - radius**2])
    return next((float(r.real) for r in roots if abs(r.imag) < 1e-12 and r.real > 0), math.nan)


def _their_thw(recording: Recording) -> float:
    """The step after which the front is beyond the place of the rear, of those that are recorded."""
    if _state(recording)["gap"] < 0:
        return math.inf
    forward = np.array([math.cos(TURN), math.sin(TURN)])
    front = recording.box_center("1") @ forward + LENGTH / 2
    beyond = np.flatnonzero(front > recording.box_center("2")[0] @ forward - LENGTH / 2)
    return float(beyond[0] * STEP) if len(beyond) else math.inf


def _their_long(recording: Recording) -> float:
    s = _state(recording)
    return float(min(s["a2"] - (s["v2"] - s["v1"]) ** 2 / (2 * s["gap"]), 0.0))


def _their_lat(recording: Recording) -> float:
    s, ttc = _state(recording), _their_ttc(recording)
    if math.isinf(ttc):
        return 0.0
    ttc = round(ttc, 2)
    drift = (s["v2"] * math.sin(TURN) - s["v1"]) * math.sin(TURN)
    own = s["a2"] * math.sin(TURN)
    return float(min(abs(own - 2 * (side * WIDTH - drift * ttc) / ttc**2) for side in (1, -1)))


def _their_dst(recording: Recording) -> float:
    s = _state(recording)
    return float(3 * (s["v1"] - s["v2"]) ** 2 / (2 * (s["gap"] - 2.0 * s["v2"])))


def _their_exposure(recording: Recording, power: int) -> float:
    """Sum over the steps, with their time to collision."""
    total = 0.0
    for k in range(len(recording.time) - 1):
        motion: Any = {column: getattr(recording, column)[:, k:] for column in MOTION}
        one = replace(recording, time=recording.time[k:], **motion)
        ttc = _their_ttc(one) if _state(one)["gap"] > 0 else math.inf
        if ttc <= 2.0:
            total += STEP * (2.0 - ttc) ** power
    return total


MOTION = ("x", "y", "heading", "speed", "acceleration")


def _recorded_encounter(recording: Recording) -> tuple[float, float]:
    """Smallest gap of the recorded motion, and the time from now on."""
    gaps = METRICS.create("clearance").course(recording, "1", "2")[:-1]
    return float(gaps.min()), float(recording.time[gaps.argmin()])


def _their_delta_v(recording: Recording) -> float:
    s = _state(recording)
    return float(0.5 * (s["v1"] + s["v2"] * math.cos(recording.heading[1, 0] - recording.heading[0, 0])))


def _area_steps(recording: Recording, name: str) -> tuple[float, float]:
    """Entering a step early and leaving a step late."""
    from cornercase._common.geometry.boxes import box_corners, boxes_overlap
    from cornercase.metrics._geometry.boxes import box_corners_over_time

    inside = np.flatnonzero(boxes_overlap(box_corners_over_time(recording, name), box_corners(*AREA)))
    return (max(inside[0] - 1, 0) * STEP, (inside[-1] + 1) * STEP) if len(inside) else (math.inf, math.inf)


def _their_et(recording: Recording) -> float:
    enters, leaves = _area_steps(recording, "1")
    return leaves - enters


def _their_pet(recording: Recording) -> float:
    (in_1, out_1), (in_2, out_2) = (_area_steps(recording, name) for name in ("1", "2"))
    return in_2 - out_1 if out_1 <= in_2 else in_1 - out_2 if out_2 <= in_1 else math.inf


# Ours, the name of theirs, tolerance of a match (their rounding), their definition from our states, in words.
Row = tuple[Any, str, float, Callable[[Recording], float], str]
# What a step more or less makes out where they count steps: at its edges their rounding decides.
EDGES = {"thw": STEP, "tet": STEP, "tit": 2.0 * STEP, "ttce": STEP, "pet": 2 * STEP, "encroachment-time": 2 * STEP}
ROWS: dict[str, Row] = {
    "ttc": (Ttc(accelerating=True), "TTC", 0.006, _their_ttc,
            "with accelerations; the sign of the leader's is lost, and braking goes on after the stop"),
    "wttc": (Wttc(A_MAX, A_MAX), "WTTC", 0.051, _their_wttc,
             "circles of radius hypot(L / 6, W / 2), smaller than the box; the solver's first positive root"),
    "hw": (Headway(), "HW", 0.006, lambda r: _state(r)["gap"], "along the lane"),
    "thw": (Thw(), "THW", 0.006, _their_thw,
            "in whole steps of the recorded motion, give or take one; inf where it ends"),
    "a-long-req": (LongitudinalAcceleration(), "ALongReq", 0.006, _their_long,
                   "also for an opening gap; the sign of the leader's acceleration is lost"),
    "btn": (Btn(A_MAX), "BTN", 0.0006, lambda r: -_their_long(r) / A_MAX, "as a-long-req"),
    "a-lat-req": (LateralAcceleration(), "ALatReq", 0.006, _their_lat,
                  "with their TTC; the offset is that of the ego from itself, the drift has a sine too many"),
    "stn": (Stn(A_LATERAL), "STN", 0.001, lambda r: _their_lat(r) / A_LATERAL, "as a-lat-req"),
    "dst": (Dst(2.0), "DST", 0.006, _their_dst, "a factor of 3; no limit where the gap opens or is used up"),
    "delta-v": (DeltaV(predicted=True), "DeltaV", 0.006, _their_delta_v, "the velocities are added: v1 + v2 cos"),
    "msd": (StoppingDistance(A_MAX), "MSD", 0.006, lambda r: r.speed[0, 0] ** 2 / (2 * A_MAX), "the same"),
    "tet": (Tet(2.0, "samples"), "TET", 0.006, lambda r: _their_exposure(r, 0),
            "with their TTC, which has accelerations, and is inf once the boxes overlap"),
    "tit": (Tit(2.0, "samples"), "TIT", 0.006, lambda r: _their_exposure(r, 1), "as tet"),
    "dce": (Dce(), "DCE", 0.006, lambda r: _recorded_encounter(r)[0], "of the recorded motion, not of a straight one"),
    "ttce": (Ttce(), "TTCE", 0.006, lambda r: _recorded_encounter(r)[1],
             "at recorded steps; of several the first, also when they drive alike"),
    "pet": (Pet(area=AREA), "PET", 0.006, _their_pet,
            "whole steps: entering one early, leaving one late, give or take rounding"),
    "encroachment-time": (EncroachmentTime(area=AREA), "ET", 0.006, _their_et, "as pet"),
}  # fmt: skip
ON_CROSSING = {"pet", "encroachment-time"}
BOTH = {"dce", "ttce", "wttc", "delta-v", "msd"}


def agreement() -> list[dict[str, Any]]:
    rows: list[dict[str, Any]] = []
    scenes: list[tuple[str, Any, bool]] = [(f"following: {name}", actors, False) for name, actors in FOLLOWING.items()]
    scenes += [(f"crossing: {name}", actors, True) for name, actors in CROSSING.items()]
    for scene, actors, crossing in scenes:
        recording = recorded(actors, 100 if crossing else 60, 0.0 if crossing else TURN)
        made = scenario(recording, crossing)
        for name, (metric, peer, tolerance, definition, _) in ROWS.items():
            if crossing != (name in ON_CROSSING) and not (crossing and name in BOTH):
                continue
            course = metric.course(recording, "1", "2")
            ours = metric.score(course) if name in ("tet", "tit") else float(course[0])
            try:
                value: float | str = theirs(peer, made, configured(made))(0)
            except Exception as error:
                value = f"{type(error).__name__}"
            expected = definition(recording)
            rows.append(
                {
                    "metric": name,
                    "scene": scene,
                    "ours": ours,
                    "theirs": value,
                    "their definition": expected,
                    "verdict": "same"
                    if same(ours, value, tolerance)
                    else "by definition"
                    if same(expected, value, tolerance + EDGES.get(name, 0.0))
                    else "not explained",
                }
            )
    return rows


def same(a: float, b: float | str, tolerance: float) -> bool:
    if isinstance(b, str):
        return False
    if not (math.isfinite(a) and math.isfinite(b)):
        # Not defined and never are one here: they say inf for both.
        return not math.isfinite(a) and not math.isfinite(b)
    return abs(a - b) <= tolerance + 1e-9


def speed(quick: bool) -> list[dict[str, Any]]:
    """Seconds per instant over the same states.

    Theirs as a user asks for a scenario, through its interface, and the bare formula, its preparation done once;
    ours by recordings of 61 instants, and the same states in one recording.
    """
    import commonroad_crime.measure as measures
    from commonroad_crime.data_structure.crime_interface import CriMeInterface

    rows = []
    recordings = [recorded(actors, 60, TURN) for actors in FOLLOWING.values()][: 3 if quick else None]
    for name, metric, peer in (("wttc", Wttc(A_MAX, A_MAX), "WTTC"), ("ttc", Ttc(), "TTC")):
        asked, bare, instants = 0.0, 0.0, 0
        for recording in recordings:
            made = scenario(recording, False)
            measure, interface = theirs(peer, made, configured(made)), CriMeInterface(configured(made))
            measure(0)
            for step in range(40):
                begin = time.perf_counter()
                try:
                    measure(step)
                except IndexError:  # overlapping circles
                    continue
                between = time.perf_counter()
                with redirect_stdout(io.StringIO()):
                    interface.evaluate_scene([getattr(measures, peer)], step, vehicle_id=2, verbose=False)
                asked, bare, instants = asked + time.perf_counter() - between, bare + between - begin, instants + 1
        copies = 20 if quick else 200
        metric.course(recordings[0], "1", "2")
        begin = time.perf_counter()
        for _ in range(copies):
            for recording in recordings:
                metric.course(recording, "1", "2")
        alone = (time.perf_counter() - begin) / (copies * len(recordings) * 61)
        many = joined(recordings, copies)
        begin = time.perf_counter()
        metric.course(many, "1", "2")
        together = (time.perf_counter() - begin) / len(many.time)
        rows.append(
            {
                "metric": name,
                "theirs, asked for": asked / instants,
                "theirs, formula": bare / instants,
                "by recordings": alone,
                "in one recording": together,
            }
        )
    return rows


def joined(recordings: list[Recording], copies: int) -> Recording:
    one = recordings[0]
    motion: Any = {
        column: np.tile(np.concatenate([getattr(one, column) for one in recordings], axis=1), copies)
        for column in MOTION
    }
    return replace(one, time=np.arange(motion["x"].shape[1]) * STEP, collisions=(), **motion)


def batch() -> dict[str, Any]:
    """3,375 scenarios of 400 instants of WTTC, one recording after the other and all in one array."""
    rng = np.random.default_rng(0)
    shape = (3375, 400, 2)
    position, velocity = rng.normal(0, 40, shape), rng.normal(0, 10, shape)
    begin = time.perf_counter()
    earliest_circle_contact(position, velocity, 2 * math.hypot(2, 1), 13.8)
    whole = time.perf_counter() - begin
    recording = recorded(FOLLOWING["closing"], 399, TURN)
    metric = Wttc()
    begin = time.perf_counter()
    for _ in range(3375):
        metric.course(recording, "1", "2")
    return {"in one array": whole, "by recordings": time.perf_counter() - begin}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="fewer states for the times")
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args()
    logging.disable(logging.WARNING)
    result: dict[str, Any] = {"batch": batch()}
    print("3,375 scenarios x 400 instants of wttc: {in one array:.2f} s in one array, ".format(**result["batch"])
          + "{by recordings:.2f} s by recordings".format(**result["batch"]))  # fmt: skip
    try:
        import commonroad_crime  # noqa: F401
    except ImportError:
        print("commonroad-crime is not installed, so nothing is compared (extra 'bench-metrics').", file=sys.stderr)
    else:
        rows = agreement()
        result |= {"agreement": rows, "speed": speed(options.quick)}
        print(
            f"\n{'metric':18} {'scenes':>6} {'same':>5} {'by definition':>14} {'not explained':>14}  their definition"
        )
        for name, row in ROWS.items():
            verdicts = [one["verdict"] for one in rows if one["metric"] == name]
            counts = (verdicts.count(v) for v in ("same", "by definition", "not explained"))
            print("{:18} {:6} {:5} {:14} {:14}  {}".format(name, len(verdicts), *counts, row[4]))
        print(f"\n{'metric':18} {'scene':32} {'cornercase':>11} {'CriMe':>11} {'by its definition':>18}")
        for one in rows:
            if one["verdict"] != "same":
                value = one["theirs"] if isinstance(one["theirs"], str) else f"{one['theirs']:.4g}"
                mark = "" if one["verdict"] == "by definition" else "  not explained"
                print(f"{one['metric']:18} {one['scene']:32} {one['ours']:11.4g} {value:>11} "
                      f"{one['their definition']:18.4g}{mark}")  # fmt: skip
        print(
            f"\n{'µs per instant':18} {'CriMe':>10} {'its formula':>12} {'cornercase':>11} {'in one':>8} {'ratios':>32}"
        )
        for one in result["speed"]:
            theirs_, formula, alone, together = (value * 1e6 for key, value in one.items() if key != "metric")
            ratios = (
                f"{theirs_ / alone:.0f} to {theirs_ / together:.0f}, {formula / alone:.0f} to {formula / together:.0f}"
            )
            print(f"{one['metric']:18} {theirs_:10.1f} {formula:12.1f} {alone:11.3f} {together:8.3f} {ratios:>32}")
    if options.json:
        options.json.write_text(json.dumps(result, indent=1))


if __name__ == "__main__":
    main()
