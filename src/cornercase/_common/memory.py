"""Memory limit of a command, and the error if it is exceeded."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from math import ceil, floor, isfinite, log10
from numbers import Real
from typing import Final

from cornercase._common.errors import InputError
from cornercase._common.validation import repr_short

DEFAULT_MEMORY: Final = "4 GB"
"""Default of all ``memory`` arguments."""
# Memory of Python and its libraries without data, measured with a study of 400 scenarios. A constant, since blocks, and
# with them the last digits of sums, have to be the same on all machines.
_BASE_MEMORY: Final = 400_000_000
_MIN_LIMIT: Final = 500_000_000
_MIN_REPORTED: Final = 500_000_000
_UNIT_FACTORS: Final = {
    "": 1, "b": 1, "kb": 10**3, "mb": 10**6, "gb": 10**9, "tb": 10**12,
    "kib": 2**10, "mib": 2**20, "gib": 2**30, "tib": 2**40,
}  # fmt: skip
_SIZE_PATTERN: Final = re.compile(r"\s*(\d+(?:\.\d+)?|\.\d+)\s*([a-z]*)\s*", re.IGNORECASE | re.ASCII)


@dataclass(frozen=True)
class MemoryLimit:
    """Limit on the memory of the process, in bytes.

    >>> limit = MemoryLimit.from_value("4 GB")
    >>> limit.max_rows(8 * 50_000, share=0.25)
    2250
    """

    size: int

    @classmethod
    def from_value(cls, value: object) -> MemoryLimit:
        """Parse the argument ``memory``: a number of bytes, ``"4 GB"``, ``"500MB"``, ``"2 GiB"``, or a `MemoryLimit`.

        The limit must be at least 500 MB.
        """
        if isinstance(value, MemoryLimit):
            return value
        return cls(_parse_size(value))

    @property
    def free_bytes(self) -> int:
        """Number of bytes left for data: the limit minus the memory that Python and its libraries take."""
        return self.size - _BASE_MEMORY

    def max_rows(self, bytes_per_row: float, *, share: float = 1.0) -> int:
        """Return how many rows of `bytes_per_row` bytes fit into a share of the memory left for data; at least 1."""
        return max(1, int(self.free_bytes * share / max(bytes_per_row, 1.0)))

    def split_rows(self, count: int, bytes_per_row: float, *, share: float = 1.0) -> Iterator[slice]:
        """Yield slices that split `count` rows into blocks of about equal length; each block fits into the memory."""
        if count > 0:
            length = ceil(count / ceil(count / self.max_rows(bytes_per_row, share=share)))
            for start in range(0, count, length):
                yield slice(start, min(start + length, count))

    def fits(self, n_bytes: float) -> bool:
        """Return whether `n_bytes` bytes of data fit into the memory left for data."""
        return n_bytes <= self.free_bytes

    def check_fits(self, n_bytes: float, subject: str, advice: str) -> None:
        """Raise `InputError` if `n_bytes` bytes of data do not fit into the memory left for data.

        The message says that `subject`, a plural noun, needs too much memory, and ends with `advice`.
        """
        if not self.fits(n_bytes):
            raise InputError(
                f"{subject} need up to {format_size(n_bytes + _BASE_MEMORY)}, which is more than `memory`"
                f" {format_size(self.size)}; {advice}."
            )


def format_size(size: float) -> str:
    """Format a size in bytes, rounded up to two significant digits.

    >>> format_size(3_350_000_000), format_size(512_000_000)
    ('3.4 GB', '520 MB')
    """
    for unit, name in ((10**12, "TB"), (10**9, "GB"), (10**6, "MB"), (10**3, "kB")):
        # Above 990, two digits round up to 1,000, which belongs to the next unit.
        if size > 0.99 * unit:
            step = 10 ** (floor(log10(size / unit)) - 1)
            return f"{max(ceil(round(size / unit / step, 6)) * step, 1):.3g} {name}"
    return f"{ceil(size)} bytes"


def report_memory_need(subject: str, n_bytes: float) -> None:
    """Print to standard error how much memory `subject`, a plural noun, needs; print nothing below 500 MB."""
    if n_bytes >= _MIN_REPORTED:
        print(f"{subject} need about {format_size(n_bytes + _BASE_MEMORY)} of memory.", file=sys.stderr, flush=True)


def _parse_size(value: object) -> int:
    size = -1.0
    if isinstance(value, Real) and not isinstance(value, bool):
        size = float(value)
    elif isinstance(value, str) and (match := _SIZE_PATTERN.fullmatch(value)) and match[2].lower() in _UNIT_FACTORS:
        size = float(match[1]) * _UNIT_FACTORS[match[2].lower()]
    if not isfinite(size) or size <= 0:
        text = value if isinstance(value, str) and value.strip() else repr_short(value)
        raise InputError(f"`memory` {text}: give a size such as 4 GB or 500 MB.")
    if size < _MIN_LIMIT:
        raise InputError(
            f"`memory` {value}: give at least {format_size(_MIN_LIMIT)};"
            f" Python and its libraries take {format_size(_BASE_MEMORY)}."
        )
    return int(size)
