"""Metrics of the steering that the ego needs to pass another entity ahead."""

from __future__ import annotations

import numpy as np

from cornercase._common.typing import FloatArray
from cornercase.metrics._base import Metric
from cornercase.metrics._geometry.boxes import box_corners_over_time, velocity_vectors
from cornercase.metrics._geometry.leader import LeaderGap
from cornercase.metrics._geometry.numeric import check_nonnegative_options, divide_by_positive_or_inf
from cornercase.recordings import Recording


class LateralAcceleration(Metric):
    """Required lateral acceleration: the least with which the ego passes the other entity, left or right.

    ``min over ± of 2 |±(w + w_other) / 2 + Δy| / TTC²`` in m/s². w and w_other are the widths of the boxes across the
    ego's heading. TTC is the gap along the heading, divided by the closing speed. Δy is the lateral offset, to the
    left, of the other's centre from the ego's centre when the gap is closed; it is predicted with constant lateral
    speeds. The value is 0 if the gap does not shrink, and inf if the boxes touch while the gap shrinks. A standing
    entity is an obstacle. Not defined if the other entity is not ahead of the ego, or one of the two does not exist.
    Least critical value (cap): 0; most critical value: 20 m/s².

    Source: required lateral acceleration, as in Westhofen et al. 2023 and Jansson 2005.

    Examples
    --------
    >>> import cornercase as cc
    >>> recording = cc.simulate("examples/r157/cut_out.xosc")
    >>> cc.measure(recording, "Ego", "Other", [cc.metrics.LateralAcceleration()])
    metric     score   unit  critical is
    a-lat-req  0.1468  m/s²  high
    """

    name = "a-lat-req"
    unit = "m/s²"
    lower_is_critical = False
    cap = 0.0
    bound = 20.0
    source = "Jansson 2005"

    def course(self, recording: Recording, ego: str, other: str) -> FloatArray:
        return required_lateral_acceleration(recording, ego, other)


class Stn(Metric):
    """Steer threat number: required lateral acceleration divided by available lateral acceleration.

    The required lateral acceleration (`LateralAcceleration`) divided by the greatest lateral acceleration of the ego,
    without unit. The value is 1 if full steering just avoids the contact, and 0 if the gap does not shrink. A standing
    entity is an obstacle. Not defined if the other entity is not ahead of the ego, or one of the two does not exist.
    Least critical value (cap): 0; most critical value: 5.

    Source: M. Brännström, J. Sjöberg, E. Coelingh, "A situation and threat assessment algorithm for a rear-end
    collision avoidance system", IEEE Intelligent Vehicles Symposium (2008).

    Parameters
    ----------
    acceleration : float, default 8.0
        Greatest lateral acceleration of the ego in m/s².

    Examples
    --------
    >>> import cornercase as cc
    >>> recording = cc.simulate("examples/r157/cut_out.xosc")
    >>> cc.measure(recording, "Ego", "Other", [cc.metrics.Stn()])
    metric  score    unit  critical is
    stn     0.01835  1     high
    """

    name = "stn"
    unit = "1"
    lower_is_critical = False
    cap = 0.0
    bound = 5.0
    default_threshold = 1.0
    source = "Brännström et al. 2008"

    def __init__(self, acceleration: float = 8.0) -> None:
        check_nonnegative_options(self.name, acceleration=acceleration)
        self.acceleration = acceleration

    def course(self, recording: Recording, ego: str, other: str) -> FloatArray:
        required = required_lateral_acceleration(recording, ego, other)
        return divide_by_positive_or_inf(required, self.acceleration)


def required_lateral_acceleration(recording: Recording, ego: str, other: str) -> FloatArray:
    """Return the least lateral acceleration with which the ego avoids contact at each instant, shape (T,).

    In m/s², not negative; NaN if the other entity is not ahead of the ego. The formula is in `LateralAcceleration`.
    """
    pair = LeaderGap.from_recording(recording, ego, other)
    heading = recording.heading[recording.entity_index(ego)]
    left = np.stack([-np.sin(heading), np.cos(heading)], -1)
    width = sum(np.ptp((box_corners_over_time(recording, name) * left[:, None]).sum(-1), -1) for name in (ego, other))
    offset = ((recording.box_center(other) - recording.box_center(ego)) * left).sum(-1)
    drift = ((velocity_vectors(recording, other) - velocity_vectors(recording, ego)) * left).sum(-1)
    closes = pair.closing_speed > 0.0
    time = np.where(closes, pair.gap / np.where(closes, pair.closing_speed, 1.0), np.inf)
    final_offset = offset + np.where(closes, drift * np.where(closes, time, 0.0), 0.0)
    distance = np.minimum(np.abs(0.5 * width + final_offset), np.abs(0.5 * width - final_offset))
    with np.errstate(divide="ignore"):
        required = np.where(closes, 2.0 * distance / np.where(closes, time, 1.0) ** 2, 0.0)
    required = np.where(closes & (time == 0.0), np.inf, required)
    return np.where(np.isnan(pair.gap + pair.closing_speed), np.nan, required)
