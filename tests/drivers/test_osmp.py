"""An FMU that speaks ASAM OSI by way of OSMP, and holds its environment to the rules of the standard."""

from __future__ import annotations

import struct
import sys
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest

import cornercase as cc
from conftest import EXAMPLES
from cornercase.drivers import SENSORS, VEHICLES, EquippedDriver, FmuDriver
from cornercase.drivers.fmu._instance import Fmu, FmuError
from cornercase.drivers.fmu._model import read_fmu
from cornercase.drivers.fmu._osmp_buffers import pass_message
from cornercase.study import StudyFile
from helpers.command_line import cornercase
from helpers.fmus import make_osmp_fmu, message_variables, step_instance

osi = pytest.importorskip("osi3")

DECELERATION = EXAMPLES / "r157" / "deceleration.xosc"
pytestmark = pytest.mark.filterwarnings("ignore::cornercase.NoticeWarning")
STATE, ACCELERATION, TRAJECTORY = 10, 11, 12
VIEW, INIT = ("Integer", (0, 1, 2)), ("Integer", (3, 4, 5))


class Aeb(cc.SystemUnderTest):
    """As ``tests/data/fmu/osmp.c``."""

    def __init__(self, reaction: float = 0.1):
        self.reaction, self.since, self.braking = reaction, 0.0, False

    def step(self, view, dt):
        leader = view.leader
        is_short = leader is not None and leader.closing > 0.0 and leader.gap / leader.closing < 2.0
        self.since = self.since + dt if is_short else 0.0
        self.braking = self.braking or self.since > self.reaction
        return -8.0 if self.braking else 0.0


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("osmp")
    make_osmp_fmu(folder / "update.fmu")
    make_osmp_fmu(folder / "no_init.fmu", "OSMPTrafficUpdateOut[1]", init=False)
    make_osmp_fmu(folder / "request.fmu", "OSMPMotionRequestOut")
    return folder


def drive(driver, duration: float = 6.0, **options):
    return cc.simulate(
        DECELERATION, {"gap": 30, "deceleration": 6}, drivers={"Ego": driver}, duration=duration, **options
    )


def ego(recording, quantity: str):
    return getattr(recording, quantity)[recording.entity_index("Ego")]


def read_record(path: Path):
    """The messages that the FMU was given, until it was reset."""
    content, messages = path.read_bytes(), list[tuple[str, bytes]]()
    while content and not (messages and content[:1] == b"I"):
        size = struct.unpack_from("<I", content, 1)[0]
        messages.append((content[:1].decode(), content[5 : 5 + size]))
        content = content[5 + size :]
    return messages


@pytest.fixture(scope="module")
def record(folder):
    """What it was given in a run, and the recording."""
    recording = drive(FmuDriver(str(folder / "update.fmu"), record=str(folder / "record.bin")), duration=3.0)
    return read_record(folder / "record.bin"), recording


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("update.fmu", {}),
        ("no_init.fmu", {}),
        ("update.fmu", {"reaction": 0.4}),
        ("request.fmu", {"answer": STATE}),
        ("request.fmu", {"answer": ACCELERATION}),
        ("request.fmu", {"answer": TRAJECTORY}),
    ],
)
def test_it_drives_as_the_same_function_in_python(folder, name, options):
    """All that the FMU checks holds, too, or the run would fail."""
    fmu = drive(FmuDriver(str(folder / name), **options))
    python = drive(Aeb(options.get("reaction", 0.1)))
    assert ego(python, "acceleration").min() == pytest.approx(-8.0)
    for quantity in ("x", "y", "heading", "speed", "acceleration"):
        np.testing.assert_allclose(ego(fmu, quantity), ego(python, quantity), rtol=0.0, atol=1e-9)


def test_a_vehicle_model_follows_it(folder):
    """As it brakes when the same function asks for an acceleration."""
    update, request = (
        drive(EquippedDriver(FmuDriver(str(folder / name), answer=answer), vehicle=VEHICLES.create("single-track")))
        for name, answer in (("update.fmu", 0), ("request.fmu", ACCELERATION))
    )
    assert ego(request, "acceleration").min() < -7.0
    np.testing.assert_allclose(ego(update, "x"), ego(request, "x"), rtol=0.0, atol=0.01)
    np.testing.assert_allclose(ego(update, "speed"), ego(request, "speed"), rtol=0.0, atol=0.01)


def test_osi_python_reads_what_it_is_given(record):
    from osi3.osi_groundtruth_pb2 import GroundTruth
    from osi3.osi_lane_pb2 import Lane
    from osi3.osi_sensorview_pb2 import SensorView

    messages, recording = record
    assert [kind for kind, _ in messages] == ["I", *"S" * (len(recording.time) - 1)]
    roads = GroundTruth.FromString(messages[0][1])
    assert roads.map_reference == "motorway.xodr"
    assert {lane.classification.type for lane in roads.lane} == {Lane.Classification.TYPE_DRIVING}
    ids = [item.id.value for item in (*roads.lane, *roads.lane_boundary)]
    assert len(set(ids)) == len(ids)
    views = [SensorView.FromString(content) for _, content in messages[1:]]
    for k, view in enumerate(views):
        truth = view.global_ground_truth
        assert view.timestamp.seconds + 1e-9 * view.timestamp.nanos == pytest.approx(recording.time[k], abs=1e-9)
        assert view.host_vehicle_id == truth.host_vehicle_id
        assert not truth.lane
        moving = {item.source_reference[0].identifier[0].split(":")[1]: item for item in truth.moving_object}
        assert [*moving] == [*recording.names]
        assert moving["Ego"].id == view.host_vehicle_id
        for name, item in moving.items():
            at = recording.entity_index(name)
            assert item.base.position.x == pytest.approx(recording.x[at, k] + recording.center_x[at], abs=1e-6)
            assert item.base.velocity.x == pytest.approx(recording.speed[at, k], abs=1e-6)
            assert item.base.dimension.length == recording.length[at]
    other = recording.entity_index("Other")
    decelerations = [view.global_ground_truth.moving_object[other].base.acceleration.x for view in views]
    expected = np.diff(recording.speed[other]).min() / (recording.time[1] - recording.time[0])
    assert min(decelerations) == pytest.approx(expected, abs=1e-6)
    assert expected < -5.0


@pytest.mark.parametrize("scenario", ["r157/cut_in", "x_intersection/x_intersection"])
def test_a_trajectory_of_the_storyboard_does_not_move_it_twice(folder, tmp_path, scenario):
    """All are told where the recording has them at that time, although actions have begun the step."""
    from osi3.osi_sensorview_pb2 import SensorView

    path, driver = tmp_path / "record.bin", FmuDriver(str(folder / "update.fmu"), record=str(tmp_path / "record.bin"))
    recording = cc.simulate(EXAMPLES / f"{scenario}.xosc", drivers={"Ego": driver}, duration=1.0)
    moved = np.hypot(np.diff(ego(recording, "x")), np.diff(ego(recording, "y"))) / np.diff(recording.time)
    np.testing.assert_allclose(moved, ego(recording, "speed")[1:], rtol=0.0, atol=1e-6)
    views = [SensorView.FromString(content) for kind, content in read_record(path) if kind == "S"]
    for k, view in enumerate(views):
        for item in view.global_ground_truth.moving_object:
            at = recording.entity_index(item.source_reference[0].identifier[0].split(":")[1])
            # A rule of OSI.
            assert item.HasField("pedestrian_attributes") == (item.type == item.TYPE_PEDESTRIAN)
            heading, ahead = recording.heading[at, k], recording.center_x[at]
            assert item.base.position.x == pytest.approx(recording.x[at, k] + ahead * np.cos(heading), abs=1e-6)
            assert item.base.position.y == pytest.approx(recording.y[at, k] + ahead * np.sin(heading), abs=1e-6)


def test_roads_of_a_junction(tmp_path):
    """Lanes are linked both ways, and each lane lies between its boundaries."""
    from osi3.osi_groundtruth_pb2 import GroundTruth

    from cornercase.recordings._osi_roads import fill_roads
    from cornercase.roads._network import RoadNetwork

    truth = GroundTruth()
    fill_roads(truth, RoadNetwork.read(EXAMPLES / "x_intersection" / "x_intersection.xodr"))
    lanes = {lane.id.value: lane.classification for lane in truth.lane}
    boundaries = {boundary.id.value: boundary.boundary_line for boundary in truth.lane_boundary}
    links = set()
    for number, lane in lanes.items():
        for pairing in lane.lane_pairing:
            if pairing.HasField("antecessor_lane_id"):
                links.add((pairing.antecessor_lane_id.value, number, "before"))
            if pairing.HasField("successor_lane_id"):
                links.add((number, pairing.successor_lane_id.value, "after"))
        for neighbour in lane.left_adjacent_lane_id:
            sides = lanes[neighbour.value]
            assert number in [one.value for one in (*sides.left_adjacent_lane_id, *sides.right_adjacent_lane_id)]
        ahead = np.array([lane.centerline[1].x - lane.centerline[0].x, lane.centerline[1].y - lane.centerline[0].y])
        for side, name in ((1.0, "left"), (-1.0, "right")):
            line = boundaries[getattr(lane, f"{name}_lane_boundary_id")[0].value]
            start = min(
                (
                    [p.position.x - lane.centerline[0].x, p.position.y - lane.centerline[0].y]
                    for p in (line[0], line[-1])
                ),
                key=lambda to: np.hypot(*to),
            )
            assert side * (ahead[0] * start[1] - ahead[1] * start[0]) > 0.0
    assert len(links) > 20
    assert {(a, b) for a, b, way in links if way == "before"} == {(a, b) for a, b, way in links if way == "after"}


def test_false_objects_of_sensors_are_in_the_messages(folder, tmp_path):
    from osi3.osi_sensorview_pb2 import SensorView

    fmu = FmuDriver(str(folder / "update.fmu"), record=str(tmp_path / "record.bin"))
    drive(EquippedDriver(fmu, sensors=[SENSORS.create("radar:false_rate=5,fov=360")]), duration=3.0)
    names = {
        item.source_reference[0].identifier[0]
        for kind, content in read_record(tmp_path / "record.bin")
        if kind == "S"
        for item in SensorView.FromString(content).global_ground_truth.moving_object
    }
    assert any("false object" in name for name in names)


def test_many_scenarios_have_the_same_bytes_with_any_workers_and_after_a_reset(folder, tmp_path):
    for name, more in {"one": [], "two": ["--workers", 2]}.items():
        ended = cornercase(
            "-q", "explore", DECELERATION, "--ego", "Ego", "--other", "Other", "--range", "ego_kmh=60:130", "--range",
            "gap=15:90", "--metric", "ttc", "--optimizer", "sobol", "--budget", 6, "--duration", 4, "--sut",
            f"Ego=fmu:{folder / 'update.fmu'}", *more, "-o", f"{name}.db", cwd=tmp_path,
        )  # fmt: skip
        assert ended.returncode == 0, ended.stderr
    with StudyFile.open(tmp_path / "one.db") as one, StudyFile.open(tmp_path / "two.db") as two:
        assert [*one.table()["state"]] == ["done"] * 6
        for k in one.table().index:
            assert one.recording(k).x.tobytes() == two.recording(k).x.tobytes()


def test_sub_steps_see_the_same_message(folder):
    fmu = drive(FmuDriver(str(folder / "update.fmu"), step=0.05), time_step=0.05)
    fine = drive(FmuDriver(str(folder / "request.fmu"), answer=ACCELERATION, step=0.01), time_step=0.05)
    assert ego(fine, "speed").min() == pytest.approx(ego(fmu, "speed").min(), abs=0.5)


@pytest.mark.parametrize("any_step", [True, False])
def test_its_own_step_size_does_not_slow_it_down(folder, tmp_path, any_step):
    """An update is relative to the message, which is new in each step of the simulator only."""
    fmu = make_osmp_fmu(tmp_path / "osmp.fmu", step_size=0.02, any_step=any_step)
    if not any_step:
        with pytest.raises(cc.InputError, match=r"steps of 0\.02 s, .* time step to 0\.02"):
            drive(FmuDriver(str(fmu)), time_step=0.1)
    recording = drive(FmuDriver(str(fmu)), time_step=0.1 if any_step else 0.02, duration=2.0)
    moved = np.diff(ego(recording, "x")) / np.diff(recording.time)
    np.testing.assert_allclose(moved, ego(recording, "speed")[1:], rtol=0.0, atol=1e-6)


def test_what_an_update_does_not_say_stays(folder):
    """A position without y, as of a model that only knows straight roads, does not move it to y = 0."""
    recording = drive(FmuDriver(str(folder / "update.fmu"), answer=5), duration=2.0)
    assert (ego(recording, "y") == ego(recording, "y")[0]).all()
    assert ego(recording, "y")[0] != 0.0
    assert (ego(recording, "heading") == ego(recording, "heading")[0]).all()
    assert ego(recording, "x")[-1] > ego(recording, "x")[0] + 30.0


def test_a_name_of_the_standard_counts_more_than_a_wrong_type(folder, tmp_path):
    """Models that were copied from OpenMSL's template declare commands as views, and their answers as updates."""
    more = message_variables("OSMPTrafficCommandUpdateOut", "TrafficUpdate", "output", 16)
    more += message_variables("OSMPTrafficCommandIn", "SensorView", "input", 10)
    fmu = make_osmp_fmu(tmp_path / "osmp.fmu", more=more)
    right, wrong = drive(FmuDriver(str(folder / "update.fmu"))), drive(FmuDriver(str(fmu)))
    assert ego(wrong, "x").tobytes() == ego(right, "x").tobytes()
    ended = cornercase("check", DECELERATION, "--sut", f"Ego=fmu:{fmu}", cwd=tmp_path)
    assert (
        "input OSMPTrafficCommandIn: what the scenario wants, as OSI TrafficCommand (by its name; its MIME type says"
        " SensorView)" in ended.stdout
    )
    assert (
        "output OSMPTrafficCommandUpdateOut: not used (OSI TrafficCommandUpdate, by its name; its MIME type says"
        " TrafficUpdate)" in ended.stdout
    )


def test_it_is_told_what_the_scenario_wants(tmp_path):
    """The speed of the scenario is told once, as an action with an id of its own."""
    from osi3.osi_trafficcommand_pb2 import TrafficCommand

    more = message_variables("OSMPTrafficCommandIn", "TrafficCommand", "input", 10)
    fmu = make_osmp_fmu(tmp_path / "osmp.fmu", more=more)
    recording = drive(FmuDriver(str(fmu), record=str(tmp_path / "record.bin")), duration=1.0)
    commands = [
        TrafficCommand.FromString(content) for kind, content in read_record(tmp_path / "record.bin") if kind == "C"
    ]
    assert len(commands) == len(recording.time) - 1
    actions = [list(command.action) for command in commands]
    assert [len(some) for some in actions] == [1] + [0] * (len(commands) - 1)
    speed = actions[0][0].speed_action
    assert speed.absolute_target_speed == pytest.approx(ego(recording, "speed")[0])
    assert speed.action_header.HasField("action_id")


def test_it_is_told_how_its_views_are(tmp_path):
    from osi3.osi_sensorviewconfiguration_pb2 import SensorViewConfiguration

    more = message_variables(
        "OSMPSensorViewInConfigRequest", "SensorViewConfiguration", "calculatedParameter", 16
    ) + message_variables("OSMPSensorViewInConfig", "SensorViewConfiguration", "parameter", 13)
    fmu = make_osmp_fmu(tmp_path / "osmp.fmu", more=more)
    drive(FmuDriver(str(fmu), record=str(tmp_path / "record.bin")), duration=1.0)
    (content,) = [content for kind, content in read_record(tmp_path / "record.bin") if kind == "V"]
    config = SensorViewConfiguration.FromString(content)
    assert config.update_cycle_time.nanos == 50_000_000
    assert config.omit_static_information
    assert not config.camera_sensor_view_configuration
    ended = cornercase("check", DECELERATION, "--sut", f"Ego=fmu:{fmu}", cwd=tmp_path)
    assert "parameter OSMPSensorViewInConfig: how the views are, once, as OSI SensorViewConfiguration" in ended.stdout


ANSWERS = {
    1: r"its TrafficUpdate has the ids 1, but not the id 0 of the driven vehicle",
    2: r"its message is not an OSI TrafficUpdate",
    4: r"its TrafficUpdate cannot be driven: the state has neither a position nor an acceleration",
}


@pytest.mark.parametrize("answer", ANSWERS)
def test_an_unusable_answer_fails_with_its_instant(folder, answer):
    with pytest.raises(cc.InputError, match=rf"the driver of Ego .* failed at t = 0 s: {ANSWERS[answer]}"):
        drive(FmuDriver(str(folder / "update.fmu"), answer=answer))


def test_without_a_message_it_keeps_its_speed(folder):
    recording = drive(FmuDriver(str(folder / "update.fmu"), answer=3), duration=1.0)
    assert (ego(recording, "acceleration") == 0.0).all()


def test_the_messages_are_listed(folder, tmp_path):
    ended = cornercase("check", DECELERATION, "--sut", f"Ego=fmu:{folder / 'no_init.fmu'}", cwd=tmp_path)
    assert "input OSMPSensorViewIn: what the sensors know, as OSI SensorView" in ended.stdout
    assert "output OSMPTrafficUpdateOut[1]: pose and speed at the end of the step, as OSI TrafficUpdate" in ended.stdout
    assert "base.lo" not in ended.stdout


VIEW_VARIABLES = message_variables("OSMPSensorViewIn", "SensorView", "input", 0)


@pytest.mark.parametrize(
    ("variables", "says"),
    [
        (VIEW_VARIABLES.replace('role="base.hi"', 'role="base.lo"'), "has the parts base.lo, base.lo, size; it needs"),
        (VIEW_VARIABLES.replace("type=SensorView", "type=SensorData", 1), "have different MIME types"),
        (VIEW_VARIABLES.replace('"input"', '"output"', 1), "have to be integers of the same causality"),
        (VIEW_VARIABLES, "lane_change), and the FMU writes neither a TrafficUpdate nor a MotionRequest; say in a map"),
    ],
)
def test_an_fmu_against_the_standard_gives_a_sentence(tmp_path, variables, says):
    with pytest.raises(cc.InputError) as raised:
        FmuDriver(str(make_osmp_fmu(tmp_path / "osmp.fmu", variables=variables)))
    assert says in str(raised.value)


def test_without_the_extra_a_sentence_names_it(folder, monkeypatch):
    monkeypatch.setitem(sys.modules, "osi3", None)
    with pytest.raises(cc.InputError, match=r"an FMU with OSI messages needs the extra 'osi'"):
        FmuDriver(str(folder / "update.fmu"))


def test_a_map_may_decide_instead(folder, tmp_path):
    (tmp_path / "map.toml").write_text("[outputs]\n")
    with pytest.raises(cc.InputError, match="none of the outputs"):
        FmuDriver(str(folder / "update.fmu"), map=str(tmp_path / "map.toml"))


class TestRules:
    """The FMU notices each breach of a rule, here of an environment that does not keep it."""

    @pytest.fixture
    def steps(self, folder, tmp_path, record):
        """A started instance, its log, and the messages of a run that goes well."""
        lines: list[str] = []
        instance = Fmu(read_fmu(folder / "update.fmu").unpack(tmp_path), lines.append).instantiate("osmp")
        messages = [content for _, content in record[0]]
        return instance, lines, messages[0], messages[1:]

    @staticmethod
    def start(instance, init):
        pass_message(instance, INIT, init)
        instance.enter_initialization()
        instance.exit_initialization()

    @staticmethod
    def altered(content, change):
        from osi3.osi_sensorview_pb2 import SensorView

        view = SensorView.FromString(content)
        change(view)
        return view.SerializeToString()

    def test_all_kept(self, steps):
        instance, lines, init, views = steps
        self.start(instance, init)
        for k, view in enumerate(views):
            pass_message(instance, VIEW, view)
            step_instance(instance, 0.05 * k, 0.05)
        assert not lines

    CHANGES: ClassVar[dict[str, Any]] = {
        "SensorView can be parsed": lambda view: None,
        "SensorView and GroundTruth have a version": lambda view: view.ClearField("version"),
        "SensorView has a sensor id and a mounting position": lambda view: view.ClearField("mounting_position"),
        "SensorView and GroundTruth have the same host": lambda view: view.ClearField("host_vehicle_id"),
        "SensorView and GroundTruth have the same time": lambda view: view.timestamp.CopyFrom(type(view.timestamp)()),
        "roads are told once": lambda view: view.global_ground_truth.lane.add(),
        "ids are unique": lambda view: view.global_ground_truth.moving_object.append(
            view.global_ground_truth.moving_object[0]
        ),
        "ids stay those of their objects": lambda view: (
            view.global_ground_truth.moving_object[1]
            .source_reference[0]
            .identifier.__setitem__(0, "entity_name:Someone")
        ),
        "the host is one of the moving objects": lambda view: view.global_ground_truth.moving_object.pop(0),
    }

    @pytest.mark.parametrize("rule", CHANGES)
    def test_a_message_against_a_rule(self, steps, rule):
        instance, lines, init, views = steps
        self.start(instance, init)
        pass_message(instance, VIEW, views[0])
        step_instance(instance, 0.0, 0.05)
        bad = self.altered(views[1], self.CHANGES[rule])
        if rule == "SensorView can be parsed":
            bad = bad[:-3]
        pass_message(instance, VIEW, bad)
        with pytest.raises(FmuError):
            step_instance(instance, 0.05, 0.05)
        assert lines == [f"OSMP: {rule}"]

    def test_time_and_buffers(self, steps):
        instance, lines, init, views = steps
        self.start(instance, init)
        with pytest.raises(FmuError):
            step_instance(instance, 0.0, 0.05)
        pass_message(instance, VIEW, views[5])
        with pytest.raises(FmuError):
            step_instance(instance, 0.0, 0.05)
        step_instance(instance, 0.25, 0.05)
        pass_message(instance, VIEW, views[4])
        with pytest.raises(FmuError):
            step_instance(instance, 0.3, 0.05)
        assert lines == [
            "OSMP: SensorView has an address and a size",
            "OSMP: SensorView is not of the future",
            "OSMP: time increases",
        ]

    def test_buffers(self, steps):
        import ctypes

        instance, lines, init, views = steps
        self.start(instance, init)
        buffer = (ctypes.c_char * 100_000)()
        address = ctypes.addressof(buffer)
        for k in range(2):
            ctypes.memmove(buffer, views[k], len(views[k]))
            halves = [ctypes.c_int32(part).value for part in (address, address >> 32)]
            instance.set("Integer", [0, 1, 2], [*halves, len(views[k])])
            if k == 0:
                step_instance(instance, 0.0, 0.05)
        with pytest.raises(FmuError):
            step_instance(instance, 0.05, 0.05)
        assert lines == ["OSMP: the buffer of the step before stays as it was"]

    def test_the_roads(self, steps):
        instance, lines, init, views = steps
        pass_message(instance, INIT, views[0])
        instance.enter_initialization()
        with pytest.raises(FmuError):
            instance.exit_initialization()
        with pytest.raises(FmuError):
            pass_message(instance, INIT, init)
        assert lines[0].startswith("OSMP: GroundTruthInit")
        assert lines[1] == "OSMP: GroundTruthInit is set once, before the initialization"
