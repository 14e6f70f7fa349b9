"""Metric of inverse universal traffic quality."""

from __future__ import annotations

from typing import Final, Literal, get_args

import numpy as np

from cornercase._common.errors import InputError, suggest_name
from cornercase._common.geometry.boxes import box_distance
from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.metrics._base import Metric
from cornercase.metrics._geometry.boxes import box_corners_over_time
from cornercase.recordings import Recording

Term = Literal["all", "macro", "micro", "nano", "individual", "penalty"]

_WINDOW = 2.0  # s
_STANDSTILL = 1e-5  # m/s


class TrafficQuality(Metric):
    r"""Inverse universal traffic quality: how demanding the traffic around the ego is; higher is more critical.

    ``penalty * sqrt(macro² + micro² + nano² + individual²)``, without unit, over all n entities that exist:

    - *macro*, the traffic as a whole: standard deviation over mean of all speeds (of the population);
    - *micro*, how crowded it is around the ego: the number of other entities whose centre lies within the radius
      r = (0.36 v)² + L + v of the ego's, with the ego's speed v in m/s and length L in m, over n;
    - *nano*, the traffic around the ego: standard deviation over mean of the speeds of these entities; 0 if there are
      none;
    - *individual*, how the ego drives: (\|mean a\| / 1.5 m/s² + mean v / 13.89 m/s) / 2, means over the
      samples of the last 2 s, fewer at the beginning;
    - *penalty*, the distance: exp(-d / 5 m), with the smallest gap d between the boxes of any two entities: 1
      if two boxes overlap, 0 for a scene of one entity.

    Speeds count without their sign. Macro and nano are 0 if the mean speed is below 1e-5 m/s, so a standing scene has
    only the micro term. Not defined if the ego does not exist. The `other` entity of `course` is not used, but a
    recording in which it touches the ego scores 10. Least critical value (cap): 0, the smallest possible value. Most
    critical value: 10.

    Source: B. Schütt, M. Zipfl, J. M. Zöllner, E. Sax, "Inverse universal traffic quality: a criticality metric for
    crowded urban traffic scenes", IEEE Intelligent Vehicles Symposium (2023). The window of the individual term ends at
    each instant, and overlapping boxes have the gap 0.

    Parameters
    ----------
    term : {"all", "macro", "micro", "nano", "individual", "penalty"}, default "all"
        Term to give by itself; ``"all"`` for the formula above.

    Raises
    ------
    InputError
        There is no such term.

    Examples
    --------
    >>> import cornercase as cc
    >>> recording = cc.simulate(
    ...     "examples/x_intersection/x_intersection.xosc", {"ego_start": 44.0}, drivers={"Ego": "aggressive"}
    ... )
    >>> cc.measure(recording, "Ego", "Pedestrian", [cc.metrics.TrafficQuality()])
    metric           score  unit  critical is
    traffic-quality  1.12   1     high
    """

    name = "traffic-quality"
    unit = "1"
    lower_is_critical = False
    cap = 0.0
    bound = contact_score = 10.0
    source = "Schütt, Zipfl et al. 2023"

    def __init__(self, term: Term = "all") -> None:
        if term not in get_args(Term):
            raise InputError(f"Traffic quality has no term '{term}'; {suggest_name(term, get_args(Term))}")
        self.term = term
        self.name = "traffic-quality" if term == "all" else f"traffic-quality-{term}"

    def course(self, recording: Recording, ego: str, other: str = "") -> FloatArray:
        """Compute the traffic quality, or the chosen term, at each instant; `other` is not used."""
        scene = _TrafficScene(recording, ego)
        if self.term != "all":
            return np.where(scene.exists[scene.ego], _TERMS[self.term](scene), np.nan)
        squares = sum(_TERMS[name](scene) ** 2 for name in ("macro", "micro", "nano", "individual"))
        return np.where(scene.exists[scene.ego], scene.smallest_gap_penalty() * np.sqrt(squares), np.nan)


class _TrafficScene:
    """Motion of all entities of a recording; the methods return the terms of the traffic quality, shape (T,) each."""

    def __init__(self, recording: Recording, ego: str) -> None:
        self.recording = recording
        self.ego = recording.entity_index(ego)
        self.centers = np.stack([recording.box_center(name) for name in recording.names])
        self.speed = np.abs(recording.speed)
        self.exists: BoolArray = np.isfinite(self.centers).all(-1) & np.isfinite(self.speed)
        offsets = self.centers - self.centers[self.ego]
        speed = self.speed[self.ego]
        radius = (0.36 * speed) ** 2 + recording.length[self.ego] + speed
        self.near: BoolArray = self.exists & (np.hypot(offsets[..., 0], offsets[..., 1]) <= radius)
        self.near[self.ego] = False

    def speed_variation_of_all(self) -> FloatArray:
        return _coefficient_of_variation(self.speed, self.exists)

    def share_near_ego(self) -> FloatArray:
        fraction: FloatArray = self.near.sum(0) / np.maximum(self.exists.sum(0), 1)
        return fraction

    def speed_variation_near_ego(self) -> FloatArray:
        return _coefficient_of_variation(self.speed, self.near)

    def ego_motion_term(self) -> FloatArray:
        time = self.recording.time
        # Stored times are rounded, so a sample that is 2 s old up to a small tolerance belongs to the window.
        first = np.searchsorted(time, time - _WINDOW - 1e-6)
        acceleration = _running_mean_from(first, self.recording.acceleration[self.ego])
        speed = _running_mean_from(first, self.speed[self.ego])
        return 0.5 * (np.abs(acceleration) / 1.5 + speed / 13.89)

    def smallest_gap_penalty(self) -> FloatArray:
        a, b = np.triu_indices(len(self.centers), 1)
        offsets = self.centers[a] - self.centers[b]
        center_distance = np.where(self.exists[a] & self.exists[b], np.hypot(offsets[..., 0], offsets[..., 1]), np.inf)
        reach = 0.5 * np.hypot(self.recording.length, self.recording.width)
        # The gap of two boxes is at most the distance of their centres, and at least that less both half diagonals.
        min_gap = center_distance - (reach[a] + reach[b])[:, None]
        is_candidate = np.isfinite(center_distance) & (min_gap <= center_distance.min(0, initial=np.inf))
        pair, instant = np.nonzero(is_candidate)
        corners = np.stack([box_corners_over_time(self.recording, name) for name in self.recording.names])
        smallest = np.full(len(self.recording.time), np.inf)
        np.minimum.at(smallest, instant, box_distance(corners[a[pair], instant], corners[b[pair], instant]))
        penalty: FloatArray = np.exp(-smallest / 5.0)
        return penalty


_TERMS: Final = {
    "macro": _TrafficScene.speed_variation_of_all,
    "micro": _TrafficScene.share_near_ego,
    "nano": _TrafficScene.speed_variation_near_ego,
    "individual": _TrafficScene.ego_motion_term,
    "penalty": _TrafficScene.smallest_gap_penalty,
}


def _coefficient_of_variation(speed: FloatArray, is_counted: BoolArray) -> FloatArray:
    """Return the coefficient of variation (standard deviation over mean) of the counted speeds at each instant.

    It is 0 if no speed counts, or if their mean is below 1e-5 m/s.
    """
    count = np.maximum(is_counted.sum(0), 1)
    mean = np.where(is_counted, speed, 0.0).sum(0) / count
    spread = np.sqrt((np.where(is_counted, speed - mean, 0.0) ** 2).sum(0) / count)
    moves = mean >= _STANDSTILL
    return np.where(moves, spread / np.where(moves, mean, 1.0), 0.0)


def _running_mean_from(first: IntArray, values: FloatArray) -> FloatArray:
    """Return the mean of the finite values from `first` to each instant, shape (T,); 0 if there are none.

    `first`, shape (T,), has the index at which the mean begins.
    """
    is_finite = np.isfinite(values)
    total = np.append(0.0, np.cumsum(np.where(is_finite, values, 0.0)))
    count = np.append(0, np.cumsum(is_finite))
    end = np.arange(1, len(values) + 1)
    mean: FloatArray = (total[end] - total[first]) / np.maximum(count[end] - count[first], 1)
    return mean
