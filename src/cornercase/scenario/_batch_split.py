"""Error for a batch of scenarios that has to be split."""

from __future__ import annotations


class BatchSplitError(Exception):
    """Error if the scenarios of a batch (simulated together) differ in an attribute that must be the same for all.

    The attribute depends on the varied parameters `parameter_names`: split the batch by their values.
    """

    def __init__(self, parameter_names: set[str]) -> None:
        super().__init__(f"varies with {', '.join(sorted(parameter_names))}")
        self.parameter_names = parameter_names
