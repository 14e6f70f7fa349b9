"""Compiled search for the crossings of two tracks."""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, untyped-decorator"

from __future__ import annotations

from cornercase._common.compiling import kernel

# More than rounding makes of a product or a quotient.
_MORE = 1.0 + 1e-9


@kernel(error_model="numpy")
def find_crossings(start_a, unit_a, length_a, along_a, start_b, unit_b, length_b, along_b, parallel, reach, out):
    """Where the pieces of two tracks cross, as lengths along each, (2, most), by pieces of `a`; returns how many do.

    Pieces whose directions have a sine of at most `parallel` do not cross; one that ends up to `reach` short of the
    other meets it.
    """
    count = 0
    for i in range(len(length_a)):
        for j in range(len(length_b)):
            sine = unit_a[i, 0] * unit_b[j, 1] - unit_a[i, 1] * unit_b[j, 0]
            if not abs(sine) > parallel:
                continue
            apart_x, apart_y = start_b[j, 0] - start_a[i, 0], start_b[j, 1] - start_a[i, 1]
            over_a = apart_x * unit_b[j, 1] - apart_y * unit_b[j, 0]
            over_b = apart_x * unit_a[i, 1] - apart_y * unit_a[i, 0]
            # Nearly all pieces are far from each other, and a product takes less time than a quotient.
            if abs(over_a) > (length_a[i] + reach) * abs(sine) * _MORE:
                continue
            if abs(over_b) > (length_b[j] + reach) * abs(sine) * _MORE:
                continue
            on_a, on_b = over_a / sine, over_b / sine
            if -reach <= on_a <= length_a[i] + reach and -reach <= on_b <= length_b[j] + reach:
                if count < out.shape[1]:
                    out[0, count], out[1, count] = along_a[i] + on_a, along_b[j] + on_b
                count += 1
    return count
