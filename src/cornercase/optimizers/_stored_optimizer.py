"""Placeholder for the optimizer of a study if the class of the optimizer is not available."""

from __future__ import annotations

from typing import Any

from cornercase._common.errors import InputError
from cornercase._common.typing import FloatArray
from cornercase.optimizers._base import Optimizer
from cornercase.optimizers._registry import OPTIMIZERS
from cornercase.scenario import ParameterSpace


class StoredOptimizer(Optimizer):
    """Placeholder for an optimizer that is known only by the text in a study, such as ``mine:offset=0.25``.

    The placeholder has this text as its name, and refuses to search.
    """

    def __init__(self, text: str) -> None:
        self.name = text

    def prepare(self, space: ParameterSpace, seed: int, *further: Any, **required: Any) -> None:
        """Raise `InputError`, since a search needs the optimizer itself."""
        raise InputError(
            f"The study was searched with the optimizer '{self.name[:100]}', which is not among those of cornercase;"
            " cornercase does not load the code of an optimizer by a name in a study, so give the optimizer again as an"
            " object, as in explore(MyOptimizer(), …)."
        )

    def ask(self, n: int) -> FloatArray:
        """Raise `NotImplementedError`; never called, since `prepare` refuses a search."""
        raise NotImplementedError

    def tell(self, points: FloatArray, scores: FloatArray) -> None:
        """Raise `NotImplementedError`; never called, since `prepare` refuses a search."""
        raise NotImplementedError


def known_optimizer(text: str) -> str | Optimizer:
    """Return the stored text of an optimizer if an optimizer with the name in this text is registered.

    Otherwise return a placeholder (`StoredOptimizer`).
    """
    return text if text.partition(":")[0] in OPTIMIZERS else StoredOptimizer(text)
