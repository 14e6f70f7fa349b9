"""Features of a recording: what happened in a run, in numbers that say more of it than its score."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import ClassVar, Final

import numpy as np

from cornercase._common.errors import InputError
from cornercase._common.parts import guarded
from cornercase._common.registry import Registry
from cornercase._common.typing import FloatArray, IntArray
from cornercase.metrics._parts.meeting import FAR, Meeting
from cornercase.metrics.others import nearest_other
from cornercase.recordings import Recording

_TURNS: Final = 1e-3
"""Turn rate in rad/s up to which a heading is straight."""

_BEGUN: Final = 0.05
"""Change of heading in rad from which a turn has begun."""

_WITHIN: Final = 40.0
"""Distance of the centres in m at which the other is taken to approach."""

_BRAKES: Final = 0.1
"""Deceleration in m/s² up to which nobody brakes, and the share of the strongest one that is still taken for it."""
_STRONG: Final = 0.9


@dataclass(frozen=True)
class Feature:
    """One number that says what happened in a run.

    Attributes
    ----------
    name : str
    unit : str
        ``"1"`` for none.
    branch : bool, default False
        Whether it tells one way in which a scenario can go from another by being above 0 or not, such as who goes
        first. Scores jump from one way to the other, so a search asks where that is uncertain.
    """

    name: str
    unit: str
    branch: bool = False


class FeatureGroup(ABC):
    """Features that are computed together, of the ego and one other entity.

    A subclass names itself, lists its features and defines `values`.

    Attributes
    ----------
    name : str
    features : tuple of Feature

    See Also
    --------
    cornercase.metrics.FEATURES : Groups of features by name, also those of other packages.

    Examples
    --------
    >>> import numpy as np
    >>> from cornercase.metrics import Feature, FeatureGroup
    >>> class HardBraking(FeatureGroup):
    ...
    ...     name = "hard-braking"
    ...     features = (Feature("strongest-braking", "m/s²"),)
    ...
    ...     def values(self, meeting):
    ...         course = meeting.recording.acceleration[meeting.recording.index(meeting.ego)]
    ...         return np.array([np.nanmin(course, initial=0.0)])
    """

    name: ClassVar[str]
    features: ClassVar[tuple[Feature, ...]]

    @abstractmethod
    def values(self, meeting: Meeting) -> FloatArray:
        """Compute the features of a recording.

        Parameters
        ----------
        meeting : Meeting
            The recording and both entities, with what several features need of them.

        Returns
        -------
        ndarray of float64, shape (f,)
            Finite: where something never happens a feature has a value that says so.
        """


class NearestApproach(FeatureGroup):
    """The first instant at which the boxes of both are nearest to each other.

    ``least-clearance``: the gap between the boxes. ``nearest-time``: since the recording began. ``nearest-ahead``,
    ``nearest-left``: place of the other's centre, seen from the ego's. ``nearest-cos``, ``nearest-sin``: of the
    other's heading, seen from the ego's. ``nearest-ego-speed``, ``nearest-other-speed``. ``nearest-way``: how far
    the ego has driven until then.

    Where the two are never there at once: 100 m of clearance, the other 100 m ahead in the same direction, both at a
    speed of 0, at the end of the recording and of the ego's way.
    """

    name = "nearest-approach"
    features = (
        Feature("least-clearance", "m"),
        Feature("nearest-time", "s"),
        Feature("nearest-ahead", "m"),
        Feature("nearest-left", "m"),
        Feature("nearest-cos", "1"),
        Feature("nearest-sin", "1"),
        Feature("nearest-ego-speed", "m/s"),
        Feature("nearest-other-speed", "m/s"),
        Feature("nearest-way", "m"),
    )

    def values(self, meeting: Meeting) -> FloatArray:
        k, clearance = meeting.nearest
        if k is None:
            return np.array([FAR, meeting.duration, FAR, 0.0, 1.0, 0.0, 0.0, 0.0, meeting.way_until(None)])
        one, ego, other = meeting.recording, meeting.ego_row, meeting.other_row
        heading = one.heading[ego, k]
        ahead, left, speed = meeting.other_from(k)
        turned = one.heading[other, k] - heading
        return np.array(
            [
                clearance, meeting.since_begin(k), ahead, left, np.cos(turned), np.sin(turned),
                one.speed[ego, k], speed, meeting.way_until(k),
            ]
        )  # fmt: skip


class Approach(FeatureGroup):
    """The first instant at which the centres of both are within 40 m, or where they never are, at their nearest.

    ``approach-time``: since the recording began. ``approach-ahead``: how far ahead the other is, seen from the ego.
    ``approach-other-speed``. What is so before either reacts follows the parameters smoothly, where what comes of it
    jumps. Where the two are never there at once: the end, 100 m and 0 m/s.
    """

    name = "approach"
    features = (Feature("approach-time", "s"), Feature("approach-ahead", "m"), Feature("approach-other-speed", "m/s"))

    def values(self, meeting: Meeting) -> FloatArray:
        both = meeting.both_there
        if not len(both):
            return np.array([meeting.duration, FAR, 0.0])
        apart = np.hypot(*(meeting.other_center[both] - meeting.ego_center[both]).T)
        within = apart < _WITHIN
        k = int(both[np.argmax(within) if within.any() else np.argmin(apart)])
        ahead, _, speed = meeting.other_from(k)
        return np.array([meeting.since_begin(k), ahead, speed])


class Braking(FeatureGroup):
    """The first instant at which the ego decelerates with nine tenths of its strongest deceleration or more.

    ``braking-way``: how far the ego has driven until then. ``braking-speed``: of the ego then. Where it never brakes by
    more than 0.1 m/s², those of the end; both are 0 where it is never there.
    """

    name = "braking"
    features = (Feature("braking-way", "m"), Feature("braking-speed", "m/s"))

    def values(self, meeting: Meeting) -> FloatArray:
        if not len(meeting.ego_there):
            return np.zeros(2)
        k = _strongest_braking(meeting.recording.acceleration[meeting.ego_row], meeting.ego_there)
        return np.array([meeting.way_until(k), meeting.recording.speed[meeting.ego_row, k]])


class Other(FeatureGroup):
    """What the other does, wherever the ego is.

    ``other-highest-speed``: of the other, forwards or backwards. ``other-highest-speed-time``: the first instant with
    it, since the recording began. ``other-braking-way``: how far the other has driven until it brakes hardest, as of
    the ego in `Braking`. All are 0 where it is never there.
    """

    name = "other"
    features = (
        Feature("other-highest-speed", "m/s"),
        Feature("other-highest-speed-time", "s"),
        Feature("other-braking-way", "m"),
    )

    def values(self, meeting: Meeting) -> FloatArray:
        one, there = meeting.recording, meeting.other_there
        if not len(there):
            return np.zeros(3)
        speeds = np.abs(one.speed[meeting.other_row, there])
        k = int(np.argmax(speeds))
        braking = _strongest_braking(one.acceleration[meeting.other_row], there)
        steps = np.diff(meeting.other_center[there[there <= braking]], axis=0)
        return np.array([speeds[k], meeting.since_begin(int(there[k])), np.hypot(steps[:, 0], steps[:, 1]).sum()])


class Crossing(FeatureGroup):
    """Where the ways of both come nearest to each other, whenever each is there.

    ``crossing-distance``: of the centres' ways. ``crossing-gap``: how much later than the other the ego is there;
    above 0 where the other is first, which is a way in which a scenario can go. Of places that are alike the one
    counts that both pass with the least time between them: 1 s counts as much as 0.1 m.

    Where one of the two is never there: 100 m and 0 s.
    """

    name = "crossing"
    features = (Feature("crossing-distance", "m"), Feature("crossing-gap", "s", branch=True))

    def values(self, meeting: Meeting) -> FloatArray:
        return np.array(meeting.crossing)


class Slowest(FeatureGroup):
    """The first instant at which the ego is slowest.

    ``lowest-speed``: of the ego, forwards or backwards. ``lowest-speed-time``: since the recording began.
    ``lowest-speed-way``: how far the ego has driven until then. All are 0 where it is never there.
    ``lowest-speed-ahead``, ``lowest-speed-left``: place of the other's centre then, seen from the ego's.
    ``lowest-speed-other-speed``. Where one of the two is not there: 100 m ahead, at a speed of 0.
    """

    name = "slowest"
    features = (
        Feature("lowest-speed", "m/s"),
        Feature("lowest-speed-time", "s"),
        Feature("lowest-speed-way", "m"),
        Feature("lowest-speed-ahead", "m"),
        Feature("lowest-speed-left", "m"),
        Feature("lowest-speed-other-speed", "m/s"),
    )

    def values(self, meeting: Meeting) -> FloatArray:
        one, there = meeting.recording, meeting.ego_there
        if not len(there):
            return np.array([0.0, 0.0, 0.0, FAR, 0.0, 0.0])
        speeds = np.abs(one.speed[meeting.ego_row, there])
        lowest = int(np.argmin(speeds))
        k = int(there[lowest])
        return np.array([speeds[lowest], meeting.since_begin(k), meeting.way_until(k), *meeting.other_from(k)])


class Turn(FeatureGroup):
    """How the ego's heading changes: the first instant at which it does so fastest, and the one at which it begins.

    ``turn-time``: of the fastest change, since the recording began. ``turn-way``: how far the ego has driven until
    then. Both are 0 where it never turns by more than 0.001 rad/s.

    ``turn-begin-left``: how far left the other's centre is, seen from the ego's, where the heading first differs by
    more than 0.05 rad from that at the begin, or at the end where it never does. ``turn-begin-other-speed``. Both are 0
    where one of the two is not there.
    """

    name = "turn"
    features = (
        Feature("turn-time", "s"),
        Feature("turn-way", "m"),
        Feature("turn-begin-left", "m"),
        Feature("turn-begin-other-speed", "m/s"),
    )

    def values(self, meeting: Meeting) -> FloatArray:
        one, there = meeting.recording, meeting.ego_there
        if len(there) < 2:
            return np.zeros(4)
        heading = one.heading[meeting.ego_row, there]
        begun = _between(heading, heading[0]) > _BEGUN
        _, left, speed = meeting.other_from(int(there[np.argmax(begun) if begun.any() else -1]))
        rates = _between(heading[1:], heading[:-1]) / np.diff(one.time[there])
        k = int(np.argmax(rates))
        if not rates[k] > _TURNS:
            return np.array([0.0, 0.0, left, speed])
        return np.array([meeting.since_begin(int(there[k + 1])), meeting.way_until(int(there[k + 1])), left, speed])


class Whole(FeatureGroup):
    """The recording as a whole.

    ``duration``: from its first to its last instant. ``way``: how far the ego drives. ``contact``: 1 where the boxes
    of both touch or their collision is recorded, else 0; whether they do is a way in which a scenario can go.
    """

    name = "whole"
    features = (Feature("duration", "s"), Feature("way", "m"), Feature("contact", "1", branch=True))

    def values(self, meeting: Meeting) -> FloatArray:
        recorded = meeting.recording.first_collision(meeting.ego, meeting.other)
        touched = meeting.nearest[1] == 0.0 or recorded is not None
        return np.array([meeting.duration, meeting.way_until(None), float(touched)])


def _strongest_braking(accelerations: FloatArray, there: IntArray) -> int:
    """First of some instants at which somebody all but brakes hardest; the last one where nobody brakes."""
    braking = np.nan_to_num(-accelerations[there])
    strongest = float(braking.max())
    return int(there[np.argmax(braking >= _STRONG * strongest) if strongest > _BRAKES else -1])


def _between(headings: FloatArray, others: FloatArray | float) -> FloatArray:
    """Angles between headings, the shortest way round."""
    turned = np.abs(headings - others)
    return np.asarray(np.minimum(turned, np.abs(2.0 * np.pi - turned)))


FEATURES: Final[Registry[FeatureGroup]] = Registry("group of features", "cornercase.features", FeatureGroup)
"""Groups of features by name; other packages add subclasses of `FeatureGroup` through this entry-point group."""

for _one in (NearestApproach, Approach, Braking, Crossing, Other, Slowest, Turn, Whole):
    FEATURES.register(_one.name, _one)


def known_features() -> tuple[Feature, ...]:
    """All features that are registered.

    Returns
    -------
    tuple of Feature
        By the names of their groups, in alphabetical order; those of one group as it has them.
    """
    return tuple(feature for group in _groups() for feature in group.features)


def features_of(recordings: Iterable[Recording | None], ego: str, other: str | Sequence[str]) -> FloatArray:
    """Compute what happened in recordings.

    Parameters
    ----------
    recordings : iterable of Recording or None
        None for a scenario that failed.
    ego : str
        Name of an entity.
    other : str or sequence of str
        Names of one or several others. Of several, the features are of the one that the ego collides with first in a
        recording, else of the one whose box comes nearest to the ego's.

    Returns
    -------
    ndarray of float64, shape (n, f)
        The `known_features` of each, in their order; NaN for a scenario that failed.

    Raises
    ------
    InputError
        There is no entity of that name, or a group of another package does not give what it says.
    """
    groups = _groups()
    count = sum(len(group.features) for group in groups)
    rows = [np.full(count, np.nan) if one is None else _row(groups, one, ego, other) for one in recordings]
    return np.array(rows).reshape(len(rows), count)


def _groups() -> list[FeatureGroup]:
    return [FEATURES.create(name) for name in FEATURES.names()]


def _row(groups: list[FeatureGroup], recording: Recording, ego: str, other: str | Sequence[str]) -> FloatArray:
    meeting = Meeting(recording, ego, nearest_other(recording, ego, other))
    return np.concatenate([_checked(group, meeting) for group in groups])


def _checked(group: FeatureGroup, meeting: Meeting) -> FloatArray:
    with guarded(f"The group of features '{group.name}'", group):
        values = np.asarray(group.values(meeting), dtype=np.float64)
    if values.shape != (len(group.features),) or not np.isfinite(values).all():
        raise InputError(
            f"The group of features '{group.name}' gives {values.tolist()}; it has to give a finite number for each of"
            f" its {len(group.features)} features."
        )
    return values
