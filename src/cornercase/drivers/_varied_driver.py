"""Drivers of cornercase whose options can differ between the scenarios of a batch."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence

from cornercase.drivers._base import Driver


class VariedDriver(Driver):
    """A driver of cornercase that can have other options in each scenario of a batch."""

    @abstractmethod
    def vary(self, options: Sequence[Mapping[str, float]]) -> None:
        """Give the started driver its options in each of the N scenarios.

        Parameters
        ----------
        options : sequence of mapping of str to float, length N
            By name.
        """
