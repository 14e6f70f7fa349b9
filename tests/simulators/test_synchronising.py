"""Compiled actions between two entities, compared with their NumPy versions."""

from __future__ import annotations

import numpy as np
import pytest

from conftest import (
    at_night,
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
from cornercase.simulators.builtin._stepper import Stepper
from cornercase.simulators.builtin.actions._longitudinal import LongitudinalDistanceAction
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


def recordings(path, values, monkeypatch=None):
    simulator = Builtin(duration=15.0)
    if monkeypatch is None:
        return ran(simulator, [ConcreteScenario(path, one) for one in values])
    run = Stepper.run

    def by_hand(stepper, *how):
        stepper._python_step = True
        run(stepper, *how)

    with monkeypatch.context() as patched:
        patched.setattr(Stepper, "run", by_hand)
        return ran(simulator, [ConcreteScenario(path, one) for one in values])


def check(path, values, monkeypatch, action):
    steps = []
    step = action.step

    def counted(self, world, dt, where):
        steps.append(int(where.sum()))
        return step(self, world, dt, where)

    with monkeypatch.context() as patched:
        patched.setattr(action, "step", counted)
        together = recordings(path, values)
        few = sum(steps)
        itself = recordings(path, values, monkeypatch)
    # In most frames the storyboard is not evaluated.
    assert 0 < few < 0.2 * (sum(steps) - few)
    for one, other in zip(together, itself, strict=True):
        for name in ("x", "y", "heading", "speed", "acceleration"):
            np.testing.assert_allclose(getattr(one, name), getattr(other, name), rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("final", at_night(FINAL, {"none", "steady time", "difference", "factor"}))
@pytest.mark.parametrize("track", TRACKS)
def test_who_is_synchronised_moves_as_the_storyboard_says(tmp_path, monkeypatch, track, final):
    # The master starts late, slows down and stops for a while.
    master = "".join(
        event(name, speed_action(speed, "linear", "rate", "4"), time_trigger(at), "overwrite")
        for name, speed, at in (("go", "22", "0.5"), ("slow", "0", "6"), ("on", "18", "9"))
    )
    story = story_of(event("e", synchronise(FINAL[final]), time_trigger("0")))
    story += story_of(master, "Lead").replace('"s"', '"t"', 1)
    init = TRACKS[track] + moving("100", "5", "Lead")
    entities = car("Ego") + car("Lead")
    path = scenario_file(tmp_path, init=init, story=story, entities=entities, parameters=PARAMETERS)
    values = [{"speed": speed, "final": last} for speed in (0.0, 4.0, 11.3, 25.0) for last in (3.0, 9.7, 16.0)]
    check(path, values, monkeypatch, SynchronizeAction)


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


@pytest.mark.parametrize("asked", ['distance="$gap"', 'distance="$gap" freespace="true"', 'timeGap="1.2"'])
@pytest.mark.parametrize("limits", ['maxSpeed="30"', 'maxAcceleration="3" maxDeceleration="5" maxAccelerationRate="4"'])
def test_who_keeps_a_distance_moves_as_the_storyboard_says(tmp_path, monkeypatch, asked, limits):
    action = f"""<PrivateAction><LongitudinalAction><LongitudinalDistanceAction entityRef="Lead" continuous="true" {asked}
displacement="any"><DynamicConstraints {limits}/></LongitudinalDistanceAction></LongitudinalAction></PrivateAction>"""
    brakes = event("slow", speed_action("3", "linear", "rate", "4"), time_trigger("6"))
    story = story_of(event("e", action, time_trigger("1"))) + story_of(brakes, "Lead").replace('"s"', '"t"', 1)
    init = moving("60", "$speed") + moving("100", "15", "Lead")
    entities = car("Ego") + car("Lead")
    path = scenario_file(tmp_path, init=init, story=story, entities=entities, parameters=PARAMETERS)
    values = [{"speed": speed, "gap": gap} for speed in (5.0, 15.0, 24.0) for gap in (10.0, 35.0)]
    check(path, values, monkeypatch, LongitudinalDistanceAction)
