"""Compiled search for the crossings of two tracks."""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, untyped-decorator"

from __future__ import annotations

from cornercase._common.numba.kernel import kernel

_ROUNDING = 1.0 + 1e-9  # relative tolerance, more than the rounding error of a product or quotient


@kernel(error_model="numpy")
def find_track_crossings(pieces_a, pieces_b, min_sine, tolerance, out):
    """Find the crossings of two tracks; return their number.

    The distances along both tracks to the crossings are written to `out`, shape (2, capacity); crossings beyond the
    capacity are only counted. A track is an array of n straight pieces, shape (n, 6): start, unit direction, length,
    and distance along the track. Two pieces do not cross if the sine of the angle between them is at most `min_sine`. A
    piece that ends at most `tolerance` before the other track still crosses it.
    """
    count = 0
    for i in range(len(pieces_a)):
        x_a, y_a, cos_a, sin_a, length_a, along_a = pieces_a[i]
        for j in range(len(pieces_b)):
            x_b, y_b, cos_b, sin_b, length_b, along_b = pieces_b[j]
            sine = cos_a * sin_b - sin_a * cos_b
            if not abs(sine) > min_sine:
                continue
            over_a = (x_b - x_a) * sin_b - (y_b - y_a) * cos_b
            over_b = (x_b - x_a) * sin_a - (y_b - y_a) * cos_a
            # Nearly all pieces are far from each other, and a product is faster than a quotient.
            scale = abs(sine) * _ROUNDING
            if abs(over_a) > (length_a + tolerance) * scale or abs(over_b) > (length_b + tolerance) * scale:
                continue
            on_a, on_b = over_a / sine, over_b / sine
            if -tolerance <= on_a <= length_a + tolerance and -tolerance <= on_b <= length_b + tolerance:
                if count < out.shape[1]:
                    out[0, count], out[1, count] = along_a + on_a, along_b + on_b
                count += 1
    return count
