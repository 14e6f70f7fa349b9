"""Arrays that kernels read where they lie, by their addresses.

The types of a kernel must not hang on how many arrays there are, or it is compiled anew for each number. A table of
addresses is one array, whatever it leads to.
"""

# The part of numba that is used here has no types.
# mypy: disable-error-code="no-untyped-call, no-untyped-def, misc, untyped-decorator, attr-defined, call-arg"

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from numba import carray, types
from numba.extending import intrinsic

from cornercase._common.compiling import kernel


def address_of(array: npt.NDArray[Any]) -> int:
    """Address of the first element of an array, which must outlive each use of the address.

    Parameters
    ----------
    array : ndarray
        C-contiguous.

    Returns
    -------
    int
    """
    assert array.flags.c_contiguous
    address: int = array.__array_interface__["data"][0]
    return address


@intrinsic
def _pointer(context, address):
    def generate(context, builder, signature, values):
        return builder.inttoptr(values[0], context.get_value_type(signature.return_type))

    return types.voidptr(types.int64), generate


@kernel(error_model="numpy", forceinline=True)
def floats_at(address, count):
    """Array of float64 at an address.

    Parameters
    ----------
    address : int
    count : int

    Returns
    -------
    ndarray of float64, shape (count,)
    """
    return carray(_pointer(address), (count,), np.float64)


@kernel(error_model="numpy", forceinline=True)
def integers_at(address, count):
    """Array of int64 at an address.

    Parameters
    ----------
    address : int
    count : int

    Returns
    -------
    ndarray of int64, shape (count,)
    """
    return carray(_pointer(address), (count,), np.int64)


@kernel(error_model="numpy", forceinline=True)
def truths_at(address, count):
    """Array of bool at an address.

    Parameters
    ----------
    address : int
    count : int

    Returns
    -------
    ndarray of bool, shape (count,)
    """
    return carray(_pointer(address), (count,), np.bool_)
