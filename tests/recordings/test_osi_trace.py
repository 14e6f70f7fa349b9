"""OSI traces that cornercase writes, read by osi-python and by cornercase."""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np
import pytest
from osi3.osi_object_pb2 import MovingObject
from osi3.osi_sensorview_pb2 import SensorView
from osi3trace.osi_trace import OSITrace

import cornercase as cc
from conftest import EXAMPLES
from cornercase.recordings import Recording, read_recording, write_osi
from helpers.command_line import cornercase
from helpers.two_cars import met


@pytest.fixture
def recording() -> Recording:
    return cc.simulate(EXAMPLES / "x_intersection" / "x_intersection.xosc", duration=6.0)


def test_osi_python_reads_every_message(tmp_path, recording):
    write_osi(tmp_path / "run.osi", recording, ego="C")
    trace = OSITrace(str(tmp_path / "run.osi"), "GroundTruth")
    messages = list(trace)
    trace.close()
    assert len(messages) == len(recording.time)
    for k, message in enumerate(messages):
        assert message.IsInitialized()
        assert (message.version.version_major, message.version.version_minor) == (3, 8)
        assert message.timestamp.seconds + 1e-9 * message.timestamp.nanos == pytest.approx(recording.time[k], abs=1e-9)
        assert message.host_vehicle_id.value == recording.names.index("C")
        assert len({item.id.value for item in message.moving_object}) == len(message.moving_object)
        for item in message.moving_object:
            e = item.id.value
            ahead, heading = recording.center_x[e], recording.heading[e, k]
            assert item.base.position.x == pytest.approx(recording.x[e, k] + ahead * np.cos(heading), abs=1e-9)
            assert item.base.position.y == pytest.approx(recording.y[e, k] + ahead * np.sin(heading), abs=1e-9)
            assert -np.pi <= item.base.orientation.yaw <= np.pi
            assert item.base.position.z == pytest.approx(0.5 * item.base.dimension.height)
            assert item.base.dimension.length == recording.length[e]
            is_vehicle = recording.object_types[e] not in ("pedestrian", "misc")
            assert (item.type == MovingObject.TYPE_VEHICLE) == is_vehicle
            # The standard demands it of vehicles only.
            assert item.HasField("vehicle_classification") == is_vehicle


def test_cornercase_reads_back_what_it_wrote(tmp_path, recording):
    motion = {name: getattr(recording, name).copy() for name in ("x", "y", "heading", "speed", "acceleration")}
    for values in motion.values():
        values[-1, :10] = np.nan
    recording = replace(recording, **motion)
    write_osi(tmp_path / "run.osi", recording)
    read = read_recording(tmp_path / "run.osi")
    assert (read.names, read.object_types) == (recording.names, recording.object_types)
    np.testing.assert_allclose(read.time, recording.time, atol=1e-9)
    centers = np.stack([recording.box_center(name) for name in recording.names])
    np.testing.assert_allclose(np.stack([read.box_center(name) for name in read.names]), centers, atol=1e-9)
    turn = (read.heading - recording.heading + np.pi) % (2 * np.pi) - np.pi
    assert np.nanmax(np.abs(turn)) < 1e-9
    exists = np.isfinite(recording.x)
    np.testing.assert_allclose(read.speed[exists], recording.speed[exists], atol=1e-9)
    assert np.array_equal(np.isfinite(read.x), exists)


def test_objects_may_appear_after_the_first_message(tmp_path):
    appearing = met((np.arange(6.0), 0.0, 0.0, 10.0), (np.arange(6.0) + 20.0, 0.0, 0.0, 10.0))
    appearing.x[:, :2] = np.nan
    write_osi(tmp_path / "run.osi", appearing)
    read = read_recording(tmp_path / "run.osi")
    np.testing.assert_allclose(read.time, appearing.time[2:], atol=1e-9)
    np.testing.assert_allclose(read.x, appearing.x[:, 2:], atol=1e-9)
    trace = OSITrace(str(tmp_path / "run.osi"), "GroundTruth")
    with open(tmp_path / "views.osi", "wb") as file:
        for truth in trace:
            view = SensorView(version=truth.version, timestamp=truth.timestamp, global_ground_truth=truth)
            file.write(view.ByteSize().to_bytes(4, "little") + view.SerializeToString())
    trace.close()
    np.testing.assert_array_equal(read_recording(tmp_path / "views.osi").x, read.x)


def test_the_centre_of_a_turning_car_moves_sideways(tmp_path):
    rate, speed, radius = 0.2, 10.0, 50.0
    time = np.arange(0.0, 2.0, 0.01)
    heading = (rate * time)[None]
    one = np.ones(1)
    turning = Recording(
        time=time, names=("Ego",), object_types=("car",), x=radius * np.sin(heading), y=radius * (1 - np.cos(heading)),
        heading=heading, speed=np.full((1, len(time)), speed), acceleration=np.zeros((1, len(time))),
        length=4.0 * one, width=2.0 * one, center_x=1.5 * one,
    )  # fmt: skip
    write_osi(tmp_path / "run.osi", turning)
    trace = OSITrace(str(tmp_path / "run.osi"), "GroundTruth")
    messages = list(trace)
    trace.close()
    bases = [message.moving_object[0].base for message in messages]
    centers = np.array([(base.position.x, base.position.y) for base in bases])
    velocities = np.array([(base.velocity.x, base.velocity.y) for base in bases])
    accelerations = np.array([(base.acceleration.x, base.acceleration.y) for base in bases])
    np.testing.assert_allclose(np.gradient(centers, time, axis=0)[2:-2], velocities[2:-2], atol=2e-3)
    np.testing.assert_allclose(np.gradient(velocities, time, axis=0)[2:-2], accelerations[2:-2], atol=2e-3)


def test_commands_write_traces(tmp_path, recording):
    x = EXAMPLES / "x_intersection"
    done = cornercase("simulate", x / "x_intersection.xosc", "--duration", 6, "-o", tmp_path / "run.osi")
    assert done.returncode == 0, done.stderr
    write_osi(tmp_path / "same.osi", recording, ego="Ego")
    assert (tmp_path / "run.osi").read_bytes() == (tmp_path / "same.osi").read_bytes()
    explored = cornercase(
        "explore", x / "x_intersection.xosc", "--space", x / "x_intersection.space.xosc", "--ego", "Ego", "--other",
        "Pedestrian", "--metric", "wttc", "--optimizer", "sobol", "--budget", 4, "-o", tmp_path / "study.db",
    )  # fmt: skip
    assert explored.returncode == 0, explored.stderr
    assert cornercase("export", tmp_path / "study.db", "--osi", "-o", tmp_path / "out").returncode == 0
    read = read_recording(tmp_path / "out" / "osi" / "00003.osi")
    with cc.Study.open(tmp_path / "study.db") as study:
        stored = study.recording(3)
    np.testing.assert_allclose(read.box_center("Ego"), stored.box_center("Ego"), atol=1e-9)


def test_what_cannot_be_written_is_said(tmp_path, recording, monkeypatch):
    with pytest.raises(cc.InputError, match=r"must end in \.osi"):
        write_osi(tmp_path / "run.mcap", recording)
    with pytest.raises(cc.InputError, match="Nobody"):
        write_osi(tmp_path / "run.osi", recording, ego="Nobody")
    monkeypatch.setitem(sys.modules, "osi3", None)
    with pytest.raises(cc.InputError, match=r"pip install 'cornercase\[osi\]'"):
        write_osi(tmp_path / "run.osi", recording)
    assert not (tmp_path / "run.osi").exists()
