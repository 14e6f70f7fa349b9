"""Kernels that are compiled only if they are needed, and called at their address."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest
from numba import types

from cornercase._common.numba.interpret import compile_at_once, interpret
from cornercase._common.numba.kernel import kernel
from cornercase._common.numba.late_kernels import LateKernels
from cornercase._common.numba.pointers import call_for_float
from cornercase._common.numba.tuple_pointers import reference_to
from cornercase._common.typing import FloatArray, IntArray

ADD, MULTIPLY = 0, 1


class Table(NamedTuple):
    values: FloatArray
    kernels: IntArray


@kernel(error_model="numpy", _nrt=False)
def add(table, factor):
    return table.values[0] + factor


@kernel(error_model="numpy", _nrt=False)
def multiply(table, factor):
    return table.values[0] * factor


@kernel(interpreted_seconds=lambda *_: 0.0, error_model="numpy")
def calculate(table, number, factor):
    arguments = (reference_to(table), factor)  # type: ignore[call-arg]
    if number == ADD:
        return call_for_float(add, table.kernels[ADD], arguments)
    return call_for_float(multiply, table.kernels[MULTIPLY], arguments)


def late_kernels():
    kernels = LateKernels({ADD: add, MULTIPLY: multiply}, types.float64)
    return kernels, Table(np.array([3.0]), kernels.addresses)


def test_only_the_kernels_that_are_needed_are_compiled():
    kernels, table = late_kernels()
    kernels.compile_needed([MULTIPLY, 7], table, types.float64)
    assert kernels.addresses[ADD] == 0
    with compile_at_once():
        assert calculate(table, MULTIPLY, 4.0) == 12.0
        with pytest.raises(RuntimeError, match="before it was compiled"):
            calculate(table, ADD, 4.0)
        kernels.compile_needed([], table, types.float64)
        assert calculate(table, ADD, 4.0) == 7.0


def test_interpreted_kernels_need_no_address():
    _, table = late_kernels()
    assert interpret(calculate, (table, ADD, 4.0)) == 7.0
    assert not table.kernels.any()


def test_other_types_than_those_of_the_call_are_refused():
    kernels, table = late_kernels()
    kernels.compile_needed([ADD], table, types.float64)
    with pytest.raises(TypeError, match="but earlier with"):
        late_kernels()[0].compile_needed([ADD], table, types.int64)
