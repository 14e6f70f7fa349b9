"""Steering along a path."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from cornercase._common.geometry.boxes import wrap_angle
from cornercase._common.typing import FloatArray
from cornercase.drivers._base import DrivenPath


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
    from cornercase.drivers._kernels.path_projection import locate_vehicles

    curvature = np.ascontiguousarray(np.atleast_2d(path.curvature))
    columns = (np.ascontiguousarray(values, dtype=np.float64) for values in (distance, x, y, ahead))
    along, offset, direction, bend = locate_vehicles(*path.rows, curvature, *columns).T
    return PosesOnPath(along, offset, wrap_angle(heading - direction), bend)


def steer_along_path(
    poses: PosesOnPath, speed: FloatArray, wheelbase: FloatArray | float, response: FloatArray | float = 0.0
) -> FloatArray:
    """Return angles of the front wheels in rad, (N,), that lead the middle of the rear axle to the path and along it.

    `response` is the time in s by which the wheels are late.

    Deviations decay without oscillation, in distance rather than time, so that the speed does not matter.

    Source: feedback of the rear wheels' position, C. Samson, "Path following and time-varying feedback stabilization of
    a wheeled mobile robot", ICARCV 1992, as in B. Paden et al., "A survey of motion planning and control techniques for
    self-driving urban vehicles", IEEE Transactions on Intelligent Vehicles 1 (2016), section V.A.2.
    """
    # Its kernels take long to import.
    from cornercase.drivers._kernels.steer import steering_angles

    columns = (poses.offset, poses.turn, poses.curvature, speed, wheelbase, response)
    rows = (np.ascontiguousarray(np.broadcast_to(values, poses.offset.shape), dtype=np.float64) for values in columns)
    return np.asarray(steering_angles(*rows))
