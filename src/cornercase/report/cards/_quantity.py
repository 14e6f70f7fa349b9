"""What a varied parameter measures, and the steps in which a proving ground can set it."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Final

from cornercase.scenario import Parameter
from cornercase.scenario._file import ScenarioFile
from cornercase.scenario._quantities import QUANTITIES

KMH_PER_MS: Final = 3.6

# Speeds that vary by less than this, such as those of a lane change, are set more finely; in km/h.
_NARROW_SPEED_RANGE: Final = 5.0
_NAME_UNITS: Final = {
    "kph": "km/h", "kmh": "km/h", "kmph": "km/h", "mps": "m/s", "m": "m", "s": "s", "deg": "°", "rad": "rad",
}  # fmt: skip
_SPEED_UNITS: Final = {"m/s": KMH_PER_MS, "km/h": 1.0}
_STEPS: Final = {"m": 0.1, "s": 0.1, "°": 1.0, "rad": 0.01, "m/s²": 0.1, "m/s^2": 0.1, "%": 1.0}


@dataclass(frozen=True)
class SettableQuantity:
    """What a parameter measures, and in which steps it can be set.

    `unit` is empty if it is unknown. `step` is None if values are not rounded, and `note` says why. `is_narrow_speed`
    says that values are speeds that vary little, as those of a lane change, and are set more finely.
    """

    unit: str
    step: float | None
    note: str = ""
    is_narrow_speed: bool = False

    @property
    def is_speed(self) -> bool:
        """Whether values are speeds."""
        return self.unit in _SPEED_UNITS

    def to_kmh(self, value: float) -> float:
        """Return a speed in km/h."""
        return value * _SPEED_UNITS[self.unit]


def find_settable_quantity(parameter: Parameter, scenario: ScenarioFile | None) -> SettableQuantity:
    """Find what a parameter measures: by its unit, by where the scenario uses it, or by the end of its name."""
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
    """Return the unit of the attributes that are set to the parameter itself; empty if there are none, or several."""
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
