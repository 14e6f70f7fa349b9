from __future__ import annotations

import numpy as np
import pytest

from conftest import (
    car,
    event,
    ran,
    same_recording,
    scenario_file,
    speed_action,
    story_of,
    teleport,
    time_trigger,
)  # fmt: skip
from cornercase._common.errors import InputError, SimulationError
from cornercase.recordings import Recording
from cornercase.scenario import ConcreteScenario
from cornercase.scenario._concrete_file import write_concrete_file
from cornercase.scenario._file import ScenarioFile
from cornercase.simulators import Builtin

PRIVATE = '<Private entityRef="Ego">{}</Private>'
DOUBLE = '<ParameterDeclaration name="{}" parameterType="double" value="{}"/>'


def run(path, values=None, **options) -> Recording:
    (result,) = Builtin(**{"duration": 10.0, **options}).run([ConcreteScenario(path, values or {})])
    assert isinstance(result, Recording), result
    return result


def test_constant_speed_along_a_lane(tmp_path):
    path = scenario_file(tmp_path, init=PRIVATE.format(teleport("20") + speed_action("10")), stop=time_trigger("3"))
    recording = run(path)
    assert recording.time[-1] == pytest.approx(3.0)
    np.testing.assert_allclose(recording.x[0], 20 + 10 * recording.time, atol=1e-9)
    np.testing.assert_allclose(recording.y[0], -2.0, atol=1e-9)


def test_left_lane_runs_against_the_road(tmp_path):
    path = scenario_file(
        tmp_path, init=PRIVATE.format(teleport("200", "1") + speed_action("10")), stop=time_trigger("3")
    )
    recording = run(path)
    np.testing.assert_allclose(recording.x[0], 200 - 10 * recording.time, atol=1e-9)
    np.testing.assert_allclose(np.cos(recording.heading[0]), -1.0)


@pytest.mark.parametrize(("rule", "first"), [("greaterOrEqual", 2.05), ("greaterThan", 2.10)])
def test_a_condition_on_time_takes_effect_one_frame_later(tmp_path, rule, first):
    story = story_of(event("e", speed_action("20"), time_trigger("2", rule)))
    path = scenario_file(
        tmp_path, init=PRIVATE.format(teleport("0") + speed_action("5")), story=story, stop=time_trigger("3")
    )
    recording = run(path)
    assert recording.time[recording.speed[0] > 5][0] == pytest.approx(first)


def test_rising_edge_of_what_holds_from_the_start_never_fires(tmp_path):
    story = story_of(event("e", speed_action("20"), time_trigger("0", edge="rising")))
    path = scenario_file(
        tmp_path, init=PRIVATE.format(teleport("0") + speed_action("5")), story=story, stop=time_trigger("3")
    )
    assert (run(path).speed[0] == 5).all()


def test_a_delay_shifts_a_condition(tmp_path):
    story = story_of(event("e", speed_action("20"), time_trigger("1", edge="rising", delay="0.5")))
    path = scenario_file(
        tmp_path, init=PRIVATE.format(teleport("0") + speed_action("5")), story=story, stop=time_trigger("3")
    )
    recording = run(path)
    assert recording.time[recording.speed[0] > 5][0] == pytest.approx(1.55)


@pytest.mark.parametrize("shape", ["linear", "cubic", "sinusoidal"])
def test_speed_shapes_take_their_time_and_the_distance_of_their_mean(tmp_path, shape):
    story = story_of(event("e", speed_action("20", shape, "time", "4"), time_trigger("1")))
    path = scenario_file(
        tmp_path, init=PRIVATE.format(teleport("0") + speed_action("10")), story=story, stop=time_trigger("6")
    )
    recording = run(path)
    speed = dict(zip(np.round(recording.time, 6), recording.speed[0], strict=True))
    assert speed[1.0] == 10
    assert speed[3.0] == pytest.approx(15, abs=0.2)
    assert speed[5.0] == pytest.approx(20)
    moved = recording.x[0][np.isclose(recording.time, 5.0)] - recording.x[0][np.isclose(recording.time, 1.0)]
    assert moved == pytest.approx(60, abs=0.4)


def test_end_of_one_event_starts_the_next(tmp_path):
    after = """<ConditionGroup><Condition name="c" delay="0" conditionEdge="none"><ByValueCondition>
<StoryboardElementStateCondition storyboardElementType="event" storyboardElementRef="first" state="completeState"/>
</ByValueCondition></Condition></ConditionGroup>"""
    story = story_of(
        event("first", speed_action("10", "linear", "time", "2"), time_trigger("1"))
        + event("second", speed_action("30"), after)
    )
    path = scenario_file(
        tmp_path, init=PRIVATE.format(teleport("0") + speed_action("0")), story=story, stop=time_trigger("6")
    )
    recording = run(path)
    assert recording.time[recording.speed[0] == 30][0] == pytest.approx(3.1, abs=0.051)


def test_synchronised_entity_arrives_with_its_master(tmp_path):
    synchronise = """<PrivateAction><SynchronizeAction masterEntityRef="Ego"><TargetPositionMaster>
<LanePosition roadId="1" laneId="-1" s="100"/></TargetPositionMaster><TargetPosition>
<LanePosition roadId="1" laneId="1" s="300"/></TargetPosition></SynchronizeAction></PrivateAction>"""
    init = PRIVATE.format(teleport("0") + speed_action("10"))
    init += f'<Private entityRef="Other">{teleport("400", "1")}{speed_action("5")}</Private>'
    story = story_of(event("e", synchronise, time_trigger("1")), "Other")
    path = scenario_file(tmp_path, init=init, story=story, stop=time_trigger("12"), entities=car("Ego") + car("Other"))
    recording = run(path, duration=12.0)
    master = recording.time[recording.x[0] >= 100 - 1e-6][0]
    other = recording.time[recording.x[1] <= 300 + 1e-6][0]
    assert other == pytest.approx(master, abs=0.06)


def test_collision_is_recorded_and_stops_only_on_request(tmp_path):
    init = PRIVATE.format(teleport("0") + speed_action("10")) + f'<Private entityRef="Other">{teleport("50")}</Private>'
    path = scenario_file(tmp_path, init=init, stop=time_trigger("8"), entities=car("Ego") + car("Other"))
    through, stopped = run(path), run(path, on_collision="stop")
    # The front of one, at 3.4 m, meets the rear of the other, at 50 - 0.6 m.
    assert through.collisions[0].time == pytest.approx(4.6)
    assert through.time[-1] == pytest.approx(8.0)
    assert stopped.time[-1] == pytest.approx(4.6)
    assert stopped.collisions == through.collisions


def test_expressions_set_speeds(tmp_path):
    parameters = DOUBLE.format("kph", "36") + DOUBLE.format("speed", "${$kph/3.6}")
    path = scenario_file(
        tmp_path,
        init=PRIVATE.format(teleport("0") + speed_action("$speed")),
        stop=time_trigger("1"),
        parameters=parameters,
    )
    assert run(path).speed[0, -1] == pytest.approx(10)
    assert run(path, {"kph": 72.0}).speed[0, -1] == pytest.approx(20)


def test_parameters_that_shape_the_storyboard_split_the_batch(tmp_path):
    parameters = '<ParameterDeclaration name="lane" parameterType="integer" value="-1"/>' + DOUBLE.format("v", "5")
    init = PRIVATE.format(teleport("250", "$lane") + speed_action("$v"))
    path = scenario_file(tmp_path, init=init, stop=time_trigger("2"), parameters=parameters)
    values = [{"lane": lane, "v": v} for v in (5.0, 8.0) for lane in (-1.0, 1.0)]
    results = ran(Builtin(), [ConcreteScenario(path, one) for one in values])
    assert [round(float(r.x[0, -1]), 6) for r in results] == [260.0, 240.0, 266.0, 234.0]


def test_one_failure_leaves_the_others_alone(tmp_path):
    path = scenario_file(
        tmp_path,
        init=PRIVATE.format(teleport("$s")),
        stop=time_trigger("1"),
        parameters=DOUBLE.format("s", "10"),
    )
    good, bad, again = Builtin().run([ConcreteScenario(path, {"s": s}) for s in (10.0, 900.0, 10.0)])
    assert isinstance(bad, SimulationError)
    assert "off the map" in str(bad)
    assert same_recording(good, again)


def test_a_scenario_alone_is_bit_for_bit_the_same_within_a_batch(x_intersection, builtin):
    rng = np.random.default_rng(5)
    concretes = [x_intersection.concrete_scenario(v) for v in x_intersection.space.values(rng.random((40, 3)))]
    together = list(builtin.run(concretes))
    for i in (0, 7, 39):
        (alone,) = builtin.run([concretes[i]])
        assert same_recording(alone, together[i])


def test_a_written_concrete_scenario_runs_by_itself(x_intersection, builtin, tmp_path):
    values = x_intersection.space.values(np.array([[0.3, 0.6, 0.2]]))[0]
    (original,) = builtin.run([x_intersection.concrete_scenario(values)])
    target = tmp_path / "kept" / "one.xosc"
    write_concrete_file(ScenarioFile.read(x_intersection.path), values, target, drivers={"Ego": "normal"})
    (again,) = builtin.run([ConcreteScenario(target)])
    assert same_recording(original, again)


BAD = {
    "no road": (lambda t: t.replace('filepath="road.xodr"', 'filepath="absent.xodr"'), "absent.xodr"),
    "unknown action": (lambda t: t.replace("TeleportAction", "FlyAction"), "FlyAction"),
    "unknown road": (lambda t: t.replace('roadId="1"', 'roadId="9"'), "no road '9'"),
    "unknown entity": (lambda t: t.replace('entityRef="Ego"', 'entityRef="Egg"'), "did you mean 'Ego'"),
    "not a number": (lambda t: t.replace('s="20"', 's="far"'), "not a number"),
    "network path": (lambda t: t.replace("road.xodr", "http://a/road.xodr"), "network address"),
    "unknown parameter": (lambda t: t.replace('s="20"', 's="$where"'), "no parameter 'where'"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_files_are_refused_in_one_sentence(tmp_path, name):
    change, words = BAD[name]
    path = scenario_file(tmp_path, init=PRIVATE.format(teleport("20")), stop=time_trigger("1"))
    path.write_text(change(path.read_text()))
    with pytest.raises(InputError, match=words) as caught:
        list(Builtin().run([ConcreteScenario(path)]))
    assert "\n" not in str(caught.value)
    assert "scenario.xosc" in str(caught.value) or "road.xodr" in str(caught.value) or "absent" in str(caught.value)
