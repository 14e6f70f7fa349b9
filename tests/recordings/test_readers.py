"""Recordings of other tools: ASAM OSI traces and CommonRoad scenarios."""

from __future__ import annotations

import lzma
import math
import struct
import sys
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from cornercase._common.errors import InputError
from cornercase.cli import app
from cornercase.metrics import Ttc
from cornercase.recordings import read_recording

TIMES = np.arange(0, 20) * 0.1


def osi_messages(kind: str, times=TIMES) -> list[bytes]:
    """A car at 20 m/s north-east behind a truck at 10 m/s, 30 m apart; a pedestrian from the tenth message on."""
    from osi3.osi_groundtruth_pb2 import GroundTruth
    from osi3.osi_object_pb2 import MovingObject
    from osi3.osi_sensorview_pb2 import SensorView

    messages = []
    for k, t in enumerate(times):
        message = GroundTruth() if kind == "GroundTruth" else SensorView()
        truth = message if kind == "GroundTruth" else message.global_ground_truth
        for stamp in (message.timestamp, truth.timestamp):
            stamp.seconds, stamp.nanos = int(t), round((t % 1) * 1e9)
        for number, start, speed, length in ((4, 0.0, 20.0, 4.0), (17, 37.0, 10.0, 10.0)):
            one = truth.moving_object.add()
            one.id.value, one.type = number, MovingObject.TYPE_VEHICLE
            one.vehicle_classification.type = (
                MovingObject.VehicleClassification.TYPE_HEAVY_TRUCK
                if number == 17
                else MovingObject.VehicleClassification.TYPE_MEDIUM_CAR
            )
            along = (start + speed * t) * math.sqrt(0.5)
            one.base.position.x = one.base.position.y = along
            one.base.orientation.yaw = math.pi / 4
            one.base.velocity.x = one.base.velocity.y = speed * math.sqrt(0.5)
            one.base.dimension.length, one.base.dimension.width = length, 2.0
        if k >= 10:
            walker = truth.moving_object.add()
            walker.id.value, walker.type = 5, MovingObject.TYPE_PEDESTRIAN
            walker.base.position.x, walker.base.position.y = 50.0, -3.0 + t
            walker.base.orientation.yaw = math.pi / 2
            walker.base.dimension.length = walker.base.dimension.width = 0.5
        messages.append(message.SerializeToString())
    return messages


def single_channel(path: Path, messages: list[bytes]) -> Path:
    data = b"".join(struct.pack("<L", len(one)) + one for one in messages)
    path.write_bytes(lzma.compress(data) if path.suffix in (".xz", ".lzma") else data)
    return path


def multi_channel(path: Path, kind: str) -> Path:
    from mcap_protobuf.writer import Writer
    from osi3.osi_groundtruth_pb2 import GroundTruth
    from osi3.osi_sensorview_pb2 import SensorView

    with open(path, "wb") as file, Writer(file) as writer:
        for k, data in enumerate(osi_messages(kind)):
            message = {"GroundTruth": GroundTruth, "SensorView": SensorView}[kind]()
            message.ParseFromString(data)
            writer.write_message(topic="traffic", message=message, log_time=k, publish_time=k)
    return path


@pytest.mark.parametrize("kind", ["GroundTruth", "SensorView"])
@pytest.mark.parametrize("ending", [".osi", ".osi.xz", ".mcap"])
def test_osi_traces_of_all_forms(tmp_path, kind, ending):
    path = tmp_path / f"trace{ending}"
    path = multi_channel(path, kind) if ending == ".mcap" else single_channel(path, osi_messages(kind))
    read = read_recording(path)
    assert read.names == ("4", "17", "5")
    assert read.kinds == ("car", "truck", "pedestrian")
    np.testing.assert_allclose(read.time, TIMES, atol=1e-9)
    np.testing.assert_allclose(read.speed[:2], np.array([[20.0] * 20, [10.0] * 20]))
    assert np.isnan(read.x[2, :10]).all()
    # Nothing says how fast the pedestrian is; its positions do.
    np.testing.assert_allclose(read.speed[2, 10:], 1.0)
    np.testing.assert_allclose(Ttc().course(read, "4", "17"), 3.0 - TIMES, atol=1e-9)


def test_osi_traces_that_are_cut_off_or_of_something_else(tmp_path):
    whole = single_channel(tmp_path / "whole.osi", osi_messages("GroundTruth")).read_bytes()
    for share in range(1, 10):
        path = tmp_path / f"cut{share}.osi"
        path.write_bytes(whole[: len(whole) * share // 10 + 1])
        with pytest.raises(InputError, match=rf"cut{share}\.osi: .*(cut off|holds no)"):
            read_recording(path)
    mcap = multi_channel(tmp_path / "whole.mcap", "GroundTruth").read_bytes()
    for share in range(1, 10):
        path = tmp_path / f"cut{share}.mcap"
        path.write_bytes(mcap[: len(mcap) * share // 10])
        with pytest.raises(InputError, match=rf"cut{share}\.mcap: "):
            read_recording(path)
    for name in ("noise.osi", "noise.mcap", "noise.xz"):
        (tmp_path / name).write_bytes(b"\x10\x00\x00\x00" + bytes(range(200)))
        with pytest.raises(InputError, match=name):
            read_recording(tmp_path / name)
        (tmp_path / name).write_bytes(b"")
        with pytest.raises(InputError, match=name):
            read_recording(tmp_path / name)
    with pytest.raises(InputError, match=r"missing\.osi: cannot be read"):
        read_recording(tmp_path / "missing.osi")


def state(tag: str, x: str, y: str, step: int, speed: float, heading: str = "0.0") -> str:
    return f"""<{tag}><position><point><x>{x}</x><y>{y}</y></point></position>
<orientation><exact>{heading}</exact></orientation><time><exact>{step}</exact></time>
<velocity><exact>{speed}</exact></velocity></{tag}>"""


def commonroad(path: Path, extra: str = "", head: str = "") -> Path:
    """A car at 20 m/s behind one at 10 m/s, 30 m apart, on a road of one lane, and a parked one beside them."""
    cars = ""
    for number, start, speed in ((42, 0.0, 20.0), (43, 34.0, 10.0)):
        states = [(start + speed * 0.1 * k, k) for k in range(21)]
        cars += f"""<dynamicObstacle id="{number}"><type>car</type>
<shape><rectangle><length>4.0</length><width>2.0</width></rectangle></shape>
{state("initialState", str(states[0][0]), "0.0", 0, speed)}
<trajectory>{"".join(state("state", repr(x), "0.0", k, speed) for x, k in states[1:])}</trajectory></dynamicObstacle>"""
    bound = "".join(f"<point><x>{x}</x><y>{{y}}</y></point>" for x in (0.0, 100.0))
    path.write_text(
        f"""<?xml version="1.0" encoding="UTF-8"?>{head}
<commonRoad timeStepSize="0.1" commonRoadVersion="2020a" benchmarkID="DEU_Test-1_1_T-1" author="a" affiliation="b"
 source="c" date="2026-01-01">
<location><geoNameId>0</geoNameId><gpsLatitude>0</gpsLatitude><gpsLongitude>0</gpsLongitude></location>
<scenarioTags><urban/></scenarioTags>
<lanelet id="1"><leftBound>{bound.format(y=2.0)}</leftBound><rightBound>{bound.format(y=-2.0)}</rightBound>
<laneletType>urban</laneletType></lanelet>
<staticObstacle id="44"><type>parkedVehicle</type>
<shape><rectangle><length>4.5</length><width>1.8</width></rectangle></shape>
{state("initialState", "20.0", "4.0", 0, 0.0, "0.1")}</staticObstacle>
{cars}{extra}
<planningProblem id="99">{state("initialState", "0.0", "0.0", 0, 20.0).replace("</initialState>", "<yawRate><exact>0.0</exact></yawRate><slipAngle><exact>0.0</exact></slipAngle></initialState>")}
<goalState><time><intervalStart>0</intervalStart><intervalEnd>20</intervalEnd></time></goalState></planningProblem>
</commonRoad>"""
    )
    return path


def test_commonroad_scenarios(tmp_path):
    read = read_recording(commonroad(tmp_path / "scene.xml"))
    assert read.names == ("42", "43", "44")
    assert read.kinds == ("car", "car", "car")
    np.testing.assert_allclose(read.time, np.arange(21) * 0.1)
    np.testing.assert_allclose(Ttc().course(read, "42", "43"), 3.0 - read.time, atol=1e-9)
    assert (read.x[2] == 20.0).all()
    assert (read.speed[2] == 0.0).all()
    np.testing.assert_allclose(read.acceleration, 0.0, atol=1e-9)


@pytest.mark.parametrize(
    ("extra", "head", "sentence"),
    [
        ("", "<!DOCTYPE a [<!ENTITY b 'c'>]>", "document type declaration"),
        ("<dynamicObstacle id='7'><type>car</type></dynamicObstacle>", "", "cannot read it"),
        (
            "<dynamicObstacle id='7'><type>car</type><shape><polygon>"
            + "".join(f"<point><x>{x}</x><y>{y}</y></point>" for x, y in ((0, 0), (4, 0), (4, 2), (0, 2)))
            + f"</polygon></shape>{state('initialState', '60.0', '0.0', 0, 5.0)}"
            + f"<trajectory>{state('state', '60.5', '0.0', 1, 5.0)}</trajectory></dynamicObstacle>",
            "",
            "obstacle 7 is a Polygon",
        ),
    ],
)
def test_commonroad_files_that_cannot_be_measured(tmp_path, extra, head, sentence):
    with pytest.raises(InputError, match=sentence):
        read_recording(commonroad(tmp_path / "scene.xml", extra, head))


def test_without_the_extra_the_message_names_it(tmp_path, monkeypatch):
    trace = single_channel(tmp_path / "trace.osi", osi_messages("GroundTruth"))
    monkeypatch.setitem(sys.modules, "osi3", None)
    with pytest.raises(InputError, match=r"pip install cornercase\[osi\]"):
        read_recording(trace)
    monkeypatch.setitem(sys.modules, "commonroad.common.file_reader", None)
    with pytest.raises(InputError, match=r"pip install cornercase\[commonroad\]"):
        read_recording(commonroad(tmp_path / "scene.xml"))


def test_a_trace_is_measured_on_the_command_line(tmp_path):
    trace = single_channel(tmp_path / "trace.osi", osi_messages("SensorView"))
    run = CliRunner().invoke(
        app, ["measure", str(trace), "--ego", "4", "--other", "17", "--metric", "ttc", "-o", str(tmp_path / "c.csv")]
    )
    assert run.exit_code == 0, run.output
    rows = (tmp_path / "c.csv").read_text().splitlines()
    assert rows[0] == "time,ttc"
    assert float(rows[-1].split(",")[1]) == pytest.approx(1.1)
