"""What a system under test sees, against closed forms and a naive search."""

from __future__ import annotations

import math
from typing import Any, ClassVar

import numpy as np
import pytest

import cornercase as cc
from conftest import car, place, private, scenario_file, speed_action, teleport, trajectory
from cornercase.drivers import Body, DrivenPath, Situation
from cornercase.drivers._lanes import driven_path
from cornercase.drivers._view import SharedView, View
from cornercase.drivers.fmu._input_quantities import Traffic, find_quantity
from cornercase.roads._network import RoadNetwork
from helpers import road_networks as rn
from helpers.closed_loop import right_turn, straight

RADIUS = 100.0
LIMIT = '<type s="0" type="rural"><speed max="72" unit="km/h"/></type>'
SHOULDER = '<lane id="-3" type="shoulder"><width sOffset="0" a="2" b="0" c="0" d="0"/></lane>'
LANES: dict[str, Any] = {"right": rn.lane(-1, -1, -1) + rn.lane(-2, -2, -2) + SHOULDER, "left": rn.lane(1, 1, 1)}


def road_along_x(folder, **more: Any) -> RoadNetwork:
    return rn.network(folder, rn.road("1", 400.0, **LANES, **more).replace("<planView>", LIMIT + "<planView>"))


def lane_path(network: RoadNetwork, lane: int, s: float = 50.0, forward: bool = True) -> DrivenPath:
    path = network.lane_path_from(0, lane, s, forward)
    assert path is not None
    return driven_path(path)


def situation(path: DrivenPath, ego: Any, others: Any = (), **more: Any) -> Situation:
    """Ego and others by rows of x, y, heading and speed, each (4, N) or (4,)."""
    ego = np.atleast_2d(np.asarray(ego, dtype=float).T).T.reshape(4, -1)
    n = ego.shape[1]
    state = np.array([np.broadcast_to(np.reshape(other, (4, -1)), (4, n)) for other in others], dtype=float)
    x, y, heading, speed = state.reshape(len(others), 4, n).transpose(1, 2, 0)
    distance = np.zeros(n) + more.pop("distance", 0.0)
    return Situation(
        0.0, 0.05, path, distance, ego[0], ego[1], ego[2], ego[3], np.zeros(n), length=4.0, width=2.0, center_x=1.4, target_speed=np.full(n, 20.0),
        others_x=x, others_y=y, others_heading=heading, others_speed=speed, others_length=np.full(len(others), 5.0),
        others_width=np.full(len(others), 1.8), others_center_x=np.full(len(others), 1.3),
        others_object_type=("car",) * len(others), active=np.ones(n, dtype=bool),
        others_name=tuple(f"car{a}" for a in range(len(others))), **more,
    )  # fmt: skip


def seen(network: RoadNetwork | None, *args: Any, scenario: int = 0, **more: Any) -> View:
    return View(SharedView(situation(*args, **more), network), scenario)


def test_the_lanes_of_a_straight_road_are_those_of_the_file(tmp_path):
    network = road_along_x(tmp_path)
    # The centre of lane -1 is at y = -2.
    view = seen(network, lane_path(network, -1), (60.0, -2.5, 0.0, 10.0), distance=60.0)
    assert [(lane.number, lane.lane_type, lane.same_direction) for lane in view.lanes] == [
        (1, "driving", False), (0, "driving", True), (-1, "driving", True), (-2, "shoulder", True),
    ]  # fmt: skip
    assert [lane.width for lane in view.lanes] == pytest.approx([4.0, 4.0, 4.0, 2.0])
    assert [lane.offset for lane in view.lanes] == pytest.approx([4.5, 0.5, -3.5, -6.5])
    assert [lane.curvature for lane in view.lanes] == pytest.approx([0.0] * 4, abs=1e-9)
    assert view.lane == view.lanes[1]
    assert view.speed_limit == pytest.approx(20.0)


def test_an_ego_that_left_the_lane_of_its_path_is_on_the_next(tmp_path):
    network = road_along_x(tmp_path)
    view = seen(network, lane_path(network, -1), (60.0, -5.0, 0.0, 10.0), [(90.0, -2.0, 0.0, 5.0)], distance=60.0)
    assert [lane.number for lane in view.lanes] == [2, 1, 0, -1]
    assert view.lane is not None
    assert view.lane.offset == pytest.approx(-1.0)
    assert view.objects[0].lane == 1


def test_lanes_of_an_arc_have_their_own_curvature(tmp_path):
    network = road_along_x(tmp_path, shape=f'<arc curvature="{1 / RADIUS}"/>')
    # The circle's centre is (0, 100): lane -1 has the radius 102, and the ego is 0.5 m outside of its centre.
    angle, radius = 0.5, RADIUS + 2.5
    ego = (radius * math.sin(angle), RADIUS - radius * math.cos(angle), angle, 10.0)
    view = seen(network, lane_path(network, -1), ego, distance=angle * 102.0)
    assert [lane.offset for lane in view.lanes] == pytest.approx([4.5, 0.5, -3.5, -6.5], abs=1e-3)
    radii = [RADIUS - 2.0, RADIUS + 2.0, RADIUS + 6.0, RADIUS + 9.0]
    assert [1.0 / lane.curvature for lane in view.lanes] == pytest.approx(radii, rel=1e-3)
    assert view.ego.offset == pytest.approx(-0.5, abs=1e-3)
    assert view.ego.turn == pytest.approx(0.0, abs=1e-3)


def test_objects_have_the_lane_of_their_centre(tmp_path):
    network = road_along_x(tmp_path)
    others = [(90.0, y, 0.0, 5.0) for y in (2.0, -2.0, -6.0, -9.0, -10.5, 4.2)]
    view = seen(network, lane_path(network, -1), (60.0, -2.0, 0.0, 10.0), others, distance=60.0)
    lanes = {other.name: other.lane for other in view.objects}
    assert lanes == {"car0": 1, "car1": 0, "car2": -1, "car3": -2, "car4": None, "car5": None}


@pytest.mark.parametrize("path", [straight(400.0, 0.5), right_turn()])
def test_without_a_lane_to_follow_the_ego_is_on_the_lane_under_it(tmp_path, path):
    network = road_along_x(tmp_path)
    # Its path leads elsewhere: in the second scenario it drives against the road, in the third it has left it.
    ego = np.array([(60.0, -6.2, 0.0, 10.0), (70.0, 1.5, math.pi, 10.0), (50.0, 80.0, 0.0, 10.0)]).T
    other = np.array([(80.0, -2.0, 0.0, 5.0), (40.0, 2.0, math.pi, 5.0), (60.0, 80.0, 0.0, 5.0)]).T
    shared = SharedView(situation(path, ego, [other]), network)
    views = [View(shared, n) for n in range(3)]
    own = [view.lane for view in views]
    assert own[0] is not None
    assert own[1] is not None
    assert own[0].offset == pytest.approx(0.2)
    assert own[0].same_direction
    # The centre of lane 1 is at y = 2, which is on its right hand.
    assert own[1].offset == pytest.approx(-0.5)
    assert own[1].same_direction
    assert [view.objects[0].lane for view in views] == [1, 0, None]
    assert views[2].lanes == ()
    assert own[2] is None
    assert math.isnan(views[2].speed_limit)
    assert views[1].speed_limit == pytest.approx(20.0)


def test_without_roads_there_are_no_lanes():
    view = seen(None, straight(), (60.0, 0.0, 0.0, 10.0), [(80.0, 0.0, 0.0, 10.0)], distance=60.0)
    assert (view.lanes, view.lane, view.objects[0].lane, dict(view.signals)) == ((), None, None, {})
    assert math.isnan(view.speed_limit)


def test_signals_have_their_state_and_the_way_to_them(tmp_path):
    signals = "".join(
        f'<signal id="{name}" s="{s}" t="-9" orientation="{facing}" type="1000001"/>'
        for name, s, facing in (("next", 100, "+"), ("passed", 20, "+"), ("oncoming", 90, "-"))
    )
    text = rn.road("1", 400.0, **LANES).replace("</lanes>", f"</lanes><signals>{signals}</signals>")
    network = rn.network(tmp_path, text)
    states = {"next": np.array(["red"]), "elsewhere": np.array(["green"])}
    view = seen(network, lane_path(network, -1), (60.0, -2.0, 0.0, 10.0), distance=60.0, signals=states)
    # The front of the box is 1.4 + 2 m ahead of the reference point.
    assert [(one.name, one.state, one.signal_type) for one in view.signals.values()] == [
        ("next", "red", "1000001"), ("passed", "", "1000001"), ("elsewhere", "green", ""),
    ]  # fmt: skip
    assert [one.gap for one in view.signals.values()] == pytest.approx([36.6, -43.4, math.nan], nan_ok=True)


def test_an_fmu_is_given_the_same_numbers(tmp_path):
    """In three scenarios: one beside its path and aslant, one on the next lane, one off the road."""
    signal = '<signal id="next" s="100" t="-9" orientation="+" type="1000001"/>'
    arc = rn.road("1", 300.0, shape=f'<arc curvature="{1 / RADIUS}"/>', **LANES)
    arc = arc.replace("<planView>", LIMIT + "<planView>").replace("</lanes>", f"</lanes><signals>{signal}</signals>")
    network = rn.network(tmp_path, arc)
    path = lane_path(network, -1)
    ego = (np.array([60.0, 60.0, 60.0]), np.array([19.0, 14.5, -40.0]), np.array([0.7, 0.6, 0.6]), np.full(3, 10.0))
    given = situation(path, np.stack(ego), distance=60.0, signals={"next": np.array(["red", "GREEN", "flashing"])})
    traffic = Traffic(given, Body("Ego", "car", 4.0, 2.0, 1.4, 2.7, 0.6), network)

    def quantity(name):
        found = find_quantity(name)
        assert found is not None, name
        return found.compute(traffic)

    for n in range(3):
        view = View(SharedView(given, network), n)
        assert quantity("ego.turn")[n] == pytest.approx(view.ego.turn)
        for ahead in (-5, 2.5, 20):
            for field in ("x", "y", "heading", "curvature"):
                expected = getattr(view.path(ahead), field)
                assert quantity(f"path[{ahead}].{field}")[n] == pytest.approx(expected, abs=1e-12)
        for name, number in (("lane", 0), ("lane[1]", 1), ("lane[-1]", -1)):
            lane = next((lane for lane in view.lanes if lane.number == number), None)
            assert quantity(f"{name}.exists")[n] == (lane is not None)
            for field in ("same_direction", "width", "offset", "curvature", "speed_limit"):
                expected = math.nan if lane is None else float(getattr(lane, field))
                assert quantity(f"{name}.{field}")[n] == pytest.approx(expected, nan_ok=True)
        assert quantity("speed_limit")[n] == pytest.approx(view.speed_limit, nan_ok=True)
        following = next((one for one in view.signals.values() if one.gap >= 0.0), None)
        assert quantity("signal.exists")[n] == (following is not None)
        assert quantity("signal.gap")[n] == pytest.approx(math.nan if following is None else following.gap, nan_ok=True)
    assert quantity("lane.exists").tolist() == [1.0, 1.0, 0.0]
    assert quantity("signal.state")[:2].tolist() == [1.0, 3.0]


def naive_object(path: DrivenPath, ego, other) -> tuple[float, float, float]:
    """Gap, lateral distance and closing speed by a dense search along the path."""
    at = np.arange(0.0, path.distance[-1], 1e-3)
    x, y, heading = (np.interp(at, path.distance, column) for column in (path.x, path.y, path.heading))

    def along(px: float, py: float) -> tuple[float, float, float]:
        k = int(np.hypot(x - px, y - py).argmin())
        left = -(px - x[k]) * math.sin(heading[k]) + (py - y[k]) * math.cos(heading[k])
        return float(at[k]), float(left), float(heading[k])

    own, _, _ = along(ego[0], ego[1])
    center = other[0] + 1.3 * math.cos(other[2]), other[1] + 1.3 * math.sin(other[2])
    there, lateral, direction = along(*center)
    corners = [
        (sx * 2.5 * math.cos(other[2] - direction) - sy * 0.9 * math.sin(other[2] - direction)) for sx in (1, -1)
        for sy in (1, -1)
    ]  # fmt: skip
    ahead = there - own - 1.4
    gap = max(abs(ahead) - max(corners) - 2.0, 0.0)
    closing = ego[3] - other[3] * math.cos(other[2] - direction)
    return math.copysign(gap, ahead), lateral, math.copysign(1.0, ahead) * closing


def test_gaps_along_a_bend_are_those_of_a_naive_search():
    path, rng = right_turn(), np.random.default_rng(3)
    for _ in range(30):
        distance = rng.uniform(5.0, 60.0)
        x, y, heading = (np.interp(distance, path.distance, c) for c in (path.x, path.y, path.heading))
        ego = (x, y, heading, rng.uniform(0.0, 20.0))
        at = rng.uniform(2.0, 125.0)
        x, y, heading = (np.interp(at, path.distance, c) for c in (path.x, path.y, path.heading))
        off, speed = rng.uniform(-4.0, 4.0), rng.uniform(0.0, 20.0)
        other = (x - off * math.sin(heading), y + off * math.cos(heading), heading + rng.uniform(-0.3, 0.3), speed)
        (found,) = seen(None, path, ego, [other], distance=distance).objects
        gap, lateral, closing = naive_object(path, ego, other)
        assert found.gap == pytest.approx(gap, abs=0.02)
        assert found.lateral == pytest.approx(lateral, abs=0.02)
        assert found.closing == pytest.approx(closing, abs=0.05)


def test_the_leader_is_the_nearest_in_the_path_whatever_the_order_of_the_others():
    rng = np.random.default_rng(1)
    n, others = 50, 6
    states = rng.uniform((0.0, -4.0, -0.3, 0.0), (150.0, 4.0, 0.3, 20.0), (n, others, 4)).transpose(1, 2, 0)
    shared = SharedView(
        situation(straight(), np.array([np.full(n, 50.0), np.zeros(n), np.zeros(n), np.full(n, 9.0)]), [*states],
                  distance=50.0),
        None,
    )  # fmt: skip
    led = 0
    for k in range(n):
        view = View(shared, k)
        ahead = [other for other in view.objects if other.in_path and other.gap >= 0.0 and other.x > 0.0]
        assert view.leader == min(ahead, key=lambda other: other.gap, default=None)
        led += view.leader is not None
        distances = [math.hypot(other.x, other.y) for other in view.objects]
        assert distances == sorted(distances)
        assert len(distances) == others
    assert 20 < led <= n


def test_an_absent_entity_is_not_seen():
    view = seen(None, straight(), (50.0, 0.0, 0.0, 9.0), [(np.nan,) * 4, (70.0, 0.0, 0.0, 9.0)], distance=50.0)
    assert [other.name for other in view.objects] == ["car1"]
    assert view.leader == view.objects[0]


def test_what_is_seen_does_not_depend_on_the_other_scenarios(tmp_path):
    network, rng = road_along_x(tmp_path, shape=f'<arc curvature="{1 / RADIUS}"/>'), np.random.default_rng(5)
    path, n = lane_path(network, -1), 12
    at = rng.uniform(20.0, 150.0, n)
    ego = np.array([*(np.interp(at, path.distance, c) for c in (path.x, path.y, path.heading)), at])
    ego[:2] += rng.uniform(-3.0, 3.0, (2, n))
    others = [ego + rng.uniform(-20.0, 20.0, (4, n)) * [[1.0], [1.0], [0.01], [0.1]] for _ in range(3)]

    def told(shared: SharedView, k: int) -> list[object]:
        view = View(shared, k)
        lanes = [other.lane for other in view.objects]
        return [view.ego, view.objects, view.leader, view.lanes, lanes, view.speed_limit, view.path(20.0)]

    together = SharedView(situation(path, ego, others, distance=at), network)
    for k in range(n):
        alone = situation(path, ego[:, k : k + 1], [other[:, k : k + 1] for other in others], distance=at[k])
        assert repr(told(SharedView(alone, network), 0)) == repr(told(together, k))


class Watching(cc.SystemUnderTest):
    """Writes down what it sees."""

    seen: list[Any] = []  # noqa: RUF012

    def step(self, view, dt):
        if view.time < 2 * dt:
            self.seen.append((view, view.lanes, view.speed_limit, [(o.name, o.lane, o.gap) for o in view.objects]))
        return 0.0


@pytest.mark.parametrize("moved", ["lane", "trajectory"])
def test_in_a_run_the_road_is_that_of_the_scenario(tmp_path, moved):
    follow = trajectory(
        "<Polyline>"
        + "".join(f'<Vertex><Position><WorldPosition x="{x}" y="-2" h="0"/></Position></Vertex>' for x in (50.0, 300.0))
        + "</Polyline>"
    )
    init = private("Ego", teleport("50"), speed_action("10"), *((follow,) if moved == "trajectory" else ()))
    init += private("Other", teleport("90", "1"))
    scenario = scenario_file(tmp_path, init=init, entities=car("Ego") + car("Other"))
    Watching.seen.clear()
    cc.simulate(scenario, drivers={"Ego": Watching()}, duration=0.2)
    view, lanes, limit, others = Watching.seen[0]
    assert [(lane.number, lane.same_direction) for lane in lanes] == [(1, False), (0, True)]
    assert [lane.offset for lane in lanes] == pytest.approx([4.0, 0.0], abs=1e-6)
    assert math.isnan(limit)
    # The other one drives towards the ego, so that its reference point is behind its centre; both are 4 m long.
    assert others == [("Other", 1, pytest.approx(90.0 - 1.4 - 2.0 - (view.ego.x + 1.4 + 2.0), abs=1e-6))]


class Timing(cc.SystemUnderTest):
    times: ClassVar[list[float]] = []

    def step(self, view, dt):
        self.times.append(view.time)
        return 0.0


def test_times_are_multiples_of_the_time_step_without_rounding_errors(tmp_path):
    scenario = scenario_file(tmp_path, init=private("Ego", teleport("50"), speed_action("10")), entities=car("Ego"))
    Timing.times.clear()
    cc.simulate(scenario, drivers={"Ego": Timing()}, duration=0.4)
    assert Timing.times == [0.0, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.35]


class Ahead(cc.SystemUnderTest):
    """Notes how its path bends, and where it is far ahead."""

    seen: ClassVar[list[tuple[float, float]]] = []

    def step(self, view, dt):
        self.seen.append((view.path(120.0).curvature, view.path(600.0).x))
        return 0.0


@pytest.mark.filterwarnings("ignore::cornercase.NoticeWarning")
def test_a_trajectory_is_the_same_ahead_however_short_the_run_is(tmp_path):
    shape = f'<Clothoid curvature="0" curvaturePrime="0.0001" length="500">{place(0, 100)}</Clothoid>'
    init = private("Ego", teleport("50"), speed_action("10"), trajectory(shape))
    scenario = scenario_file(tmp_path, init=init, entities=car("Ego"))
    seen = []
    for duration in (0.2, 20.0):
        Ahead.seen.clear()
        cc.simulate(scenario, drivers={"Ego": Ahead()}, duration=duration)
        seen.append(Ahead.seen[:4])
    assert seen[0] == seen[1]
    assert [bend for bend, _ in seen[0]] == pytest.approx([0.0001 * (120.0 + 0.5 * k) for k in range(4)], rel=1e-3)
