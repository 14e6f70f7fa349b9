"""Kernels that are compiled only when scenarios need them; compiled code calls them at an address in a table.

For example, only the kinds of actions that occur are compiled. A call at an address takes as long as an ordinary call,
but LLVM cannot inline it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from threading import Lock
from typing import Any

import numpy as np

from cornercase._common.numba.interpret import must_compile_at_once
from cornercase._common.numba.tuple_pointers import reference_type
from cornercase._common.typing import IntArray


class LateKernels:
    """Numbered kernels with the same types of arguments that are compiled only when they are needed.

    `addresses[number]` is the address of a kernel, or 0 while the kernel is not compiled. Functions such as
    `pointers.call_for_int` call a kernel at its address.
    """

    def __init__(self, kernels: dict[int, Callable[..., Any]], result: Any) -> None:
        """Store kernels by number; `result` is numba's type of their results."""
        self.addresses: IntArray = np.zeros(max(kernels) + 1, dtype=np.int64)
        self._kernels: dict[int, Any] = dict(kernels)
        self._result, self._lock = result, Lock()

    def compile_needed(self, numbers: Iterable[int], *arguments: Any) -> None:
        """Compile the kernels with these numbers, unless they are compiled already, for the types of `arguments`.

        Named tuples are passed by reference. A numba type may be given instead of an argument. Numbers without a kernel
        are ignored. Within `compile_at_once`, as in `warm-up`, all kernels are compiled.
        """
        needed = self._kernels if must_compile_at_once() else self._kernels.keys() & set(numbers)
        if all(self.addresses[number] for number in needed):
            return
        kinds = tuple(map(reference_type, arguments))
        with self._lock:
            for number in sorted(needed):
                if not self.addresses[number]:
                    self.addresses[number] = self._kernels[number].compile_to_address(kinds, self._result)
