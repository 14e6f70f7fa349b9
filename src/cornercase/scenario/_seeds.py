"""Seeds of the random numbers in concrete scenarios."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from typing import Any, overload

import numpy as np

from cornercase.scenario._types import format_value


def seed_of_run(seed: int, run: int) -> int:
    """Return the seed of run number `run` of a repeated scenario; run 0 has `seed` itself."""
    return seed + (run << 32)


class ScenarioSeeds(Sequence[int]):
    """Seeds of N concrete scenarios; each seed is a hash of the run's seed and of all parameter values.

    A scenario has the same seed in any batch. It also has the same seed whether a parameter value is given explicitly
    or is the default of the file. `values` has a scalar or an array of shape (N,) for each parameter. A seed is
    computed only when it is read.
    """

    def __init__(self, run_seeds: Sequence[int], values: Mapping[str, Any]) -> None:
        self._run_seeds, self._values = run_seeds, dict(sorted(values.items()))

    def __len__(self) -> int:
        return len(self._run_seeds)

    @overload
    def __getitem__(self, index: int) -> int: ...

    @overload
    def __getitem__(self, index: slice) -> tuple[int, ...]: ...

    def __getitem__(self, index: int | slice) -> int | tuple[int, ...]:
        if isinstance(index, slice):
            return tuple(self[k] for k in range(*index.indices(len(self))))
        parts = [str(self._run_seeds[index])]
        for name, value in self._values.items():
            parts.append(f"{name}={format_value(value[index] if np.ndim(value) else value)}")
        return int.from_bytes(hashlib.blake2b("\0".join(parts).encode(), digest_size=8).digest(), "little")
