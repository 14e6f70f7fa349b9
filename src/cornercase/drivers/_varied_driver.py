"""Drivers of cornercase whose options can differ between scenarios that are simulated together."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence

from cornercase.drivers._base import Driver


class VariedDriver(Driver):
    """Base class of drivers of cornercase whose options can differ between scenarios."""

    @abstractmethod
    def vary(self, options: Sequence[Mapping[str, float]]) -> None:
        """Change options of the driver in each of N scenarios, after the driver was started.

        Parameters
        ----------
        options : sequence of mapping of str to float, length N
            For each scenario, the names of the changed options and their new values.
        """
