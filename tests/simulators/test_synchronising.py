"""Actions between two entities, compared with closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from conftest import (
    car,
    event,
    moving,
    place,
    private,
    ran,
    scenario_file,
    speed_action,
    story_of,
    time_trigger,
    trajectory,
)
from cornercase.scenario import ConcreteScenario
from cornercase.simulators import Builtin
from cornercase.simulators.builtin.actions._synchronize import SynchronizeAction

PARAMETERS = "".join(
    f'<ParameterDeclaration name="{name}" parameterType="double" value="{value}"/>'
    for name, value in (("speed", 10), ("final", 8), ("gap", 10))
)
LINE = f"""<Polyline><Vertex>{place(400, 5)}</Vertex><Vertex>{place(260, -1)}</Vertex><Vertex>{place(150, -1)}</Vertex>
</Polyline>"""
BEND = """<ClothoidSpline><ClothoidSplineSegment curvatureStart="0" curvatureEnd="0" length="60"><PositionStart>
<WorldPosition x="320" y="1" h="3.1"/></PositionStart></ClothoidSplineSegment><ClothoidSplineSegment curvatureStart="0" curvatureEnd="0.01"
length="70"/></ClothoidSpline>"""
TRACKS = {
    "lane": moving("400", "$speed", lane="1"),
    "line": private("Ego", trajectory(LINE), speed_action("$speed")),
    "spline": private("Ego", trajectory(BEND), speed_action("$speed")),
}
STEADY = '<TargetDistanceSteadyState distance="30"/>'
FINAL = {
    "none": "",
    "speed": '<FinalSpeed><AbsoluteSpeed value="$final"/></FinalSpeed>',
    "steady way": f'<FinalSpeed><AbsoluteSpeed value="$final">{STEADY}</AbsoluteSpeed></FinalSpeed>',
    "steady time": '<FinalSpeed><AbsoluteSpeed value="$final"><TargetTimeSteadyState time="3"/></AbsoluteSpeed></FinalSpeed>',
    "difference": '<FinalSpeed><RelativeSpeedToMaster value="-4" speedTargetValueType="delta"/></FinalSpeed>',
    "factor": f'<FinalSpeed><RelativeSpeedToMaster value="0.5" speedTargetValueType="factor">{STEADY}</RelativeSpeedToMaster></FinalSpeed>',
}  # fmt: skip


def synchronise(final):
    return f"""<PrivateAction><SynchronizeAction masterEntityRef="Lead" targetTolerance="0.5"><TargetPositionMaster><LanePosition
roadId="1" laneId="-1" s="300"/></TargetPositionMaster><TargetPosition><LanePosition roadId="1" laneId="1" s="250"/></TargetPosition>
{final}</SynchronizeAction></PrivateAction>"""


def recordings(path, values, duration=15.0):
    return ran(Builtin(duration=duration), [ConcreteScenario(path, one) for one in values])


@pytest.mark.parametrize(("final", "speed"), [("none", None), ("speed", 8.0), ("difference", 16.0), ("factor", 10.0)])
@pytest.mark.parametrize("track", TRACKS)
def test_who_is_synchronised_arrives_with_the_master(tmp_path, track, final, speed):
    # The master needs 10 s for 200 m.
    story, init = story_of(event("e", synchronise(FINAL[final]), time_trigger("0"))), TRACKS[track]
    init += moving("100", "20", "Lead")
    path = scenario_file(tmp_path, init=init, story=story, entities=car("Ego") + car("Lead"), parameters=PARAMETERS)
    (recording,) = recordings(path, [{"speed": 10.0, "final": 8.0}])
    arrival = int(np.argmin(np.abs(recording.x[1] - 300.0)))
    assert recording.time[arrival] == pytest.approx(10.0, abs=0.06)
    assert recording.x[0][arrival] == pytest.approx(250.0, abs=2.0)
    if speed is None:
        # With one acceleration, it has its mean speed after half the time.
        assert recording.speed[0][100] == pytest.approx((recording.x[0][0] - 250.0) / 10.0, abs=0.1)
    else:
        assert recording.speed[0][arrival] == pytest.approx(speed, abs=0.6)


def test_who_waits_for_a_standing_master_starts_with_it(tmp_path):
    master = event("go", speed_action("20", "linear", "rate", "10"), time_trigger("2"))
    story = story_of(event("e", synchronise(FINAL["none"]), time_trigger("0")))
    story += story_of(master, "Lead").replace('"s"', '"t"', 1)
    init, entities = TRACKS["lane"] + moving("100", "0", "Lead"), car("Ego") + car("Lead")
    path = scenario_file(tmp_path, init=init, story=story, entities=entities, parameters=PARAMETERS)
    (recording,) = recordings(path, [{"speed": 10.0, "final": 8.0}])
    assert (recording.speed[0][3:40] == 0.0).all()
    assert recording.speed[0][60] > 0.0
    arrival = int(np.argmin(np.abs(recording.x[1] - 300.0)))
    assert recording.x[0][arrival] == pytest.approx(250.0, abs=1.6)


@pytest.mark.parametrize("track", ["line", "spline"])
def test_who_is_beside_the_lanes_is_looked_up_and_acts_compiled(tmp_path, monkeypatch, track):
    calls = {"look_up_positions": 0, "step": 0}

    def counted(name, plain):
        def called(*given):
            calls[name] += 1
            return plain(*given)

        return called

    for name in calls:
        monkeypatch.setattr(SynchronizeAction, name, counted(name, getattr(SynchronizeAction, name)))
    story, init = story_of(event("e", synchronise(FINAL["speed"]), time_trigger("0.5"))), TRACKS[track]
    init += moving("100", "12", "Lead")
    path = scenario_file(tmp_path, init=init, story=story, entities=car("Ego") + car("Lead"), parameters=PARAMETERS)
    recordings(path, [{"speed": 11.3, "final": 9.7}])
    # Only the frame in which it ends would need the storyboard.
    assert calls["look_up_positions"] > 0
    assert calls["step"] <= 1


@pytest.mark.parametrize(
    ("asked", "gap"),
    [
        ('distance="$gap"', 25.0),
        pytest.param('distance="$gap" freespace="true"', 29.0, marks=pytest.mark.slow),
        ('timeGap="1.2"', 18.0),
    ],
)
@pytest.mark.parametrize("limits", ['maxSpeed="30"', 'maxAcceleration="3" maxDeceleration="5" maxAccelerationRate="4"'])
@pytest.mark.parametrize("system", ["entity", "road"])
def test_who_keeps_a_distance_gets_to_it(tmp_path, asked, gap, limits, system):
    action = f"""<PrivateAction><LongitudinalAction><LongitudinalDistanceAction entityRef="Lead" continuous="true" {asked}
coordinateSystem="{system}" displacement="any"><DynamicConstraints {limits}/></LongitudinalDistanceAction></LongitudinalAction>
</PrivateAction>"""
    story = story_of(event("e", action, time_trigger("1")))
    init, entities = moving("60", "$speed") + moving("100", "15", "Lead"), car("Ego") + car("Lead")
    path = scenario_file(tmp_path, init=init, story=story, entities=entities, parameters=PARAMETERS)
    for recording in recordings(path, [{"speed": speed, "gap": 25.0} for speed in (5.0, 15.0, 24.0)], 25.0):
        # Boxes are 4 m long.
        assert recording.x[1][-1] - recording.x[0][-1] == pytest.approx(gap, abs=0.1)
        assert recording.speed[0][-1] == pytest.approx(15.0, abs=0.1)
