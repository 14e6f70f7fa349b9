"""Compiled search for the crossings of two tracks."""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, untyped-decorator"

from __future__ import annotations

from cornercase._common.compiling import kernel

# More than rounding makes of a product or a quotient.
_MORE = 1.0 + 1e-9


@kernel(error_model="numpy")
def find_crossings(a, b, parallel, reach, out):
    """Where the pieces of two tracks cross, as lengths along each, (2, most), by pieces of `a`; returns how many do.

    Of each piece, (n, 6), there are its start, its direction, its length, and how far along the track it begins. Pieces
    whose directions have a sine of at most `parallel` do not cross; one that ends up to `reach` short of the other
    meets it.
    """
    count = 0
    for i in range(len(a)):
        x_a, y_a, cos_a, sin_a, length_a, along_a = a[i]
        for j in range(len(b)):
            x_b, y_b, cos_b, sin_b, length_b, along_b = b[j]
            sine = cos_a * sin_b - sin_a * cos_b
            if not abs(sine) > parallel:
                continue
            over_a = (x_b - x_a) * sin_b - (y_b - y_a) * cos_b
            over_b = (x_b - x_a) * sin_a - (y_b - y_a) * cos_a
            # Nearly all pieces are far from each other, and a product takes less time than a quotient.
            most = abs(sine) * _MORE
            if abs(over_a) > (length_a + reach) * most or abs(over_b) > (length_b + reach) * most:
                continue
            on_a, on_b = over_a / sine, over_b / sine
            if -reach <= on_a <= length_a + reach and -reach <= on_b <= length_b + reach:
                if count < out.shape[1]:
                    out[0, count], out[1, count] = along_a + on_a, along_b + on_b
                count += 1
    return count
