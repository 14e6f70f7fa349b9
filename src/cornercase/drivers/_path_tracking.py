"""Steering along a path."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from cornercase._common.geometry.boxes import wrap_angle
from cornercase._common.typing import FloatArray
from cornercase.drivers._base import DrivenPath

# A deviation decays to 1/e within this distance in m, or this time in s if that is longer.
_DECAY_DISTANCE: Final = 2.0
_DECAY_TIME: Final = 0.4
# rad; steepest approach to the path.
_MAX_APPROACH: Final = 0.5
# Nearest approach to the centre of a bend, as a part of its radius.
_MIN_RADIUS_SHARE: Final = 0.1


class PosesOnPath(NamedTuple):
    """Poses relative to a path, shape (N,) each: m along it, m to the left of it, rad to the left, and its 1/m."""

    along: FloatArray
    offset: FloatArray
    turn: FloatArray
    curvature: FloatArray


def locate_on_path(
    path: DrivenPath, distance: FloatArray, x: FloatArray, y: FloatArray, heading: FloatArray, ahead: FloatArray
) -> PosesOnPath:
    """Return where poses (N,) are on a path; the curvature is that `ahead` m further on, (N,).

    `distance` (N,) is about where on the path to look.
    """
    # Its kernels take long to import.
    from cornercase.drivers._kernels.path_projection import project_onto_path

    along, offset, direction, _ = project_onto_path(path, distance, x[:, None], y[:, None])
    along, offset, direction = along[:, 0], offset[:, 0], direction[:, 0]
    at = along + ahead
    curvature = (
        np.interp(at, path.distance, path.curvature)
        if path.distance.ndim == 1
        else np.array([np.interp(at[n], path.distance[n], path.curvature[n]) for n in range(len(at))])
    )
    return PosesOnPath(along, offset, wrap_angle(heading - direction), curvature)


def steer_along_path(poses: PosesOnPath, speed: FloatArray, wheelbase: float) -> FloatArray:
    """Return angles of the front wheels in rad, (N,), that lead the middle of the rear axle to the path and along it.

    Deviations decay without oscillation, in distance rather than time, so that the speed does not matter.

    Source: feedback of the rear wheels' position, C. Samson, "Path following and time-varying feedback stabilization of
    a wheeled mobile robot", ICARCV 1992, as in B. Paden et al., "A survey of motion planning and control techniques for
    self-driving urban vehicles", IEEE Transactions on Intelligent Vehicles 1 (2016), section V.A.2.
    """
    decay = np.maximum(_DECAY_DISTANCE, _DECAY_TIME * np.abs(speed))
    # With the heading at its limit, the offset shrinks along a straight line.
    offset = np.clip(poses.offset, -2.0 * decay * _MAX_APPROACH, 2.0 * decay * _MAX_APPROACH)
    share = np.maximum(1.0 - poses.curvature * poses.offset, _MIN_RADIUS_SHARE)
    curvature = (
        poses.curvature * np.cos(poses.turn) / share
        - 2.0 * poses.turn / decay
        - np.sinc(poses.turn / np.pi) * offset / decay**2
    )
    return np.asarray(np.arctan(wheelbase * curvature))
