"""Error for a batch of scenarios that has to be split."""

from __future__ import annotations


class BatchSplitError(Exception):
    """Error if an attribute has different values in a batch of scenarios, but must have the same value in all.

    A batch is simulated together. The attribute depends on the varied parameters `parameter_names`. Whoever catches the
    error splits the batch, so that these parameters have equal values in each part.
    """

    def __init__(self, parameter_names: set[str]) -> None:
        super().__init__(f"varies with {', '.join(sorted(parameter_names))}")
        self.parameter_names = parameter_names
