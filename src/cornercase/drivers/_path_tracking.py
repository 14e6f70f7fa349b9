"""Steering along a path."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from cornercase._common.geometry.boxes import wrap_angle
from cornercase._common.typing import FloatArray
from cornercase.drivers._base import DrivenPath


class PosesOnPath(NamedTuple):
    """Poses of N vehicles relative to a path; each array has shape (N,).

    `along`: distance along the path in m. `offset`: distance to the left of the path in m. `turn`: heading relative to
    the path in rad, positive to the left. `curvature`: curvature of the path in 1/m.
    """

    along: FloatArray
    offset: FloatArray
    turn: FloatArray
    curvature: FloatArray


def locate_on_path(
    path: DrivenPath, distance: FloatArray, x: FloatArray, y: FloatArray, heading: FloatArray, ahead: FloatArray
) -> PosesOnPath:
    """Return N poses relative to a path, with the curvature of the path `ahead` m (N,) farther on.

    `distance` (N,) is the approximate position along the path in m, where the search begins.
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

    `response` is the time in s by which the wheels lag behind.

    Deviations decay without oscillation, over a distance of 2 m, or over the distance that the vehicle drives in 0.4 s
    plus twice `response` if that is longer.

    Source: feedback of the rear wheels' position, C. Samson, "Path following and time-varying feedback stabilization of
    a wheeled mobile robot", ICARCV 1992, as in B. Paden et al., "A survey of motion planning and control techniques for
    self-driving urban vehicles", IEEE Transactions on Intelligent Vehicles 1 (2016), section V.A.2.
    """
    # Its kernels take long to import.
    from cornercase.drivers._kernels.steer import steering_angles

    columns = (poses.offset, poses.turn, poses.curvature, speed, wheelbase, response)
    rows = (np.ascontiguousarray(np.broadcast_to(values, poses.offset.shape), dtype=np.float64) for values in columns)
    return np.asarray(steering_angles(*rows))
