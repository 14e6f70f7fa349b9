"""What says that a batch has to be split."""

from __future__ import annotations


class VariesError(Exception):
    """An attribute that shapes the storyboard differs between the scenarios of a batch.

    Parameters
    ----------
    names : set of str
        The varied parameters that it depends on; the batch has to be split by their values.

    Attributes
    ----------
    names : set of str
    """

    def __init__(self, names: set[str]) -> None:
        super().__init__(f"varies with {', '.join(sorted(names))}")
        self.names = names
