"""Kernels that are compiled only if a batch needs them; compiled code calls them at an address in a table.

So a scenario with one kind of action compiles one kind of action. Such a call takes as long as an ordinary one, but
LLVM cannot inline it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from threading import Lock
from typing import Any

import numpy as np

from cornercase._common.numba.interpret import are_all_compiled
from cornercase._common.numba.tuple_pointers import reference_type
from cornercase._common.typing import IntArray


class LateKernels:
    """Numbered kernels that take the same types of arguments; `pointers.call_for_int` and so on call them.

    `addresses[number]` is the address of a kernel, or 0 while it is not compiled.
    """

    def __init__(self, kernels: dict[int, Callable[..., Any]], result: Any) -> None:
        """Take kernels by number, and numba's type of their results."""
        self.addresses: IntArray = np.zeros(max(kernels) + 1, dtype=np.int64)
        self._kernels: dict[int, Any] = dict(kernels)
        self._result, self._lock = result, Lock()

    def link(self, numbers: Iterable[int], *arguments: Any) -> None:
        """Compile the kernels with some numbers, if they are not yet, for arguments of these types.

        Named tuples are passed by reference; a numba type stands for itself. Numbers without a kernel do
        not matter. In `warm-up`, all are compiled.
        """
        needed = self._kernels if are_all_compiled() else self._kernels.keys() & set(numbers)
        if all(self.addresses[number] for number in needed):
            return
        kinds = tuple(map(reference_type, arguments))
        with self._lock:
            for number in sorted(needed):
                if not self.addresses[number]:
                    self.addresses[number] = self._kernels[number].compile_to_address(kinds, self._result)
