"""Angles in kernels."""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, untyped-decorator"

from __future__ import annotations

import math

from cornercase._common.numba.kernel import kernel


@kernel(error_model="numpy", _nrt=False, forceinline=True)
def wrap_angle(angle):
    """Return an angle in rad, wrapped to [-π, π)."""
    turn = angle + math.pi
    # The division is the most expensive part, and rarely needed.
    return (turn if turn >= 0.0 and turn < 2.0 * math.pi else turn % (2.0 * math.pi)) - math.pi
