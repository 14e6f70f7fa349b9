"""Features of a recording: numbers that describe what happened in a run in more detail than the score."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import ClassVar, Final

import numpy as np

from cornercase._common.errors import InputError
from cornercase._common.plugin_errors import convert_plugin_errors
from cornercase._common.registry import Registry
from cornercase._common.typing import FloatArray, IntArray
from cornercase.metrics._geometry.encounter import NEVER_MET_DISTANCE, Encounter
from cornercase.metrics._other_entities import nearest_other
from cornercase.recordings import Recording

_STRAIGHT: Final = 1e-3  # turn rate in rad/s up to which the ego drives straight
_TURN_STARTED: Final = 0.05  # change of heading in rad from which a turn has started
_APPROACH: Final = 40.0  # distance of the centres in m from which the other approaches
_MIN_BRAKING: Final = 0.1  # deceleration in m/s² up to which an entity does not brake
_STRONG: Final = 0.9  # fraction of the strongest deceleration from which an entity counts as braking hardest


@dataclass(frozen=True)
class Feature:
    """One number that describes what happened in a run.

    Attributes
    ----------
    name : str
    unit : str
        ``"1"`` for none.
    branch : bool, default False
        True if the sign of the feature distinguishes two ways in which a scenario can develop, such as who goes first.
        Scores jump between these two branches, so searches sample scenarios whose branch is uncertain.

    Examples
    --------
    >>> from cornercase.metrics import Feature
    >>> Feature("crossing-gap", "s", branch=True)
    Feature(name='crossing-gap', unit='s', branch=True)
    """

    name: str
    unit: str
    branch: bool = False


class FeatureGroup(ABC):
    """Group of features of the ego and one other entity that are computed together.

    A subclass sets its name, lists its features and defines `values`.

    Attributes
    ----------
    name : str
    features : tuple of Feature

    See Also
    --------
    cornercase.metrics.FEATURES : Groups of features by name, including those of other packages.

    Examples
    --------
    >>> import numpy as np
    >>> from cornercase.metrics import Feature, FeatureGroup
    >>> class HardBraking(FeatureGroup):
    ...
    ...     name = "hard-braking"
    ...     features = (Feature("strongest-braking", "m/s²"),)
    ...
    ...     def values(self, encounter):
    ...         course = encounter.recording.acceleration[encounter.recording.entity_index(encounter.ego)]
    ...         return np.array([np.nanmin(course, initial=0.0)])
    """

    name: ClassVar[str]
    features: ClassVar[tuple[Feature, ...]]

    @abstractmethod
    def values(self, encounter: Encounter) -> FloatArray:
        """Compute the features of a recording.

        Parameters
        ----------
        encounter : Encounter
            The recording and both entities, with quantities that several features need.

        Returns
        -------
        ndarray of float64, shape (f,)
            Values of the f features, all finite. If something never happens, its feature has a value that stands for
            this.
        """


# docs/metrics.md describes each feature, and its value if something never happens.
class NearestApproach(FeatureGroup):
    """State at the first instant at which the boxes of the ego and the other entity are nearest to each other.

    ``nearest-ahead`` and ``nearest-left`` say how far the other entity is ahead of the ego and to the left of the ego.
    ``nearest-cos`` and ``nearest-sin`` are cosine and sine of the heading of the other entity relative to the ego's.
    ``nearest-way`` is the distance that the ego has driven until this instant. If both entities never exist at the same
    time, ``least-clearance`` is 100 m.
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

    def values(self, encounter: Encounter) -> FloatArray:
        k, clearance = encounter.closest_instant_and_gap
        if k is None:
            return np.array(
                [
                    NEVER_MET_DISTANCE,
                    encounter.duration,
                    NEVER_MET_DISTANCE,
                    0.0,
                    1.0,
                    0.0,
                    0.0,
                    0.0,
                    encounter.distance_driven_until(None),
                ]
            )
        recording, ego, other = encounter.recording, encounter.ego_row, encounter.other_row
        ahead, left, speed = encounter.other_relative_to_ego(k)
        angle = recording.heading[other, k] - recording.heading[ego, k]
        return np.array(
            [
                clearance, encounter.time_since_start(k), ahead, left, np.cos(angle), np.sin(angle),
                recording.speed[ego, k], speed, encounter.distance_driven_until(k),
            ]
        )  # fmt: skip


class Approach(FeatureGroup):
    """State at the first instant at which the centres are less than 40 m apart, else when they are nearest.

    At this instant, the entities have usually not reacted to each other yet. So the state changes smoothly with the
    parameters of the scenario, whereas a reaction can start or be absent after a small change of a parameter.
    """

    name = "approach"
    features = (Feature("approach-time", "s"), Feature("approach-ahead", "m"), Feature("approach-other-speed", "m/s"))

    def values(self, encounter: Encounter) -> FloatArray:
        both = encounter.common_instants
        if not len(both):
            return np.array([encounter.duration, NEVER_MET_DISTANCE, 0.0])
        distance = np.hypot(*(encounter.other_center[both] - encounter.ego_center[both]).T)
        is_near = distance < _APPROACH
        k = int(both[np.argmax(is_near) if is_near.any() else np.argmin(distance)])
        ahead, _, speed = encounter.other_relative_to_ego(k)
        return np.array([encounter.time_since_start(k), ahead, speed])


class EgoBraking(FeatureGroup):
    """State of the ego when it first brakes with nine tenths of its strongest deceleration.

    If the ego never brakes, the features are its state at the last instant.
    """

    name = "braking"
    features = (Feature("braking-way", "m"), Feature("braking-speed", "m/s"))

    def values(self, encounter: Encounter) -> FloatArray:
        if not len(encounter.ego_instants):
            return np.zeros(2)
        k = _instant_of_strongest_braking(encounter.recording, encounter.ego_row, encounter.ego_instants)
        return np.array([encounter.distance_driven_until(k), abs(encounter.recording.speed[encounter.ego_row, k])])


class OtherMotion(FeatureGroup):
    """Highest speed of the other entity and its time, and the distance driven until the entity brakes hardest.

    All three features are 0 if the other entity never exists.
    """

    name = "other"
    features = (
        Feature("other-highest-speed", "m/s"),
        Feature("other-highest-speed-time", "s"),
        Feature("other-braking-way", "m"),
    )

    def values(self, encounter: Encounter) -> FloatArray:
        instants = encounter.other_instants
        if not len(instants):
            return np.zeros(3)
        speeds = np.abs(encounter.recording.speed[encounter.other_row, instants])
        k = int(np.argmax(speeds))
        braking = _instant_of_strongest_braking(encounter.recording, encounter.other_row, instants)
        steps = np.diff(encounter.other_center[instants[instants <= braking]], axis=0)
        return np.array(
            [speeds[k], encounter.time_since_start(int(instants[k])), np.hypot(steps[:, 0], steps[:, 1]).sum()]
        )


class PathCrossing(FeatureGroup):
    """Distance between the paths where they come nearest, and arrival time of the ego minus that of the other there.

    A pair of points, one on each path, is rated by its distance in m plus 0.1 m for each second between the arrivals of
    both entities. The pair with the least sum counts. So the time decides between pairs that are about equally near.
    """

    name = "crossing"
    features = (Feature("crossing-distance", "m"), Feature("crossing-gap", "s", branch=True))

    def values(self, encounter: Encounter) -> FloatArray:
        return np.array(encounter.path_distance_and_time_gap)


class SlowestInstant(FeatureGroup):
    """State at the first instant at which the ego is slowest, with the other entity in the ego's frame."""

    name = "slowest"
    features = (
        Feature("lowest-speed", "m/s"),
        Feature("lowest-speed-time", "s"),
        Feature("lowest-speed-way", "m"),
        Feature("lowest-speed-ahead", "m"),
        Feature("lowest-speed-left", "m"),
        Feature("lowest-speed-other-speed", "m/s"),
    )

    def values(self, encounter: Encounter) -> FloatArray:
        instants = encounter.ego_instants
        if not len(instants):
            return np.array([0.0, 0.0, 0.0, NEVER_MET_DISTANCE, 0.0, 0.0])
        speeds = np.abs(encounter.recording.speed[encounter.ego_row, instants])
        lowest = int(np.argmin(speeds))
        k = int(instants[lowest])
        return np.array(
            [
                speeds[lowest],
                encounter.time_since_start(k),
                encounter.distance_driven_until(k),
                *encounter.other_relative_to_ego(k),
            ]
        )


class EgoTurn(FeatureGroup):
    """State at the instant at which the ego turns fastest, and when it begins to turn.

    A turn begins when the heading first differs by more than 0.05 rad from the initial heading.
    """

    name = "turn"
    features = (
        Feature("turn-time", "s"),
        Feature("turn-way", "m"),
        Feature("turn-begin-left", "m"),
        Feature("turn-begin-other-speed", "m/s"),
    )

    def values(self, encounter: Encounter) -> FloatArray:
        recording, instants = encounter.recording, encounter.ego_instants
        if len(instants) < 2:
            return np.zeros(4)
        heading = recording.heading[encounter.ego_row, instants]
        turning = _angles_between(heading, heading[0]) > _TURN_STARTED
        _, left, speed = encounter.other_relative_to_ego(int(instants[np.argmax(turning) if turning.any() else -1]))
        rates = _angles_between(heading[1:], heading[:-1]) / np.diff(recording.time[instants])
        k = int(np.argmax(rates))
        if not rates[k] > _STRAIGHT:
            return np.array([0.0, 0.0, left, speed])
        fastest = int(instants[k + 1])
        return np.array([encounter.time_since_start(fastest), encounter.distance_driven_until(fastest), left, speed])


class WholeRecording(FeatureGroup):
    """Duration of the recording, distance that the ego drives, and whether both entities touch."""

    name = "whole"
    features = (Feature("duration", "s"), Feature("way", "m"), Feature("contact", "1", branch=True))

    def values(self, encounter: Encounter) -> FloatArray:
        recorded = encounter.recording.first_collision(encounter.ego, encounter.other)
        is_contact = encounter.closest_instant_and_gap[1] == 0.0 or recorded is not None
        return np.array([encounter.duration, encounter.distance_driven_until(None), float(is_contact)])


def _instant_of_strongest_braking(recording: Recording, row: int, instants: IntArray) -> int:
    """Return the first of `instants` at which an entity brakes with at least 0.9 times its strongest deceleration.

    The factor 0.9 finds the beginning of hard braking, even if the deceleration still rises a little. If the entity
    never brakes, return the last of `instants`.
    """
    accelerations, reverses = recording.acceleration[row, instants], recording.speed[row, instants] < 0.0
    braking = np.nan_to_num(np.where(reverses, accelerations, -accelerations))
    strongest = float(braking.max())
    return int(instants[np.argmax(braking >= _STRONG * strongest) if strongest > _MIN_BRAKING else -1])


def _angles_between(headings: FloatArray, others: FloatArray | float) -> FloatArray:
    """Return the smallest angles between pairs of headings in rad."""
    angle = np.abs(headings - others)
    return np.asarray(np.minimum(angle, np.abs(2.0 * np.pi - angle)))


FEATURES: Final[Registry[FeatureGroup]] = Registry("group of features", "cornercase.features", FeatureGroup)
"""Groups of features by name; other packages add subclasses of `FeatureGroup` through this entry-point group."""

for _group in (
    NearestApproach,
    Approach,
    EgoBraking,
    PathCrossing,
    OtherMotion,
    SlowestInstant,
    EgoTurn,
    WholeRecording,
):
    FEATURES.register(_group.name, _group)


def registered_features() -> tuple[Feature, ...]:
    """Return all registered features.

    Returns
    -------
    tuple of Feature
        Features by group. Groups are in alphabetical order, and features as their group lists them.

    Examples
    --------
    >>> from cornercase.metrics import registered_features
    >>> [feature.name for feature in registered_features() if feature.branch]
    ['crossing-gap', 'contact']
    """
    return tuple(feature for group in _create_feature_groups() for feature in group.features)


def compute_features(recordings: Iterable[Recording | None], ego: str, other: str | Sequence[str]) -> FloatArray:
    """Compute the features of recordings.

    Parameters
    ----------
    recordings : iterable of Recording or None
        None for a scenario that failed.
    ego : str
        Name of an entity.
    other : str or sequence of str
        Names of one or several other entities. If there are several, the features are about the entity that the ego
        collides with first. Without a collision, they are about the entity whose box comes nearest to the ego's.

    Returns
    -------
    ndarray of float64, shape (n, f)
        A row of f `registered_features` for each of n recordings; NaN for a scenario that failed.

    Raises
    ------
    InputError
        There is no entity of that name, or a group of another package does not return the features that it lists.

    Examples
    --------
    >>> import cornercase as cc
    >>> from cornercase.metrics import compute_features, registered_features
    >>> recording = cc.simulate("examples/x_intersection/x_intersection.xosc")
    >>> features = compute_features([recording], "Ego", "Pedestrian")
    >>> names = [feature.name for feature in registered_features()]
    >>> round(float(features[0, names.index("least-clearance")]), 2)
    6.02
    """
    groups = _create_feature_groups()
    count = sum(len(group.features) for group in groups)
    rows = [
        np.full(count, np.nan) if recording is None else _features_of_recording(groups, recording, ego, other)
        for recording in recordings
    ]
    return np.array(rows).reshape(len(rows), count)


def _create_feature_groups() -> list[FeatureGroup]:
    return [_create_group(name, FEATURES.get_factory(name)) for name in FEATURES.names()]


@cache
def _create_group(name: str, _factory: Callable[..., FeatureGroup]) -> FeatureGroup:
    """Create a group of features once: creating a group takes as long as computing its features for a recording."""
    return FEATURES.create(name)


def _features_of_recording(
    groups: list[FeatureGroup], recording: Recording, ego: str, other: str | Sequence[str]
) -> FloatArray:
    meeting = Encounter(recording, ego, nearest_other(recording, ego, other))
    return np.concatenate([_compute_group(group, meeting) for group in groups])


def _compute_group(group: FeatureGroup, meeting: Encounter) -> FloatArray:
    with convert_plugin_errors(f"The group of features '{group.name}'", group):
        values = np.asarray(group.values(meeting), dtype=np.float64)
    if values.shape != (len(group.features),) or not np.isfinite(values).all():
        raise InputError(
            f"The group of features '{group.name}' returned {values.tolist()}; it has to return a finite number for"
            f" each of its {len(group.features)} features."
        )
    return values
