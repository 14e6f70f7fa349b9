"""Entities as moving objects of ASAM OSI messages."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

from cornercase._common.errors import InputError
from cornercase._common.optional_packages import describe_install

# By vehicle category: its name in OSI's VehicleClassification, and a usual height in m: recordings have no heights.
_VEHICLE_TYPES: Final = {
    "car": ("TYPE_MEDIUM_CAR", 1.5), "van": ("TYPE_DELIVERY_VAN", 2.0), "truck": ("TYPE_HEAVY_TRUCK", 3.5),
    "semitrailer": ("TYPE_SEMITRAILER", 3.5), "trailer": ("TYPE_TRAILER", 2.0), "bus": ("TYPE_BUS", 3.0),
    "motorbike": ("TYPE_MOTORBIKE", 1.5), "bicycle": ("TYPE_BICYCLE", 1.7), "train": ("TYPE_TRAIN", 4.0),
    "tram": ("TYPE_TRAM", 3.5), "wheelchair": ("TYPE_WHEELCHAIR", 1.3),
}  # fmt: skip
_OTHER_TYPES: Final = {"pedestrian": ("TYPE_PEDESTRIAN", 1.8), "animal": ("TYPE_ANIMAL", 1.0)}
_OTHER: Final = ("TYPE_OTHER", 1.0)
# Type and prefix of the reference that names the entity of the scenario.
REFERENCE_TYPE: Final = "net.asam.openscenario"
NAME_PREFIX: Final = "entity_name:"


@dataclass(frozen=True)
class OsiEntity:
    """Properties of an entity that do not change.

    `center_x` is the distance in m of the box centre ahead of the reference point. The size of the box is in m.
    """

    name: str
    object_type: str
    length: float
    width: float
    center_x: float


@dataclass(frozen=True)
class OsiState:
    """Motion of an entity's reference point in m, rad, m/s, m/s² and rad/s; NaN while the entity does not exist."""

    x: float
    y: float
    heading: float
    speed: float
    acceleration: float
    yaw_rate: float = 0.0


def require_osi(what: str) -> None:
    """Raise `InputError` if the extra ``osi`` is not installed; `what` is the subject of its message."""
    try:
        import osi3  # noqa: F401
    except ImportError as error:
        raise InputError(f"{what} needs the extra 'osi'; {describe_install('osi')}.") from error


def fill_ground_truth(
    truth: Any, time: float, entities: Sequence[OsiEntity], states: Sequence[OsiState], host: int | None = None
) -> None:
    """Fill an empty GroundTruth message with the entities that exist; the id of an object is the index of its entity.

    `host` is the index of the host vehicle.
    """
    set_version(truth)
    set_timestamp(truth.timestamp, time)
    if host is not None:
        truth.host_vehicle_id.value = host
    for number, (entity, state) in enumerate(zip(entities, states, strict=True)):
        if math.isfinite(state.x):
            _fill_moving_object(truth.moving_object.add(), number, entity, state)


def set_version(message: Any) -> None:
    """Set the version of an OSI message to the version of the installed OSI library."""
    from osi3 import osi_version_pb2

    message.version.CopyFrom(
        osi_version_pb2.DESCRIPTOR.GetOptions().Extensions[osi_version_pb2.current_interface_version]
    )


def set_timestamp(timestamp: Any, time: float) -> None:
    """Set an OSI timestamp to a time in s, rounded to ns."""
    seconds, nanos = divmod(round(time * 1e9), 1_000_000_000)
    timestamp.seconds, timestamp.nanos = seconds, nanos


def _fill_moving_object(moving: Any, number: int, entity: OsiEntity, state: OsiState) -> None:
    moving.id.value = number
    kind = entity.object_type
    name, height = _OTHER_TYPES.get(kind, _OTHER)
    if kind in _VEHICLE_TYPES:
        name, height = "TYPE_VEHICLE", _VEHICLE_TYPES[kind][1]
        classification = moving.vehicle_classification
        classification.type = (
            classification.DESCRIPTOR.enum_types_by_name["Type"].values_by_name[_VEHICLE_TYPES[kind][0]].number
        )
        # OSI's position is the centre of the box.
        moving.vehicle_attributes.bbcenter_to_rear.x = -entity.center_x
        moving.vehicle_attributes.bbcenter_to_rear.z = -0.5 * height
    if kind == "pedestrian":
        # Mandatory; the root of the skeleton is at the feet.
        root = moving.pedestrian_attributes.bbcenter_to_root
        root.x, root.z = -entity.center_x, -0.5 * height
    moving.type = moving.DESCRIPTOR.enum_types_by_name["Type"].values_by_name[name].number
    base, cos, sin = moving.base, math.cos(state.heading), math.sin(state.heading)
    base.dimension.length, base.dimension.width, base.dimension.height = entity.length, entity.width, height
    base.position.x, base.position.y = state.x + entity.center_x * cos, state.y + entity.center_x * sin
    base.position.z = 0.5 * height
    base.orientation.yaw = (state.heading + math.pi) % (2.0 * math.pi) - math.pi
    # The centre moves sideways while the vehicle turns about its rear axle.
    sideways = state.yaw_rate * entity.center_x
    base.velocity.x, base.velocity.y = state.speed * cos - sideways * sin, state.speed * sin + sideways * cos
    across = state.yaw_rate * state.speed
    along = state.acceleration - state.yaw_rate * sideways
    base.acceleration.x, base.acceleration.y = along * cos - across * sin, along * sin + across * cos
    base.orientation_rate.yaw = state.yaw_rate
    reference = moving.source_reference.add()
    reference.type = REFERENCE_TYPE
    reference.identifier.append(f"{NAME_PREFIX}{entity.name}")
