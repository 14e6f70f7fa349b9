"""Recordings as other tools write them, of an ego on a straight road."""

from __future__ import annotations

import lzma
import math
import struct
from pathlib import Path

import numpy as np

TIME = np.arange(0.0, 4.01, 0.1)
SPEED = 8.0
HEADING = 0.3


def way(t, ahead=0.0):
    """Place on a line that begins at (10, -5)."""
    return 10.0 + (SPEED * t + ahead) * np.cos(HEADING), -5.0 + (SPEED * t + ahead) * np.sin(HEADING)


def esmini(path):
    """Two cars of 5 m x 2 m, whose boxes are 1.4 m ahead of their reference points; the second 30 m ahead."""
    one = (
        "Entity_Name [-], #{0} Entity_ID [-], #{0} Current_Speed [m/s], #{0} Wheel_Angle [deg], #{0} Wheel_Rotation [-],"
        " #{0} bb_x [m], #{0} bb_y [m], #{0} bb_z [m], #{0} bb_length [m], #{0} bb_width [m], #{0} bb_height [m],"
        " #{0} World_Position_X [m], #{0} World_Position_Y [m], #{0} World_Position_Z [m],"
        " #{0} World_Heading_Angle [rad], #{0} collision_ids, "
    )
    lines = [
        "esmini GIT REV: 0", "esmini GIT TAG: v3", "Scenario File Name: a.xosc", "Number of Vehicles: 2",
        "Index [-], TimeStamp [s], " + "".join(f"#{k} " + one.format(k) for k in (1, 2)),
    ]  # fmt: skip
    for k, t in enumerate(TIME):
        row = f"{k}, {t:f}, "
        for name, ahead in (("Ego", 0.0), ("Other", 30.0)):
            x, y = way(t, ahead)
            row += f"{name}, 0, {SPEED:f}, 0.0, 0.0, 1.4, 0.0, 0.7, 5.0, 2.0, 1.5, {x:f}, {y:f}, 0.0, {HEADING:f}, , "
        lines.append(row)
    path.write_text("\n".join(lines) + "\n")


def erg(path, without=(), speed=SPEED, ahead=30.0, more=None):
    """Ego, which tells this speed, and T00 with boxes of 4.5 m x 1.8 m from their rear ends, 30 m apart."""
    x, y = way(TIME)
    other_x, other_y = way(TIME, ahead)
    columns = {
        "Time": ("Double", TIME), "Car.tx": ("Double", x), "Car.ty": ("Double", y), "Car.v": ("Float", 0 * TIME + speed),
        "Car.Yaw": ("Float", 0 * TIME + HEADING), "Traffic.T00.tx": ("Double", other_x),
        "Traffic.T00.ty": ("Double", other_y), "Traffic.T00.v_0.x": ("Float", 0 * TIME + SPEED * np.cos(HEADING)),
        "Traffic.T00.v_0.y": ("Float", 0 * TIME + SPEED * np.sin(HEADING)), "Driver.GearNo": ("Int", TIME),
        "Padding": ("3 Bytes", TIME),
    }  # fmt: skip
    write_erg(path, {name: one for name, one in (columns | (more or {})).items() if name not in without})


def write_erg(path, columns):
    """A result file with columns: type and values by name."""
    kinds = {"Double": "<f8", "Float": "<f4", "Int": "<i4", "3 Bytes": "V3"}
    table = np.zeros(len(columns["Time"][1]), [(name, kinds[kind]) for name, (kind, _) in columns.items()])
    for name, (kind, values) in columns.items():
        if kind != "3 Bytes":
            table[name] = values
    path.write_bytes(b"CM-ERG\0\0" + struct.pack("<HHI", 1, table.dtype.itemsize, 0) + table.tobytes())
    about = ["#INFOFILE1.1 - Do not remove this line!", "File.Format = erg", "File.ByteOrder = LittleEndian"]
    for k, (name, (kind, _)) in enumerate(columns.items(), 1):
        about += [f"File.At.{k}.Name = {name}", f"File.At.{k}.Type = {kind}"]
    path.with_name(path.name + ".info").write_text("\n".join(about) + "\n")


def carla(path, roles=("hero", "")):
    """A hero of 5 m x 2 m whose box is 0.1 m ahead of its origin, and a walker 30 m ahead, in CARLA's axes and cm."""

    def text(value):
        return struct.pack("<H", len(value)) + value.encode()

    def packet(kind, body):
        return struct.pack("<BI", kind, len(body)) + body

    def actor(number, sort, kind, role):
        body = struct.pack("<IB6fI", number, sort, *[0.0] * 6, 7) + text(kind) + struct.pack("<H", 1)
        return body + b"\0" + text("role_name") + text(role)

    data = struct.pack("<H", 1) + text("CARLA_RECORDER") + struct.pack("<q", 0) + text("Town01")
    added = [actor(5, 1, "vehicle.a.b", roles[0]), actor(6, 2, "walker.pedestrian.0001", roles[1])]
    added.append(actor(7, 3, "traffic.traffic_light", ""))
    for k, t in enumerate(TIME):
        data += packet(0, struct.pack("<Qdd", k, 0.1, t))
        if k == 0:
            data += packet(2, struct.pack("<H", 3) + b"".join(added))
        rows = b"".join(
            struct.pack("<I6f", number, 100 * x, -100 * y, 0.0, 0.0, 0.0, -np.degrees(HEADING))
            for number, (x, y) in ((5, way(t)), (6, way(t, 30.0)), (7, (0.0, 0.0)))
        )
        data += packet(6, struct.pack("<H", 3) + rows)
        boxes = ((5, 10.0, 250.0, 100.0), (6, 0.0, 20.0, 30.0))
        body = b"".join(struct.pack("<I6f", n, ahead, 0, 70, length, width, 70) for n, ahead, length, width in boxes)
        data += packet(13, struct.pack("<H", 2) + body)
        data += packet(99, b"later versions")
        data += packet(1, b"")
    path.write_bytes(data)


def fcd(path):
    """A car of 5 m x 1.8 m whose front is on the way, and a person 30 m ahead."""
    lines = ["<?xml version='1.0'?>", "<fcd-export>"]
    angle = 90.0 - np.degrees(HEADING)
    for t in TIME:
        (x, y), (other_x, other_y) = way(t), way(t, 30.0)
        lines += [
            f"<timestep time='{t:.2f}'>",
            f"<vehicle id='Ego' x='{x}' y='{y}' angle='{angle}' type='DEFAULT_VEHTYPE' speed='{SPEED}' pos='1' lane='a_0'/>",
            f"<person id='P' x='{other_x}' y='{other_y}' angle='{angle}' speed='{SPEED}' pos='1' edge='a'/>",
            "</timestep>",
        ]
    path.write_text("\n".join([*lines, "</fcd-export>"]))


# Of OSI traces.
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
