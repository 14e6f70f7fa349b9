"""Traffic signals and their controllers in the builtin simulator."""

from __future__ import annotations

import pytest

from conftest import (
    event,
    moving,
    ran,
    run,
    same_recording,
    scenario_file,
    speed_action,
    story_of,
    time_trigger,
)  # fmt: skip
from cornercase._common.errors import InputError
from cornercase.scenario import ConcreteScenario
from cornercase.simulators import Builtin
from cornercase.simulators.builtin._stepper import Stepper
from cornercase.simulators.builtin.storyboard._storyboard import Storyboard

DT = 0.05


def test_a_traffic_signal_is_what_it_was_switched_to(tmp_path):
    switch = """<GlobalAction><InfrastructureAction><TrafficSignalAction><TrafficSignalStateAction name="7" state="{}"/>
</TrafficSignalAction></InfrastructureAction></GlobalAction>"""
    green = """<ConditionGroup><Condition name="c" delay="0" conditionEdge="none"><ByValueCondition>
<TrafficSignalCondition name="7" state="green"/></ByValueCondition></Condition></ConditionGroup>"""
    story = story_of(
        event("red", switch.format("red"), time_trigger("1"))
        + event("green", switch.format("green"), time_trigger("2"))
        + event("go", speed_action("25"), green)
    )
    recording = run(scenario_file(tmp_path, init=moving(), story=story, stop=time_trigger("4")))
    fast = recording.time[recording.speed[0] > 20]
    assert fast[0] == pytest.approx(2.0 + 2 * DT, abs=1.5 * DT)


@pytest.mark.parametrize("second", ["", '<Phase name="none" duration="0"/>'])
def test_a_controller_with_one_phase_sets_its_signals_again_in_each_cycle(tmp_path, second):
    switch = """<GlobalAction><InfrastructureAction><TrafficSignalAction><TrafficSignalStateAction name="7" state="green"/>
</TrafficSignalAction></InfrastructureAction></GlobalAction>"""
    red = """<ConditionGroup><Condition name="c" delay="0" conditionEdge="rising"><ByValueCondition>
<TrafficSignalCondition name="7" state="red"/></ByValueCondition></Condition></ConditionGroup>"""
    story = story_of(event("green", switch, time_trigger("1.5")) + event("go", speed_action("25"), red))
    path = scenario_file(tmp_path, init=moving(), story=story, stop=time_trigger("4"))
    signals = f"""<TrafficSignals><TrafficSignalController name="main"><Phase name="red" duration="1">
<TrafficSignalState trafficSignalId="7" state="red"/></Phase>{second}</TrafficSignalController></TrafficSignals>"""
    path.write_text(path.read_text().replace("</RoadNetwork>", f"{signals}</RoadNetwork>", 1))
    recording = run(path)
    fast = recording.time[recording.speed[0] > 20]
    assert fast[0] == pytest.approx(2.0 + DT, abs=1.5 * DT)


SIGNALS = """<TrafficSignals><TrafficSignalController name="main">
<Phase name="red" duration="$red"><TrafficSignalState trafficSignalId="7" state="red"/></Phase>
<Phase name="green" duration="1"><TrafficSignalState trafficSignalId="7" state="green"/></Phase></TrafficSignalController>
<TrafficSignalController name="side" delay="0.5" reference="main">
<Phase name="red" duration="$red"><TrafficSignalState trafficSignalId="8" state="red"/></Phase>
<Phase name="green" duration="1"><TrafficSignalState trafficSignalId="8" state="green"/></Phase></TrafficSignalController>
</TrafficSignals></RoadNetwork>"""


def by_value(condition):
    return f"""<ConditionGroup><Condition name="c" delay="0" conditionEdge="rising"><ByValueCondition>{condition}
</ByValueCondition></Condition></ConditionGroup>"""


@pytest.mark.parametrize(
    ("condition", "at"),
    [
        ('<TrafficSignalCondition name="7" state="green"/>', {2.0: 2.0, 3.0: 3.0}),
        ('<TrafficSignalCondition name="8" state="green"/>', {2.0: 2.5, 3.0: 3.5}),
        ('<TrafficSignalControllerCondition trafficSignalControllerRef="main" phase="green"/>', {2.0: 2.0, 3.0: 3.0}),
    ],
)
@pytest.mark.parametrize("begun", [None, 0.7])
def test_signals_go_through_the_phases_of_their_controllers(tmp_path, condition, at, begun):
    # An action that begins the red phase at 0.7 s lets green come so much later, but only of its own controller.
    restart = """<GlobalAction><InfrastructureAction><TrafficSignalAction><TrafficSignalControllerAction phase="red"
trafficSignalControllerRef="main"/></TrafficSignalAction></InfrastructureAction></GlobalAction>"""
    events = event("go", speed_action("25"), by_value(condition))
    events += "" if begun is None else event("restart", restart, time_trigger(str(begun)))
    red = '<ParameterDeclaration name="red" parameterType="double" value="2"/>'
    path = scenario_file(tmp_path, init=moving(), story=story_of(events), parameters=red)
    text = path.read_text()
    path.write_text(text.replace("</RoadNetwork>", SIGNALS, 1))
    concretes = [ConcreteScenario(path, {"red": value}) for value in at]
    together = ran(Builtin(time_step=DT, duration=6.0), concretes)
    later = begun if begun is not None and '"8"' not in condition else 0.0
    for recording, expected in zip(together, at.values(), strict=True):
        fast = recording.time[recording.speed[0] > 20]
        assert fast[0] == pytest.approx(expected + later + DT, abs=1.5 * DT)


def test_a_file_with_controllers_is_evaluated_only_when_something_changes(tmp_path, monkeypatch):
    evaluations = []
    evaluate = Storyboard.evaluate_triggers

    def count(self, dt: float) -> None:
        evaluations.append(dt)
        evaluate(self, dt)

    monkeypatch.setattr(Storyboard, "evaluate_triggers", count)
    green = by_value('<TrafficSignalCondition name="8" state="green"/>').replace('delay="0"', 'delay="0.32"')
    path = scenario_file(tmp_path, init=moving(), story=story_of(event("go", speed_action("25"), green)))
    path.write_text(path.read_text().replace("</RoadNetwork>", SIGNALS.replace("$red", "2"), 1))
    (few,) = ran(Builtin(time_step=DT, duration=6.0), [ConcreteScenario(path)])
    assert few.time[few.speed[0] > 20][0] == pytest.approx(2.82 + DT, abs=1.5 * DT)
    assert len(evaluations) < 30
    initialize = Stepper.__init__

    def evaluate_each_frame(self, *arguments) -> None:
        initialize(self, *arguments)
        self._python_step = True

    monkeypatch.setattr(Stepper, "__init__", evaluate_each_frame)
    (all_frames,) = ran(Builtin(time_step=DT, duration=6.0), [ConcreteScenario(path)])
    assert same_recording(few, all_frames)
    assert len(evaluations) > 120


@pytest.mark.parametrize(
    ("condition", "why"),
    [
        ('<TrafficSignalControllerCondition trafficSignalControllerRef="mian" phase="red"/>', "did you mean 'main'"),
        ('<TrafficSignalControllerCondition trafficSignalControllerRef="main" phase="blue"/>', "has no phase 'blue'"),
    ],
)
def test_a_controller_or_phase_that_is_not_there_is_refused(tmp_path, condition, why):
    story = story_of(event("go", speed_action("25"), by_value(condition)))
    path = scenario_file(tmp_path, init=moving(), story=story)
    path.write_text(path.read_text().replace("</RoadNetwork>", SIGNALS.replace("$red", "2"), 1))
    with pytest.raises(InputError, match=why):
        run(path)


def test_a_phase_that_cannot_be_costs_no_other_scenario(tmp_path):
    path = scenario_file(
        tmp_path, init=moving(), parameters='<ParameterDeclaration name="red" parameterType="double" value="1"/>'
    )
    path.write_text(path.read_text().replace("</RoadNetwork>", SIGNALS.replace('duration="1"', 'duration="${$red/2}"')))
    concretes = [ConcreteScenario(path, {"red": red}) for red in (1.0, -1.0, 0.0)]
    ran_, below, none = Builtin(duration=1.0).run(concretes)
    assert not isinstance(ran_, Exception)
    assert "duration of <Phase> is below 0" in str(below)
    assert "duration of <Phase> is 0, as are those of the other phases" in str(none)


def test_a_controller_may_refer_to_one_that_comes_later(tmp_path):
    controllers = [
        f"""<TrafficSignalController name="{name}" delay="{delay}" reference="{reference}"><Phase name="red" duration="2">
<TrafficSignalState trafficSignalId="{name}" state="red"/></Phase><Phase name="green" duration="1"><TrafficSignalState
trafficSignalId="{name}" state="green"/></Phase></TrafficSignalController>"""
        for name, delay, reference in (("a", 0.3, "b"), ("b", 0.5, "c"), ("c", 0.4, ""))
    ]
    story = story_of(event("go", speed_action("25"), by_value('<TrafficSignalCondition name="a" state="green"/>')))
    path = scenario_file(tmp_path, init=moving(), story=story)
    text = path.read_text()
    recordings = []
    for ordered in (controllers, controllers[::-1]):
        signals = f"<TrafficSignals>{''.join(ordered)}</TrafficSignals></RoadNetwork>"
        path.write_text(text.replace("</RoadNetwork>", signals, 1))
        recordings.append(run(path, 5.0))
    fast = recordings[0].time[recordings[0].speed[0] > 20]
    # Green begins 2 s after the delays, and 3 s, a cycle, before that.
    assert fast[0] == pytest.approx(2.0 + 0.3 + 0.5 + 0.4 - 3.0 + DT, abs=1.5 * DT)
    assert same_recording(*recordings)


def test_controllers_that_refer_to_each_other_are_refused(tmp_path):
    path = scenario_file(tmp_path, init=moving())
    controllers = SIGNALS.replace("$red", "2").replace('name="main"', 'name="main" reference="side"')
    path.write_text(path.read_text().replace("</RoadNetwork>", controllers, 1))
    with pytest.raises(InputError, match=r"line \d+: .* refer to each other \(main, side\); remove one reference"):
        run(path)
