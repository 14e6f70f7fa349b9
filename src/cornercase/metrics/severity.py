"""How severe a collision is, or would be."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np

from cornercase._common.errors import InputError
from cornercase._common.typing import FloatArray
from cornercase.metrics._parts.boxes import relative_velocity, touching
from cornercase.metrics._parts.numbers import checked
from cornercase.metrics.base import Metric
from cornercase.metrics.ttc import Ttc
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
"""Mass in kg by kind, where none is given."""

_OTHERWISE = 1500.0
# Times of contacts in s that are the same but for rounding.
_ROUNDED = 1e-9


class DeltaV(Metric):
    """Change of the ego's velocity in a collision in which both stick together (plastic impact).

    ``m_other / (m + m_other) |v_other - v|`` in m/s, with the velocities as vectors at the first instant at
    which the boxes touch; the course keeps it while they touch. Not defined while they do not, so a recording
    without a collision scores the cap. Two that touch without moving give 0; a standing one is nothing
    special. Cap: 0 m/s.

    Parameters
    ----------
    masses : mapping of str to float, optional
        Masses in kg by the entity's name or kind; else those of `MASSES`, and 1,500 kg for other kinds.
    predicted : bool, default False
        Give the value of a collision with the present velocities, at each instant.

    Notes
    -----
    Source: S. G. Shelby, "Delta-V as a measure of traffic conflict severity", 3rd International Conference on
    Road Safety and Simulation (2011), with the velocities as vectors.
    """

    name = "delta-v"
    unit = "m/s"
    lower_is_critical = False
    cap = 0.0
    source = "Shelby 2011, velocities as vectors"

    def __init__(self, masses: Mapping[str, float] | None = None, predicted: bool = False) -> None:
        self.masses = _checked_masses(self.name, masses)
        self.predicted = predicted

    def course(self, recording: Recording, ego: str, other: str) -> FloatArray:
        change = _change(recording, ego, other, self.masses)
        if self.predicted:
            return change
        touch = touching(recording, ego, other)
        begins = np.where(touch & ~np.append(False, touch[:-1]), np.arange(len(touch)), 0)
        return np.where(touch, change[np.maximum.accumulate(begins)], np.nan)


class ConflictSeverity(Metric):
    """Change of the ego's velocity that evasive braking would leave of a collision ahead.

    ``[m_other / (m + m_other) (|v_other - v| - a TTC)]₊`` in m/s: `DeltaV` as predicted, less what braking by
    a until the contact takes off; the time to collision is that of `Ttc`. 0 where none is ahead; two that
    stand give 0. Not defined where one of the two does not exist. Cap: 0 m/s.

    Parameters
    ----------
    deceleration : float, default 8.0
        a in m/s².
    masses : mapping of str to float, optional
        As in `DeltaV`.

    Notes
    -----
    Source: O. Bagdadi, "Estimation of the severity of safety critical events", Accident Analysis and
    Prevention 50 (2013).
    """

    name = "conflict-severity"
    unit = "m/s"
    lower_is_critical = False
    cap = 0.0
    source = "Bagdadi 2013"

    def __init__(self, deceleration: float = 8.0, masses: Mapping[str, float] | None = None) -> None:
        checked(self.name, deceleration=deceleration)
        self.deceleration = deceleration
        self.masses = _checked_masses(self.name, masses)

    def course(self, recording: Recording, ego: str, other: str) -> FloatArray:
        change = _change(recording, ego, other, self.masses)
        time = Ttc().course(recording, ego, other)
        ahead = np.isfinite(time)
        braked = self.deceleration * np.where(ahead, time, 0.0) * _share(recording, ego, other, self.masses)
        left = np.where(ahead, np.maximum(change - braked, 0.0), 0.0)
        return np.where(np.isnan(time), np.nan, left)


def velocity_change(recording: Recording, ego: str, other: str) -> float | None:
    """Greatest change of velocity of either in a collision in which both stick together, in m/s.

    Parameters
    ----------
    recording : Recording
    ego, other : str
        Names of two entities.

    Returns
    -------
    float or None
        That of the lighter one, at the first instant of a contact; None without a contact. 0 where their velocities at
        that time are not known.
    """
    found = find_contact(recording, ego, other)
    return None if found is None else found[1]


def find_contact(recording: Recording, ego: str, other: str) -> tuple[int, float] | None:
    """Find the first instant of a contact.

    Parameters
    ----------
    recording : Recording
    ego, other : str
        Names of two entities.

    Returns
    -------
    tuple of int and float, or None
        The instant, and the change of velocity of the lighter one in m/s as of `velocity_change`; None without a
        contact.
    """
    touch = touching(recording, ego, other)
    recorded = recording.first_collision(ego, other)
    if recorded is not None:
        # Of the instant of a recorded contact on, though boxes may overlap from the next one only.
        touch[min(np.searchsorted(recording.time, recorded.time - _ROUNDED), len(touch) - 1)] = True
    if not touch.any():
        return None
    first = int(np.argmax(touch))
    size = float(np.hypot(*relative_velocity(recording, ego, other)[first]))
    share = _share(recording, ego, other, {})
    return first, (max(share, 1.0 - share) * size if np.isfinite(size) else 0.0)


def _change(recording: Recording, ego: str, other: str, masses: Mapping[str, float]) -> FloatArray:
    gap = relative_velocity(recording, ego, other)
    change: FloatArray = _share(recording, ego, other, masses) * np.hypot(gap[:, 0], gap[:, 1])
    return change


def _share(recording: Recording, ego: str, other: str, masses: Mapping[str, float]) -> float:
    mine, others = (_mass(recording, name, masses) for name in (ego, other))
    return others / (mine + others)


def _mass(recording: Recording, name: str, masses: Mapping[str, float]) -> float:
    kind = recording.kinds[recording.index(name)].lower()
    return masses.get(name, masses.get(kind, MASSES.get(kind, _OTHERWISE)))


def _checked_masses(metric: str, masses: Mapping[str, float] | None) -> dict[str, float]:
    for name, mass in (masses or {}).items():
        if not 0.0 < mass < np.inf:
            raise InputError(f"{metric} cannot take a mass of {mass} kg for '{name}'; give one above 0.")
    return dict(masses or {})
