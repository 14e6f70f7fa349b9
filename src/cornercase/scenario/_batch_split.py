"""Signal that a batch of scenarios has to be split."""

from __future__ import annotations


class BatchSplitError(Exception):
    """An attribute that shapes the storyboard differs between scenarios of a batch.

    It depends on the varied parameters `parameter_names`; the batch has to be split by their values.
    """

    def __init__(self, parameter_names: set[str]) -> None:
        super().__init__(f"varies with {', '.join(sorted(parameter_names))}")
        self.parameter_names = parameter_names
