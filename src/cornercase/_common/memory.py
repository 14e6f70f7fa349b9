"""How much memory a command may take, and what it says where it needs more."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from math import ceil, floor, isfinite, log10
from numbers import Real
from typing import Final

from cornercase._common.arguments import shown
from cornercase._common.errors import InputError

DEFAULT_MEMORY: Final = "4 GB"
"""Of everything that takes ``memory``."""
# What Python and the libraries take before any data, as measured with a study of 400 scenarios. It is not asked of the
# machine: blocks, and with them the last digits of sums, have to be the same everywhere.
_LOADED: Final = 400_000_000
_LEAST: Final = 500_000_000
_WORTH_SAYING: Final = 500_000_000
_UNITS: Final = {
    "": 1, "b": 1, "kb": 10**3, "mb": 10**6, "gb": 10**9, "tb": 10**12,
    "kib": 2**10, "mib": 2**20, "gib": 2**30, "tib": 2**40,
}  # fmt: skip
_SIZE: Final = re.compile(r"\s*(\d+(?:\.\d+)?|\.\d+)\s*([a-z]*)\s*", re.IGNORECASE | re.ASCII)


@dataclass(frozen=True)
class MemoryLimit:
    """How much memory the process may take in all.

    Attributes
    ----------
    size : int
        Bytes.

    Examples
    --------
    >>> limit = MemoryLimit.of("4 GB")
    >>> limit.rows(8 * 50_000, share=0.25)
    2250
    """

    size: int

    @classmethod
    def of(cls, value: object) -> MemoryLimit:
        """Take what was given as ``memory``.

        Parameters
        ----------
        value : object
            Number of bytes, or a text such as ``"4 GB"``, ``"500MB"`` or ``"2 GiB"``; or a limit already.

        Returns
        -------
        MemoryLimit

        Raises
        ------
        InputError
            It is no size, or one below 500 MB.
        """
        if isinstance(value, MemoryLimit):
            return value
        return cls(_bytes_of(value))

    @property
    def free(self) -> int:
        """Bytes for data: all but what Python and its libraries take."""
        return self.size - _LOADED

    def rows(self, row: float, *, share: float = 1.0) -> int:
        """Count the rows that may be in memory at the same time.

        Parameters
        ----------
        row : float
            Bytes of one.
        share : float, default 1
            Of what is free, for these rows.

        Returns
        -------
        int
            At least 1.
        """
        return max(1, int(self.free * share / max(row, 1.0)))

    def blocks(self, count: int, row: float, *, share: float = 1.0) -> Iterator[slice]:
        """Split rows into blocks of about the same length, each of which fits.

        Parameters
        ----------
        count : int
            Rows in all.
        row : float
            Bytes of one.
        share : float, default 1
            Of what is free, for a block.

        Yields
        ------
        slice
            Of the rows; the first ones first.
        """
        if count > 0:
            length = ceil(count / ceil(count / self.rows(row, share=share)))
            for start in range(0, count, length):
                yield slice(start, min(start + length, count))

    def holds(self, need: float) -> bool:
        """Say whether so much data fits.

        Parameters
        ----------
        need : float
            Bytes.

        Returns
        -------
        bool
        """
        return need <= self.free

    def require(self, need: float, what: str, instead: str) -> None:
        """Refuse what does not fit.

        Parameters
        ----------
        need : float
            Bytes of data.
        what : str
            What needs them, in the plural: ``"the distances of 50,000 scenarios"``.
        instead : str
            What to do: ``"give more, or analyze fewer aspects at a time with `by`"``.

        Raises
        ------
        InputError
            It does not fit.
        """
        if not self.holds(need):
            raise InputError(
                f"{what} need up to {size_in_words(need + _LOADED)}, which is more than `memory`"
                f" {size_in_words(self.size)}; {instead}."
            )


def size_in_words(size: float) -> str:
    """Say how much memory that is.

    Parameters
    ----------
    size : float
        Bytes.

    Returns
    -------
    str
        With two digits that count, rounded up: ``"3.4 GB"``.

    Examples
    --------
    >>> size_in_words(3_350_000_000), size_in_words(512_000_000)
    ('3.4 GB', '520 MB')
    """
    for unit, name in ((10**12, "TB"), (10**9, "GB"), (10**6, "MB"), (10**3, "kB")):
        # Two digits of what is above 990 round up to 1,000, which is one of the next unit.
        if size > 0.99 * unit:
            step = 10 ** (floor(log10(size / unit)) - 1)
            return f"{max(ceil(round(size / unit / step, 6)) * step, 1):.3g} {name}"
    return f"{ceil(size)} bytes"


def state_need(what: str, need: float) -> None:
    """Say on standard error how much memory something will take, where that is worth saying.

    Parameters
    ----------
    what : str
        What takes it, in the plural: ``"Distances of 20,000 scenarios"``.
    need : float
        Bytes of data; nothing is said below 500 MB.
    """
    if need >= _WORTH_SAYING:
        print(f"{what} need about {size_in_words(need + _LOADED)} of memory.", file=sys.stderr, flush=True)


def _bytes_of(value: object) -> int:
    found = -1.0
    if isinstance(value, Real) and not isinstance(value, bool):
        found = float(value)
    elif isinstance(value, str) and (match := _SIZE.fullmatch(value)) and match[2].lower() in _UNITS:
        found = float(match[1]) * _UNITS[match[2].lower()]
    if not isfinite(found) or found <= 0:
        written = value if isinstance(value, str) and value.strip() else shown(value)
        raise InputError(f"`memory` {written}: give a size such as 4 GB or 500 MB.")
    if found < _LEAST:
        raise InputError(
            f"`memory` {value}: give at least {size_in_words(_LEAST)};"
            f" Python and its libraries take {size_in_words(_LOADED)}."
        )
    return int(found)
