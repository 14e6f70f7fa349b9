"""Fusion of the sensors of an entity into the situation that the driver of the entity is given."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from cornercase._common.typing import FloatArray
from cornercase.drivers._base import Situation
from cornercase.drivers._driving_function import Start
from cornercase.drivers.sensors._sensor import Sensor

# Length, width and centre of the box of a false object in m.
_FALSE_BOX: Final = (4.0, 1.8, 0.0)
_FALSE_TYPE: Final = "car"
_FIELDS: Final = ("x", "y", "heading", "speed", "measured_at")


class SensorFusion:
    """Fusion of the sensors of one entity: an object is known if at least one sensor knows the object.

    For each object, the newest measurement is used. If several are equally new, the sensor that is listed first counts.
    """

    def __init__(self, sensors: Sequence[Sensor]) -> None:
        self._sensors = tuple(sensors)

    def __len__(self) -> int:
        return len(self._sensors)

    def start(self, start: Start, parameters: Sequence[Mapping[str, FloatArray]] = ()) -> Start:
        """Reset the sensors for a batch; return `start` with the names of false objects appended to `start.others`.

        The driver is started with the result.

        `parameters` are the `Start.parameters` of each sensor; by default all sensors are given `start.parameters`.
        """
        own_parameters = parameters or [start.parameters] * len(self._sensors)
        self._false_names: tuple[str, ...] = ()
        for sensor, label, own in zip(self._sensors, _label_sensors(self._sensors), own_parameters, strict=True):
            sensor.start(replace(start, parameters=own), label)
            self._false_names += tuple(f"false object {k + 1} of {label}" for k in range(sensor.false_objects))
        return replace(start, others=start.others + self._false_names)

    def perceive(self, situation: Situation) -> Situation:
        """Return the situation as known by the sensors; false objects are appended to the other entities."""
        if not self._sensors:
            return situation
        n_others, sensed = situation.others_x.shape[1], [sensor.perceive(situation) for sensor in self._sensors]
        stacked = np.stack([[getattr(item, name)[:, :n_others] for name in _FIELDS] for item in sensed])
        measured_at = np.where(np.isnan(stacked[:, 0]), -np.inf, stacked[:, -1])
        newest = measured_at.argmax(axis=0)[None, None]
        fused = np.take_along_axis(stacked, newest, axis=0)[0]
        false = np.concatenate([[getattr(item, name)[:, n_others:] for name in _FIELDS] for item in sensed], axis=2)
        x, y, heading, speed, _ = np.concatenate([fused, false], axis=2)
        n_false = len(self._false_names)
        return replace(
            situation,
            others_x=x,
            others_y=y,
            others_heading=heading,
            others_speed=speed,
            others_length=_append(situation.others_length, _FALSE_BOX[0], n_false),
            others_width=_append(situation.others_width, _FALSE_BOX[1], n_false),
            others_center_x=_append(situation.others_center_x, _FALSE_BOX[2], n_false),
            others_object_type=situation.others_object_type + (_FALSE_TYPE,) * n_false,
            others_name=situation.others_name + self._false_names,
        )


def _append(values: FloatArray, value: float, count: int) -> FloatArray:
    return np.concatenate([values, np.full(count, value)])


def _label_sensors(sensors: Sequence[Sensor]) -> list[str]:
    """Return a name for each sensor, such as ``"radar"``, and ``"radar 2"`` for a second radar."""
    seen, labels = Counter[str](), list[str]()
    for sensor in sensors:
        kind = sensor.name.partition(":")[0] or type(sensor).__name__
        seen[kind] += 1
        labels.append(f"{kind} {seen[kind]}" if seen[kind] > 1 else kind)
    return labels
