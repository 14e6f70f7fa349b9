"""Drivers of cornercase whose options can differ between scenarios that are simulated together."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence

from cornercase.drivers._base import Driver


class VariedDriver(Driver):
    """Base class of drivers of cornercase that can have other options in each scenario."""

    @abstractmethod
    def vary(self, options: Sequence[Mapping[str, float]]) -> None:
        """Change options of the started driver in each of N scenarios.

        Parameters
        ----------
        options : sequence of mapping of str to float, length N
            Changed options of each scenario by name.
        """
