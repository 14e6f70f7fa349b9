"""Tracks in the plane as a small drawing for notebooks."""

from __future__ import annotations

from typing import Final

import numpy as np

from cornercase._common.typing import FloatArray

COLORS: Final = ("#1f77b4", "#d62728", "#2ca02c", "#9467bd", "#ff7f0e", "#8c564b", "#e377c2", "#7f7f7f")
# Pixels of the drawing and of its margin, and the most points of a track in it.
_WIDTH, _HEIGHT, _MARGIN = 420.0, 240.0, 8.0
_POINTS: Final = 400


def tracks_as_svg(x: FloatArray, y: FloatArray) -> str:
    """Draw where entities go, each in the next of `COLORS`, with a dot where it begins.

    Parameters
    ----------
    x, y : ndarray of float64, shape (A, T)
        m; NaN where an entity does not exist.

    Returns
    -------
    str
        An ``<svg>`` element of equal scales, with y upwards; empty where no entity ever exists.
    """
    there = np.isfinite(x) & np.isfinite(y)
    if not there.any():
        return ""
    left, right, low, high = x[there].min(), x[there].max(), y[there].min(), y[there].max()
    # All positions may be the same; then the scale is that of 1 m.
    scale = min((_WIDTH - 2 * _MARGIN) / max(right - left, 1.0), (_HEIGHT - 2 * _MARGIN) / max(high - low, 1.0))
    width, height = scale * (right - left) + 2 * _MARGIN, scale * (high - low) + 2 * _MARGIN
    drawn = []
    for a in range(len(x)):
        color = COLORS[a % len(COLORS)]
        across, down = _MARGIN + scale * (x[a] - left), _MARGIN + scale * (high - y[a])
        # Where an entity is gone for a while, its track has a gap.
        for piece in np.split(np.arange(x.shape[1]), np.flatnonzero(np.diff(there[a])) + 1):
            if not there[a, piece[0]]:
                continue
            kept = piece[np.unique(np.linspace(0, len(piece) - 1, min(len(piece), _POINTS)).astype(int))]
            points = " ".join(f"{across[k]:.1f},{down[k]:.1f}" for k in kept)
            drawn.append(f'<polyline points="{points}" fill="none" stroke="{color}" stroke-width="2"/>')
        for k in np.flatnonzero(there[a])[:1]:
            drawn.append(f'<circle cx="{across[k]:.1f}" cy="{down[k]:.1f}" r="4" fill="{color}"/>')
    return (
        f'<svg width="{width:.0f}" height="{height:.0f}" viewBox="0 0 {width:.1f} {height:.1f}">{"".join(drawn)}</svg>'
    )
