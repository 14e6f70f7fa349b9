"""What the sensors of an entity know together, as the situation that its driver is given."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from cornercase._common.typing import FloatArray
from cornercase.drivers._base import Situation
from cornercase.drivers._function import Start
from cornercase.drivers.sensors._sensor import Sensor

# Length, width and centre of the box of a false object in m.
_FALSE_BOX: Final = (4.0, 1.8, 0.0)
_FALSE_TYPE: Final = "car"
_FIELDS: Final = ("x", "y", "heading", "speed", "measured_at")


class SensorFusion:
    """Sensors of one entity: an object is known if one of them knows it.

    The newest measurement counts; of measurements at the same time, that of the sensor listed first.
    """

    def __init__(self, sensors: Sequence[Sensor]) -> None:
        self._sensors = tuple(sensors)

    def __len__(self) -> int:
        return len(self._sensors)

    def start(self, start: Start, parameters: Sequence[Mapping[str, FloatArray]] = ()) -> Start:
        """Reset the sensors for a batch; return what the driver is told of it, with the names of false objects.

        `parameters` are those of each sensor, as in `Start`; by default none.
        """
        given = parameters or ({},) * len(self._sensors)
        self._false_names: tuple[str, ...] = ()
        for sensor, label, own in zip(self._sensors, _label_sensors(self._sensors), given, strict=True):
            sensor.start(replace(start, parameters=own), label)
            self._false_names += tuple(f"false object {k + 1} of {label}" for k in range(sensor.false_objects))
        return replace(start, others=start.others + self._false_names)

    def perceive(self, situation: Situation) -> Situation:
        """Return the situation as sensed; false objects are appended to the others."""
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
    """Return a name for each sensor; several of a kind are numbered."""
    seen, labels = Counter[str](), list[str]()
    for sensor in sensors:
        kind = sensor.name.partition(":")[0] or type(sensor).__name__
        seen[kind] += 1
        labels.append(f"{kind} {seen[kind]}" if seen[kind] > 1 else kind)
    return labels
