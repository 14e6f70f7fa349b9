"""Metrics of the stopping distance of the ego, and of the braking that it needs because of an entity ahead."""

from __future__ import annotations

import numpy as np

from cornercase._common.typing import FloatArray
from cornercase.metrics._base import Metric
from cornercase.metrics._geometry.leader import LeaderGap
from cornercase.metrics._geometry.numeric import check_nonnegative_options, divide_by_positive_or_inf
from cornercase.recordings import Recording


class Drac(Metric):
    """Deceleration rate to avoid a crash: the braking that just removes the speed difference before contact.

    ``Δv² / (2 gap)`` in m/s², with the closing speed Δv and the gap along the ego's heading. The other entity keeps its
    speed. A standing entity is an obstacle; for an oncoming entity, Δv is the sum of both speeds. The value is 0 if the
    gap does not shrink, and inf if the boxes touch while the gap shrinks. Not defined if the other entity is not ahead
    of the ego, or one of the two does not exist. Least critical value (cap): 0; most critical value: 20 m/s².

    Source: D. F. Cooper, N. Ferguson, "Traffic studies at T-junctions", Traffic Engineering and Control 17 (1976); also
    A. Guido et al. (2010).

    Examples
    --------
    >>> import cornercase as cc
    >>> recording = cc.simulate("examples/r157/cut_out.xosc")
    >>> cc.measure(recording, "Ego", "Other", [cc.metrics.Drac()])
    metric  score  unit  critical is
    drac    5.179  m/s²  high
    """

    name = "drac"
    unit = "m/s²"
    lower_is_critical = False
    cap = 0.0
    bound = 20.0
    source = "Cooper and Ferguson 1976"

    def course(self, recording: Recording, ego: str, other: str) -> FloatArray:
        pair = LeaderGap.from_recording(recording, ego, other)
        return divide_by_positive_or_inf(np.maximum(pair.closing_speed, 0.0) ** 2, 2.0 * pair.gap)


class Mdrac(Metric):
    """Modified deceleration rate to avoid a crash: the braking begins after a reaction time.

    ``Δv / (2 (gap / Δv - t_r))`` in m/s², with the closing speed Δv and the reaction time t_r. The value is 0 if the
    gap does not shrink, and inf if the ego reaches the other entity within the reaction time. A standing entity is an
    obstacle; for an oncoming entity, Δv is the sum of both speeds. Not defined if the other entity is not ahead of the
    ego, or one of the two does not exist. Least critical value (cap): 0; most critical value: 20 m/s².

    Source: W. K. M. Alhajyaseen, "The integration of conflict probability and severity for the safety assessment of
    intersections", Arabian Journal for Science and Engineering 40 (2015), after Cunto (2008).

    Parameters
    ----------
    reaction_time : float, default 1.0
        t_r in s.

    Examples
    --------
    >>> import cornercase as cc
    >>> recording = cc.simulate("examples/r157/cut_out.xosc")
    >>> cc.measure(recording, "Ego", "Other", [cc.metrics.Mdrac()])
    metric  score  unit  critical is
    mdrac   9.556  m/s²  high
    """

    name = "mdrac"
    unit = "m/s²"
    lower_is_critical = False
    cap = 0.0
    bound = 20.0
    source = "Alhajyaseen 2015"

    def __init__(self, reaction_time: float = 1.0) -> None:
        check_nonnegative_options(self.name, reaction_time=reaction_time)
        self.reaction_time = reaction_time

    def course(self, recording: Recording, ego: str, other: str) -> FloatArray:
        pair = LeaderGap.from_recording(recording, ego, other)
        closing = np.maximum(pair.closing_speed, 0.0)
        return divide_by_positive_or_inf(closing**2, 2.0 * (pair.gap - closing * self.reaction_time))


class Dst(Metric):
    """Deceleration to safety time: the braking that removes the speed difference and keeps a time gap.

    ``Δv² / (2 (gap - v_other t_s))`` in m/s², with the closing speed Δv, the speed v_other of the other entity and the
    safety time t_s. A safety time of 0 gives `Drac`. The value is 0 if the gap does not shrink, and inf if the gap
    shrinks and is at most v_other t_s. A standing entity is an obstacle; v_other is negative for an oncoming entity.
    Not defined if the other entity is not ahead of the ego, or one of the two does not exist. Least critical value
    (cap): 0; most critical value: 20 m/s².

    Source: C. Hupfer, "Deceleration to safety time (DST) – a useful figure to evaluate traffic safety?", ICTCT
    Conference (1997).

    Parameters
    ----------
    safety_time : float, default 1.0
        t_s in s.

    Examples
    --------
    >>> import cornercase as cc
    >>> recording = cc.simulate("examples/r157/cut_out.xosc")
    >>> cc.measure(recording, "Ego", "Other", [cc.metrics.Dst()])
    metric  score  unit  critical is
    dst     5.179  m/s²  high
    """

    name = "dst"
    unit = "m/s²"
    lower_is_critical = False
    cap = 0.0
    bound = 20.0
    default_threshold = 4.0
    source = "Hupfer 1997"

    def __init__(self, safety_time: float = 1.0) -> None:
        check_nonnegative_options(self.name, safety_time=safety_time)
        self.safety_time = safety_time

    def course(self, recording: Recording, ego: str, other: str) -> FloatArray:
        pair = LeaderGap.from_recording(recording, ego, other)
        closing = np.maximum(pair.closing_speed, 0.0)
        return divide_by_positive_or_inf(closing**2, 2.0 * (pair.gap - pair.leader_speed * self.safety_time))


class LongitudinalAcceleration(Metric):
    """Required longitudinal acceleration: the weakest constant braking with which the ego avoids a contact.

    The other entity ahead has the speed v₂ and keeps its acceleration a₂ until it stands. The ego has the speed v, and
    Δv is ``v - v₂``. If the ego can match the speed of the other before the other stands, which is so for
    ``2 gap / Δv <= v₂ / |a₂|``, the value is ``a₂ - Δv² / (2 gap)``. Otherwise the ego stops behind the other, with
    ``-v² / (2 (gap + v₂² / (2 |a₂|)))``. The unit is m/s²; values are negative, and lower is more critical. The
    value is 0 if no braking is needed, and -inf if the boxes touch while the gap shrinks.

    A standing entity is an obstacle. For an oncoming entity the value is the acceleration after which the gap no longer
    shrinks; the ego alone cannot always achieve this. Not defined if the other entity is not ahead of the ego, or one
    of the two does not exist. Least critical value (cap): 0; most critical value: -20 m/s².

    Source: required longitudinal acceleration, as in Westhofen et al. 2023 and Jansson 2005, with the stop of the
    leader.

    Examples
    --------
    >>> import cornercase as cc
    >>> recording = cc.simulate("examples/r157/cut_out.xosc")
    >>> cc.measure(recording, "Ego", "Other", [cc.metrics.LongitudinalAcceleration()])
    metric      score   unit  critical is
    a-long-req  -5.179  m/s²  low
    """

    name = "a-long-req"
    unit = "m/s²"
    lower_is_critical = True
    cap = 0.0
    bound = -20.0
    default_threshold = -5.0
    source = "Jansson 2005, leader does not reverse"

    def course(self, recording: Recording, ego: str, other: str) -> FloatArray:
        return required_longitudinal_acceleration(LeaderGap.from_recording(recording, ego, other))


class Btn(Metric):
    """Brake threat number: required braking divided by available braking.

    The required longitudinal acceleration (`LongitudinalAcceleration`) divided by the greatest deceleration of the ego,
    without unit. The value is 1 if full braking just avoids the contact, and 0 if no braking is needed. A standing
    entity is an obstacle. Not defined if the other entity is not ahead of the ego, or one of the two does not exist.
    Least critical value (cap): 0; most critical value: 5.

    Source: M. Brännström, J. Sjöberg, E. Coelingh, "A situation and threat assessment algorithm for a rear-end
    collision avoidance system", IEEE Intelligent Vehicles Symposium (2008).

    Parameters
    ----------
    deceleration : float, default 8.0
        Greatest deceleration of the ego in m/s².

    Examples
    --------
    >>> import cornercase as cc
    >>> recording = cc.simulate("examples/r157/cut_out.xosc")
    >>> cc.measure(recording, "Ego", "Other", [cc.metrics.Btn()])
    metric  score   unit  critical is
    btn     0.6474  1     high
    """

    name = "btn"
    unit = "1"
    lower_is_critical = False
    cap = 0.0
    bound = 5.0
    default_threshold = 1.0
    source = "Brännström et al. 2008"

    def __init__(self, deceleration: float = 8.0) -> None:
        check_nonnegative_options(self.name, deceleration=deceleration)
        self.deceleration = deceleration

    def course(self, recording: Recording, ego: str, other: str) -> FloatArray:
        return divide_by_positive_or_inf(
            -required_longitudinal_acceleration(LeaderGap.from_recording(recording, ego, other)), self.deceleration
        )


class StoppingDistance(Metric):
    """Shortest distance in which the ego can stop, ``v² / (2 a)`` in m.

    v is the speed of the ego and a its greatest deceleration. The other entity does not matter. A standing ego gives 0.
    Not defined if the ego does not exist. Least critical value (cap): 0 m. Most critical value: 500 m, which is also
    the score of a recording in which both touch.

    Source: minimal stopping distance, as in Westhofen et al. 2023.

    Parameters
    ----------
    deceleration : float, default 8.0
        Greatest deceleration of the ego in m/s².

    Examples
    --------
    >>> import cornercase as cc
    >>> recording = cc.simulate(
    ...     "examples/x_intersection/x_intersection.xosc", {"ego_start": 44.0}, drivers={"Ego": "aggressive"}
    ... )
    >>> cc.measure(recording, "Ego", "Pedestrian", [cc.metrics.StoppingDistance()])
    metric  score  unit  critical is
    msd     6.25   m     high
    """

    name = "msd"
    unit = "m"
    lower_is_critical = False
    cap = 0.0
    bound = contact_score = 500.0
    source = "Minimal stopping distance, as in Westhofen et al. 2023"

    def __init__(self, deceleration: float = 8.0) -> None:
        check_nonnegative_options(self.name, deceleration=deceleration)
        self.deceleration = deceleration

    def course(self, recording: Recording, ego: str, other: str) -> FloatArray:
        return divide_by_positive_or_inf(recording.speed[recording.entity_index(ego)] ** 2, 2.0 * self.deceleration)


def required_longitudinal_acceleration(leader: LeaderGap) -> FloatArray:
    """Return the acceleration in m/s², at most 0, of the weakest braking that avoids contact with a leader.

    One value for each instant, shape (T,); NaN if `leader` has no gap at the instant. The formula is in
    `LongitudinalAcceleration`.
    """
    closing, acceleration = leader.closing_speed, leader.leader_acceleration
    brakes = (leader.leader_speed > 0.0) & (acceleration < 0.0)
    stopping_distance = np.where(brakes, 0.5 * leader.leader_speed**2 / np.where(brakes, -acceleration, 1.0), 0.0)
    stop_behind = -divide_by_positive_or_inf(leader.speed**2, 2.0 * (leader.gap + stopping_distance))
    # A standing leader with negative acceleration holds its brake; it does not start to reverse.
    leader_acceleration = np.where((leader.leader_speed == 0.0) & (acceleration < 0.0), 0.0, acceleration)
    match_speed = leader_acceleration - divide_by_positive_or_inf(np.maximum(closing, 0.0) ** 2, 2.0 * leader.gap)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        matches_before_stop = (closing > 0.0) & (
            2.0 * leader.gap / closing <= leader.leader_speed / np.where(brakes, -acceleration, 1.0)
        )
    required = np.where(brakes & ~matches_before_stop, stop_behind, np.where(closing > 0.0, match_speed, 0.0))
    return np.where(np.isnan(leader.gap + closing + acceleration), np.nan, np.minimum(required, 0.0))
