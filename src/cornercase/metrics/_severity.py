"""Metrics of the severity of a collision that happened or is predicted."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np

from cornercase._common.errors import InputError
from cornercase._common.typing import FloatArray
from cornercase.metrics._base import Metric
from cornercase.metrics._geometry.boxes import boxes_touch_over_time, relative_velocity
from cornercase.metrics._geometry.numeric import check_nonnegative_options
from cornercase.metrics._ttc import Ttc
from cornercase.recordings import Recording

MASSES: Mapping[str, float] = MappingProxyType(
    {
        "car": 1500.0,
        "van": 2500.0,
        "truck": 12000.0,
        "semitrailer": 12000.0,
        "trailer": 1000.0,
        "bus": 12000.0,
        "tram": 40000.0,
        "train": 200000.0,
        "motorbike": 250.0,
        "bicycle": 90.0,
        "pedestrian": 75.0,
        "wheelchair": 150.0,
        "animal": 75.0,
    }
)
"""Default mass in kg by type of entity."""

_DEFAULT_MASS = 1500.0
_TIME_TOLERANCE = 1e-9  # s


class DeltaV(Metric):
    """Change of the ego's velocity in a collision in which both stick together (plastic impact).

    ``m_other / (m + m_other) |v_other - v|`` in m/s, with the masses m of the ego and m_other of the other entity, and
    with the velocities v and v_other as vectors at the first instant at which the boxes touch. The course keeps this
    value while the boxes touch, and is not defined otherwise. So a recording without a collision scores the cap. A
    contact without motion gives 0. Least critical value (cap): 0 m/s.

    Source: S. G. Shelby, "Delta-V as a measure of traffic conflict severity", 3rd International Conference on Road
    Safety and Simulation (2011), with the velocities as vectors.

    Parameters
    ----------
    masses : mapping of str to float, optional
        Masses in kg by name or type of the entity. By default, a typical mass of the type, such as 75 kg for a
        pedestrian, and 1,500 kg for a car or an unknown type.
    predicted : bool, default False
        Give at each instant the value that a collision with the present velocities would have.

    Examples
    --------
    >>> import cornercase as cc
    >>> recording = cc.simulate("examples/r157/cut_in.xosc")
    >>> cc.measure(recording, "Ego", "Other", [cc.metrics.DeltaV()])
    metric   score  unit  critical is
    delta-v  4.945  m/s   high
    """

    name = "delta-v"
    unit = "m/s"
    lower_is_critical = False
    cap = 0.0
    source = "Shelby 2011, velocities as vectors"

    def __init__(self, masses: Mapping[str, float] | None = None, predicted: bool = False) -> None:
        self.masses = _validate_masses(self.name, masses)
        self.predicted = predicted

    def course(self, recording: Recording, ego: str, other: str) -> FloatArray:
        change = _ego_velocity_change(recording, ego, other, self.masses)
        if self.predicted:
            return change
        touch = boxes_touch_over_time(recording, ego, other)
        begins = np.where(touch & ~np.append(False, touch[:-1]), np.arange(len(touch)), 0)
        return np.where(touch, change[np.maximum.accumulate(begins)], np.nan)


class ConflictSeverity(Metric):
    """Change of the ego's velocity in a predicted collision, after evasive braking.

    ``[m_other / (m + m_other) (|v_other - v| - a TTC)]₊`` in m/s: the predicted `DeltaV` if the ego brakes with the
    deceleration a until the contact. m and m_other are the masses, v and v_other the velocities of the ego and the
    other entity. TTC is the time to collision (`Ttc`). The value is 0 if no collision is predicted, or both stand. Not
    defined if one of the two does not exist. Least critical value (cap): 0 m/s.

    Source: O. Bagdadi, "Estimation of the severity of safety critical events", Accident Analysis and Prevention 50
    (2013).

    Parameters
    ----------
    deceleration : float, default 8.0
        Deceleration a in m/s².
    masses : mapping of str to float, optional
        As in `DeltaV`.

    Examples
    --------
    >>> import cornercase as cc
    >>> recording = cc.simulate("examples/r157/cut_in.xosc")
    >>> cc.measure(recording, "Ego", "Other", [cc.metrics.ConflictSeverity()])
    metric             score  unit  critical is
    conflict-severity  4.945  m/s   high
    """

    name = "conflict-severity"
    unit = "m/s"
    lower_is_critical = False
    cap = 0.0
    source = "Bagdadi 2013"

    def __init__(self, deceleration: float = 8.0, masses: Mapping[str, float] | None = None) -> None:
        check_nonnegative_options(self.name, deceleration=deceleration)
        self.deceleration = deceleration
        self.masses = _validate_masses(self.name, masses)

    def course(self, recording: Recording, ego: str, other: str) -> FloatArray:
        change = _ego_velocity_change(recording, ego, other, self.masses)
        time = Ttc().course(recording, ego, other)
        is_predicted = np.isfinite(time)
        reduction = (
            self.deceleration
            * np.where(is_predicted, time, 0.0)
            * _ego_fraction_of_change(recording, ego, other, self.masses)
        )
        remaining = np.where(is_predicted, np.maximum(change - reduction, 0.0), 0.0)
        return np.where(np.isnan(time), np.nan, remaining)


def find_first_contact(recording: Recording, ego: str, other: str) -> tuple[int, float] | None:
    """Return the first instant of a contact, and the velocity change of the lighter entity in m/s.

    None without a contact. The velocity change is computed for a plastic impact, in which both stick together. It is 0
    if the velocities at the contact are unknown.
    """
    touch = boxes_touch_over_time(recording, ego, other)
    recorded = recording.first_collision(ego, other)
    if recorded is not None:
        # A recorded contact counts from its own instant, even if boxes overlap only from the next one.
        touch[min(np.searchsorted(recording.time, recorded.time - _TIME_TOLERANCE), len(touch) - 1)] = True
    if not touch.any():
        return None
    first = int(np.argmax(touch))
    speed = float(np.hypot(*relative_velocity(recording, ego, other)[first]))
    share = _ego_fraction_of_change(recording, ego, other, {})
    return first, (max(share, 1.0 - share) * speed if np.isfinite(speed) else 0.0)


def _ego_velocity_change(recording: Recording, ego: str, other: str, masses: Mapping[str, float]) -> FloatArray:
    velocity = relative_velocity(recording, ego, other)
    change: FloatArray = _ego_fraction_of_change(recording, ego, other, masses) * np.hypot(
        velocity[:, 0], velocity[:, 1]
    )
    return change


def _ego_fraction_of_change(recording: Recording, ego: str, other: str, masses: Mapping[str, float]) -> float:
    ego_mass, other_mass = (_mass_of_entity(recording, name, masses) for name in (ego, other))
    return other_mass / (ego_mass + other_mass)


def _mass_of_entity(recording: Recording, name: str, masses: Mapping[str, float]) -> float:
    object_type = recording.object_types[recording.entity_index(name)].lower()
    return masses.get(name, masses.get(object_type, MASSES.get(object_type, _DEFAULT_MASS)))


def _validate_masses(metric: str, masses: Mapping[str, float] | None) -> dict[str, float]:
    for name, mass in (masses or {}).items():
        if not 0.0 < mass < np.inf:
            raise InputError(f"{metric} cannot take a mass of {mass} kg for '{name}'; give a number above 0.")
    return dict(masses or {})
