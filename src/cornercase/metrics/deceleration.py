"""How hard the ego would have to brake for the other in its way, and how far it needs to stop."""

from __future__ import annotations

import numpy as np

from cornercase._common.typing import FloatArray
from cornercase.metrics._parts.following import Following
from cornercase.metrics._parts.numbers import checked, over
from cornercase.metrics.base import Metric
from cornercase.recordings import Recording


class Drac(Metric):
    """Deceleration rate to avoid a crash: by which braking the ego just takes on the other's speed at contact.

    ``Δv² / (2 gap)`` in m/s², with the closing speed Δv and the gap along the ego's way; the other keeps its
    speed. 0 when the gap does not shrink, inf at contact while it does. A standing other is an obstacle; for
    an oncoming one Δv is the sum of both speeds. Not defined where the other is not in the ego's way or one
    of the two does not exist. Cap: 0, most critical value: 20 m/s².

    Notes
    -----
    Source: D. F. Cooper, N. Ferguson, "Traffic studies at T-junctions", Traffic Engineering and Control 17
    (1976); also A. Guido et al. (2010).
    """

    name = "drac"
    unit = "m/s²"
    lower_is_critical = False
    cap = 0.0
    most_critical = 20.0
    source = "Cooper and Ferguson 1976"

    def course(self, recording: Recording, ego: str, other: str) -> FloatArray:
        pair = Following.of(recording, ego, other)
        return over(np.maximum(pair.closing, 0.0) ** 2, 2.0 * pair.gap)


class Mdrac(Metric):
    """Modified deceleration rate to avoid a crash: the braking begins after a reaction time.

    ``Δv / (2 (gap / Δv - t_r))`` in m/s², with the closing speed Δv. 0 when the gap does not shrink, inf when
    the ego reaches the other within the reaction time. Standing and oncoming others as in `Drac`. Not defined
    where the other is not in the ego's way or one of the two does not exist. Cap: 0, most critical value: 20 m/s².

    Parameters
    ----------
    reaction_time : float, default 1.0
        t_r in s.

    Notes
    -----
    Source: W. K. M. Alhajyaseen, "The integration of conflict probability and severity for the safety
    assessment of intersections", Arabian Journal for Science and Engineering 40 (2015), after Cunto (2008).
    """

    name = "mdrac"
    unit = "m/s²"
    lower_is_critical = False
    cap = 0.0
    most_critical = 20.0
    source = "Alhajyaseen 2015"

    def __init__(self, reaction_time: float = 1.0) -> None:
        checked(self.name, reaction_time=reaction_time)
        self.reaction_time = reaction_time

    def course(self, recording: Recording, ego: str, other: str) -> FloatArray:
        pair = Following.of(recording, ego, other)
        closing = np.maximum(pair.closing, 0.0)
        return over(closing**2, 2.0 * (pair.gap - closing * self.reaction_time))


class Dst(Metric):
    """Deceleration to safety time: by which braking the ego takes on the other's speed and keeps a time gap.

    ``Δv² / (2 (gap - v_other t_s))`` in m/s², with the closing speed Δv; a safety time of 0 gives `Drac`. 0
    when the gap does not shrink, inf when it is already smaller than the safety time asks for. Standing and
    oncoming others as in `Drac`. Not defined where the other is not in the ego's way or one of the two does
    not exist. Cap: 0, most critical value: 20 m/s².

    Parameters
    ----------
    safety_time : float, default 1.0
        t_s in s.

    Notes
    -----
    Source: C. Hupfer, "Deceleration to safety time (DST) – a useful figure to evaluate traffic safety?",
    ICTCT Conference (1997).
    """

    name = "dst"
    unit = "m/s²"
    lower_is_critical = False
    cap = 0.0
    most_critical = 20.0
    critical = 4.0
    source = "Hupfer 1997"

    def __init__(self, safety_time: float = 1.0) -> None:
        checked(self.name, safety_time=safety_time)
        self.safety_time = safety_time

    def course(self, recording: Recording, ego: str, other: str) -> FloatArray:
        pair = Following.of(recording, ego, other)
        closing = np.maximum(pair.closing, 0.0)
        return over(closing**2, 2.0 * (pair.gap - pair.leader_speed * self.safety_time))


class LongitudinalAcceleration(Metric):
    """Required longitudinal acceleration: the weakest constant braking with which the ego does not hit the other.

    The other keeps its acceleration a₂ until it stands. Where the ego has taken on its speed before that, at
    ``2 gap / Δv <= v₂ / |a₂|``, the value is ``a₂ - Δv² / (2 gap)``; else the ego stops behind it, with
    ``-v² / (2 (gap + v₂² / (2 |a₂|)))``. In m/s², negative: lower is more critical. 0 when no braking is
    needed, -inf at contact while the gap shrinks. A standing other is an obstacle. For an oncoming one the
    value is the acceleration that ends the closing, and so more than the ego alone could mend. Not defined
    where the other is not in the ego's way or one of the two does not exist. Cap: 0, most critical value: -20 m/s².

    Notes
    -----
    Source: required longitudinal acceleration, as in Westhofen et al. 2023 and Jansson 2005, with the stop of
    the leader.
    """

    name = "a-long-req"
    unit = "m/s²"
    lower_is_critical = True
    cap = 0.0
    most_critical = -20.0
    critical = -5.0
    source = "Jansson 2005, leader does not reverse"

    def course(self, recording: Recording, ego: str, other: str) -> FloatArray:
        return required_acceleration(Following.of(recording, ego, other))


class Btn(Metric):
    """Brake threat number: required over available braking.

    The required longitudinal acceleration (`LongitudinalAcceleration`) over the greatest deceleration, without
    unit: 1 where braking at full power just avoids the contact. 0 when no braking is needed. Standing others,
    and where it is not defined, as there. Cap: 0, most critical value: 5.

    Parameters
    ----------
    deceleration : float, default 8.0
        Greatest deceleration of the ego in m/s².

    Notes
    -----
    Source: M. Brännström, J. Sjöberg, E. Coelingh, "A situation and threat assessment algorithm for a rear-end
    collision avoidance system", IEEE Intelligent Vehicles Symposium (2008).
    """

    name = "btn"
    unit = "1"
    lower_is_critical = False
    cap = 0.0
    most_critical = 5.0
    critical = 1.0
    source = "Brännström et al. 2008"

    def __init__(self, deceleration: float = 8.0) -> None:
        checked(self.name, deceleration=deceleration)
        self.deceleration = deceleration

    def course(self, recording: Recording, ego: str, other: str) -> FloatArray:
        return over(-required_acceleration(Following.of(recording, ego, other)), self.deceleration)


class StoppingDistance(Metric):
    """Least distance in which the ego can stop, ``v² / (2 a)`` in m.

    The other plays no part; a standing ego gives 0. Not defined where the ego does not exist. Cap: 0 m, most
    critical value: 500 m, which is the score of a recording in which both touch.

    Parameters
    ----------
    deceleration : float, default 8.0
        Greatest deceleration of the ego in m/s².

    Notes
    -----
    Source: minimal stopping distance, as in Westhofen et al. 2023.
    """

    name = "msd"
    unit = "m"
    lower_is_critical = False
    cap = 0.0
    most_critical = contact = 500.0
    source = "Minimal stopping distance, as in Westhofen et al. 2023"

    def __init__(self, deceleration: float = 8.0) -> None:
        checked(self.name, deceleration=deceleration)
        self.deceleration = deceleration

    def course(self, recording: Recording, ego: str, other: str) -> FloatArray:
        return over(recording.speed[recording.index(ego)] ** 2, 2.0 * self.deceleration)


def required_acceleration(pair: Following) -> FloatArray:
    """Weakest constant acceleration of the ego without contact; see `LongitudinalAcceleration`.

    Parameters
    ----------
    pair : Following

    Returns
    -------
    ndarray of float64, shape (T,)
        m/s², not above 0; NaN where `pair` has no gap.
    """
    closing, rate = pair.closing, pair.leader_acceleration
    brakes = (pair.leader_speed > 0.0) & (rate < 0.0)
    stopping = np.where(brakes, 0.5 * pair.leader_speed**2 / np.where(brakes, -rate, 1.0), 0.0)
    behind_it = -over(pair.speed**2, 2.0 * (pair.gap + stopping))
    # A leader that stands does not start backwards because it holds its brake.
    steady = np.where((pair.leader_speed == 0.0) & (rate < 0.0), 0.0, rate)
    alongside = steady - over(np.maximum(closing, 0.0) ** 2, 2.0 * pair.gap)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        in_time = (closing > 0.0) & (2.0 * pair.gap / closing <= pair.leader_speed / np.where(brakes, -rate, 1.0))
    required = np.where(brakes & ~in_time, behind_it, np.where(closing > 0.0, alongside, 0.0))
    return np.where(np.isnan(pair.gap + closing + rate), np.nan, np.minimum(required, 0.0))
