"""Following trajectories, compared with closed forms."""

from __future__ import annotations

import numpy as np
import pytest

import cornercase as cc
from conftest import car, event, ran, scenario_file, speed_action, story_of, teleport, time_trigger
from cornercase.scenario import ConcreteScenario
from cornercase.simulators import Builtin

DT = 0.05
TIMED = '<Timing domainAbsoluteRelative="relative" scale="1" offset="0"/>'
ABSOLUTE = '<Timing domainAbsoluteRelative="absolute" scale="1" offset="0"/>'


def vertex(x, y=0.0, time=0.0, heading=None):
    h = "" if heading is None else f' h="{heading}"'
    return f'<Vertex time="{time}"><Position><WorldPosition x="{x}" y="{y}"{h}/></Position></Vertex>'


def follow(shape, *, timing="<None/>", mode="position", more=""):
    following = f'<TrajectoryFollowingMode followingMode="{mode}"/>' if mode else ""
    return f"""<PrivateAction><RoutingAction><FollowTrajectoryAction {more}><TrajectoryRef>
<Trajectory name="t" closed="false"><Shape>{shape}</Shape></Trajectory></TrajectoryRef>
<TimeReference>{timing}</TimeReference>{following}</FollowTrajectoryAction></RoutingAction></PrivateAction>"""


def polyline(*vertices):
    return f"<Polyline>{''.join(vertices)}</Polyline>"


def run(folder, action, *, speed="10", duration=8.0, properties="", then=""):
    init = f'<Private entityRef="Ego">{teleport("50")}{speed_action(speed)}</Private>'
    entity = car("Ego").replace("<Properties/>", f"<Properties>{properties}</Properties>")
    story = story_of(event("e", action, time_trigger("0.975")) + then)
    path = scenario_file(folder, init=init, story=story, entities=entity)
    (recording,) = ran(Builtin(time_step=DT, duration=duration), [ConcreteScenario(path)])
    return recording


def at(recording, time):
    k = int(np.argmin(np.abs(recording.time - time)))
    assert recording.time[k] == pytest.approx(time)
    return recording.x[0][k], recording.y[0][k], recording.heading[0][k], recording.speed[0][k]


@pytest.mark.parametrize("mode", ["follow", ""])
def test_with_times_it_goes_on_from_the_present_speed_with_constant_acceleration(tmp_path, mode):
    # From 10 m/s, 15 m in 2 s need a deceleration of 2.5 m/s²; then 10 m in 2 s need a constant speed.
    line = polyline(vertex(60, -2, 0), vertex(75, -2, 2), vertex(85, -2, 4))
    recording = run(tmp_path, follow(line, timing=TIMED, mode=mode))
    for elapsed in (0.5, 1.0, 1.5, 2.0):
        x, _, _, speed = at(recording, 1.0 + elapsed)
        assert x == pytest.approx(60 + 10 * elapsed - 1.25 * elapsed**2)
        assert speed == pytest.approx(10 - 2.5 * (elapsed - DT / 2))
    assert at(recording, 4.0)[0] == pytest.approx(80.0)


def test_who_has_too_much_time_stops_early_and_waits(tmp_path):
    line = polyline(vertex(60, -2, 0), vertex(70, -2, 4), vertex(90, -2, 6))
    recording = run(tmp_path, follow(line, timing=TIMED, mode="follow"))
    # 10 m from 10 m/s to 0 take 2 s.
    assert at(recording, 2.0)[0] == pytest.approx(67.5)
    assert at(recording, 4.0)[0] == pytest.approx(70.0)
    assert at(recording, 7.0)[0] == pytest.approx(90.0)


def test_times_begin_with_that_of_the_first_vertex(tmp_path):
    line = polyline(vertex(60, -2, 5), vertex(80, -2, 7))
    recording = run(tmp_path, follow(line, timing=TIMED))
    assert at(recording, 2.0)[0] == pytest.approx(70.0)
    absolute = run(tmp_path, follow(line, timing=ABSOLUTE), duration=7.0)
    assert at(absolute, 6.0)[0] == pytest.approx(70.0)


def test_who_begins_on_the_last_leg_is_first_seen_with_a_speed_that_falls_towards_its_end(tmp_path):
    action = follow(polyline(vertex(60, -2, 0), vertex(80, -2, 10)), timing=TIMED, more='initialDistanceOffset="5"')
    init = f'<Private entityRef="Ego">{teleport("50")}{speed_action("10")}</Private>'
    path = scenario_file(tmp_path, init=init, story=story_of(event("e", action, time_trigger("0"))))
    (recording,) = ran(Builtin(time_step=DT, duration=1.0), [ConcreteScenario(path)])
    assert recording.speed[0][0] == pytest.approx(2.0 * (1.0 - 5.0 / 20.0))
    np.testing.assert_allclose(recording.speed[0][1:], 2.0)


def test_given_headings_turn_near_corners_or_over_legs(tmp_path):
    line = polyline(vertex(60, -2, 0, 0.0), vertex(80, -2, 0, 0.4), vertex(100, -2, 0, 0.4))
    near = run(tmp_path, follow(line))
    assert at(near, 2.0)[2] == pytest.approx(0.0)
    assert at(near, 2.9)[2] == pytest.approx(0.25 * 0.4)
    assert at(near, 3.1)[2] == pytest.approx(0.75 * 0.4)
    over = run(tmp_path, follow(line, mode="follow"))
    assert at(over, 2.0)[2] == pytest.approx(0.2)
    for value, heading in (("segment", 0.2), ("corner", 0.0), ("off", 0.0)):
        set_ = f'<Property name="plineInterpolation" value="{value}"/>'
        assert at(run(tmp_path, follow(line), properties=set_), 2.0)[2] == pytest.approx(heading)


def test_who_is_turned_against_the_line_drives_backwards_along_it(tmp_path):
    line = polyline(vertex(60, -2, 0, 3.14159), vertex(80, -2, 0, 3.14159), vertex(100, -2, 0, 3.14159))
    recording = run(tmp_path, follow(line), speed="-10")
    assert at(recording, 2.0)[0] == pytest.approx(70.0)
    assert np.cos(at(recording, 2.0)[2]) == pytest.approx(-1.0)
    assert at(recording, 4.0)[0] == pytest.approx(90.0)


def test_back_at_its_start_a_trajectory_ends_there(tmp_path):
    line = polyline(vertex(60, -2), vertex(80, -2))
    back = event("back", speed_action("-10.3"), time_trigger("2"))
    recording = run(tmp_path, follow(line, more='initialDistanceOffset="5"'), speed="10", then=back, duration=6.0)
    turned = int(np.argmax(recording.speed[0] < 0))
    ended = int(np.argmin(recording.x[0][turned:])) + turned
    assert recording.x[0][turned:].min() <= 60.0
    assert 60.0 in np.round(recording.x[0][turned : ended + 1], 9)


@pytest.mark.parametrize(
    ("shape", "timing", "why"),
    [
        (polyline(vertex(60, 0, 0), vertex(80, 5, 2)), TIMED, "a closed <Trajectory> has no time for its return"),
        ('<Clothoid curvature="0" curvaturePrime="0" length="20"/>', "<None/>", "only a <Polyline> can be a closed"),
    ],
)
def test_a_closed_trajectory_that_cannot_be_followed_is_refused(tmp_path, shape, timing, why):
    with pytest.raises(cc.InputError, match=why):
        run(tmp_path, follow(shape, timing=timing).replace('closed="false"', 'closed="true"'))


@pytest.mark.parametrize("drivers", [{}, {"Ego": "simple"}, {"Ego": "simple + kinematic"}])
def test_who_ends_its_trajectory_beyond_the_road_stays_there(tmp_path, drivers):
    # The road ends at 500 m.
    init = f'<Private entityRef="Ego">{teleport("470")}{speed_action("10")}</Private>'
    action = follow(polyline(vertex(480, -2), vertex(530, -2)))
    path = scenario_file(tmp_path, init=init, story=story_of(event("e", action, time_trigger("0.975"))))
    (recording,) = ran(Builtin(time_step=DT, duration=8.0, drivers=drivers), [ConcreteScenario(path)])
    assert recording.x[0][-1] == pytest.approx(530.0, abs=0.6)
    assert (np.diff(recording.x[0]) > -1e-9).all()
