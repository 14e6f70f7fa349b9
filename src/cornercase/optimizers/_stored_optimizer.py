"""The optimizer of a study whose class is not at hand."""

from __future__ import annotations

from typing import Any

from cornercase._common.errors import InputError
from cornercase._common.typing import FloatArray
from cornercase.optimizers._base import Optimizer
from cornercase.optimizers._registry import OPTIMIZERS
from cornercase.scenario import ParameterSpace


class StoredOptimizer(Optimizer):
    """Stands for an optimizer that only its text in a study describes; it is equal in text, and refuses to search."""

    def __init__(self, text: str) -> None:
        self.name = text

    def prepare(self, space: ParameterSpace, seed: int, *further: Any, **required: Any) -> None:
        """Raise `InputError`: the object is needed."""
        raise InputError(
            f"The study was searched with the optimizer '{self.name[:100]}', which is none of cornercase; code that a"
            " study names is not run, so give it again as an object, as in explore(MyOptimizer(), …)."
        )

    def ask(self, n: int) -> FloatArray:
        """Never called, since `prepare` refuses."""
        raise NotImplementedError

    def tell(self, points: FloatArray, scores: FloatArray) -> None:
        """Never called, since `prepare` refuses."""
        raise NotImplementedError


def known_optimizer(text: str) -> str | Optimizer:
    """Return the text of a registered optimizer; for any other text, what stands for the optimizer."""
    return text if text.partition(":")[0] in OPTIMIZERS else StoredOptimizer(text)
