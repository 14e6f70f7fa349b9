"""Small SVG drawings of tracks for notebooks."""

from __future__ import annotations

from typing import Final

import numpy as np

from cornercase._common.typing import FloatArray

TRACK_COLORS: Final = ("#1f77b4", "#d62728", "#2ca02c", "#9467bd", "#ff7f0e", "#8c564b", "#e377c2", "#7f7f7f")
# Size and margin in pixels, and largest number of points of a track.
_WIDTH, _HEIGHT, _MARGIN = 420.0, 240.0, 8.0
_MAX_POINTS: Final = 400


def draw_tracks(x: FloatArray, y: FloatArray) -> str:
    """Draw the tracks of A entities as SVG, with a dot at each start; empty if no entity ever exists.

    `x` and `y` are in m, shape (A, T), NaN while an entity does not exist. Colors follow `TRACK_COLORS`.
    """
    exists = np.isfinite(x) & np.isfinite(y)
    if not exists.any():
        return ""
    left, right, low, high = x[exists].min(), x[exists].max(), y[exists].min(), y[exists].max()
    # Scale to at least 1 m, as all positions may be equal.
    scale = min((_WIDTH - 2 * _MARGIN) / max(right - left, 1.0), (_HEIGHT - 2 * _MARGIN) / max(high - low, 1.0))
    width, height = scale * (right - left) + 2 * _MARGIN, scale * (high - low) + 2 * _MARGIN
    elements = []
    for a in range(len(x)):
        color = TRACK_COLORS[a % len(TRACK_COLORS)]
        across, down = _MARGIN + scale * (x[a] - left), _MARGIN + scale * (high - y[a])
        # Interrupt the track while the entity does not exist.
        for piece in np.split(np.arange(x.shape[1]), np.flatnonzero(np.diff(exists[a])) + 1):
            if not exists[a, piece[0]]:
                continue
            shown = piece[np.unique(np.linspace(0, len(piece) - 1, min(len(piece), _MAX_POINTS)).astype(int))]
            points = " ".join(f"{across[k]:.1f},{down[k]:.1f}" for k in shown)
            elements.append(f'<polyline points="{points}" fill="none" stroke="{color}" stroke-width="2"/>')
        for k in np.flatnonzero(exists[a])[:1]:
            elements.append(f'<circle cx="{across[k]:.1f}" cy="{down[k]:.1f}" r="4" fill="{color}"/>')
    size = f'width="{width:.0f}" height="{height:.0f}" viewBox="0 0 {width:.1f} {height:.1f}"'
    return f"<svg {size}>{''.join(elements)}</svg>"
