"""Oriented boxes in the plane, vectorised over any leading axes."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from cornercase.typing import BoolArray, FloatArray

_SIGNS_ALONG = np.array([1.0, 1.0, -1.0, -1.0])
_SIGNS_ACROSS = np.array([-1.0, 1.0, 1.0, -1.0])


def box_corners(
    x: npt.ArrayLike,
    y: npt.ArrayLike,
    heading: npt.ArrayLike,
    length: npt.ArrayLike,
    width: npt.ArrayLike,
) -> FloatArray:
    """Corners of boxes, counter-clockwise from the front right.

    Parameters
    ----------
    x, y : array_like of float, shape (...)
        Box centres in m.
    heading : array_like of float, shape (...)
        Direction of the boxes' length in rad, counter-clockwise from +x.
    length, width : array_like of float, shape (...)
        Full sizes in m.

    Returns
    -------
    ndarray of float64, shape (..., 4, 2)
    """
    x, y, heading, length, width = np.broadcast_arrays(*map(np.asarray, (x, y, heading, length, width)))
    along = 0.5 * length[..., None] * _SIGNS_ALONG
    across = 0.5 * width[..., None] * _SIGNS_ACROSS
    cos, sin = np.cos(heading)[..., None], np.sin(heading)[..., None]
    corners = np.stack([x[..., None] + cos * along - sin * across, y[..., None] + sin * along + cos * across], -1)
    return corners.astype(np.float64)


def boxes_overlap(a: FloatArray, b: FloatArray) -> BoolArray:
    """Whether boxes share a point (separating axes).

    Parameters
    ----------
    a, b : ndarray of float64, shape (..., 4, 2)
        Corners as of `box_corners`; leading axes broadcast. A box with a NaN corner overlaps nothing.

    Returns
    -------
    ndarray of bool, shape (...)
    """
    overlap = np.ones(np.broadcast_shapes(a.shape[:-2], b.shape[:-2]), dtype=np.bool_)
    for box in (a, b):
        for first, second in ((0, 1), (1, 2)):
            axis = box[..., second, :] - box[..., first, :]
            on_a = np.einsum("...ck,...k->...c", a, axis)
            on_b = np.einsum("...ck,...k->...c", b, axis)
            overlap &= (on_a.max(-1) >= on_b.min(-1)) & (on_b.max(-1) >= on_a.min(-1))
    return overlap
