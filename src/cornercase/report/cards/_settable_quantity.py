"""Units of varied parameters, and the steps in which a proving ground can set their values."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Final

from cornercase.scenario import Parameter
from cornercase.scenario._file import ScenarioFile
from cornercase.scenario._quantities import QUANTITIES

KMH_PER_MS: Final = 3.6

# Speeds with a narrower range than this, in km/h, get a finer step; for example the lateral speed of a lane change.
_NARROW_SPEED_RANGE: Final = 5.0
_NAME_UNITS: Final = {
    "kph": "km/h", "kmh": "km/h", "kmph": "km/h", "mps": "m/s", "m": "m", "s": "s", "deg": "°", "rad": "rad",
}  # fmt: skip
_SPEED_UNITS: Final = {"m/s": KMH_PER_MS, "km/h": 1.0}
_STEPS: Final = {"m": 0.1, "s": 0.1, "°": 1.0, "rad": 0.01, "m/s²": 0.1, "m/s^2": 0.1, "%": 1.0}


@dataclass(frozen=True)
class SettableQuantity:
    """Unit of a parameter, and the step to which a proving ground can set its values.

    `unit` is empty if the unit is unknown. `step` is in this unit. If `step` is None, values are not rounded, and
    `note` says why. `is_narrow_speed` is True for speeds whose range is narrower than 5 km/h; their step is finer.
    """

    unit: str
    step: float | None
    note: str = ""
    is_narrow_speed: bool = False

    @property
    def is_speed(self) -> bool:
        """True if values are speeds."""
        return self.unit in _SPEED_UNITS

    def to_kmh(self, value: float) -> float:
        """Convert a speed from the unit of this quantity to km/h."""
        return value * _SPEED_UNITS[self.unit]


def find_settable_quantity(parameter: Parameter, scenario: ScenarioFile | None) -> SettableQuantity:
    """Find the unit of a parameter, and the step to which its values can be set.

    The unit is the first that is known: the parameter's own, the unit of the scenario's attributes that use the
    parameter, or the ending of its name, such as ``_kph``.
    """
    if parameter.choices:
        return SettableQuantity(parameter.unit, None, "a choice")
    unit = parameter.unit or _unit_in_scenario(parameter.name, scenario) or _unit_in_name(parameter.name)
    if parameter.is_integer:
        return SettableQuantity(unit, None, "a whole number")
    if unit in _SPEED_UNITS:
        kmh = _SPEED_UNITS[unit]
        is_narrow = (parameter.high - parameter.low) * kmh < _NARROW_SPEED_RANGE
        return SettableQuantity(unit, (0.1 if is_narrow else 1.0) / kmh, is_narrow_speed=is_narrow)
    if unit in _STEPS:
        return SettableQuantity(unit, _STEPS[unit])
    return SettableQuantity(unit, None, f"no step is known for {unit}" if unit else "its unit is not known")


def _unit_in_scenario(name: str, scenario: ScenarioFile | None) -> str:
    """Return the unit of the attributes that are set to ``$name``; empty if there are none, or several units."""
    if scenario is None:
        return ""
    units = {
        QUANTITIES[str(element.tag)][attribute][1].unit
        for element in scenario.root.iter(*QUANTITIES)
        for attribute in QUANTITIES[str(element.tag)]
        if (element.get(attribute) or "").strip() == f"${name}"
    }
    return units.pop() if len(units) == 1 else ""


def _unit_in_name(name: str) -> str:
    ending = re.search(r"_([A-Za-z]+)$", name)
    return "" if ending is None else _NAME_UNITS.get(ending[1].lower(), "")
