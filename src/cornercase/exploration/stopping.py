"""When enough is known of a critical set to stop."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from cornercase._common.errors import InputError
from cornercase._common.typing import FloatArray
from cornercase.evidence import REGION, CriticalSet, Elsewhere
from cornercase.exploration.judging import chosen_blindly
from cornercase.metrics import known_features
from cornercase.scenario import ParameterSpace

_LEAST: Final = 40
"""Scenarios below which nothing is said about a critical set."""

_FORM = re.compile(r"(?P<what>[a-z-]+)(?:\((?P<size>[^()]*)\))?<(?P<below>.+)")

_SIZED = ("overlooked", "unvisited")
_KINDS = ("missed", "interval", "audited-missed", *_SIZED)


@dataclass(frozen=True)
class Criterion:
    """A quantity of a `CriticalSet` that is to fall below a number.

    Attributes
    ----------
    what : {"missed", "interval", "audited-missed", "overlooked", "unvisited"}
        The upper end of the 90 % interval of the share of the critical set that is missed, and what a region that
        nothing points to could add to it; the width of the interval of the critical share of the space; what is missed
        at most by the audits; the probability that a critical region was overlooked; the share of the space around
        which nothing was run.
    below : float
    size : float
        Share of the space from which a region counts.
    """

    what: str
    below: float
    size: float = REGION

    @classmethod
    def parse(cls, text: str) -> Criterion:
        """Read a criterion such as ``missed<0.01`` or ``overlooked(0.02)<0.05``.

        Parameters
        ----------
        text : str

        Returns
        -------
        Criterion

        Raises
        ------
        InputError
            It is none.
        """
        match = _FORM.fullmatch(text.replace(" ", ""))
        if match is None or match["what"] not in _KINDS:
            raise InputError(
                f"`stop_when` {text}: write it as missed<0.01, interval<0.05, overlooked(0.01)<0.05,"
                " unvisited(0.01)<0.05 or audited-missed<0.1, in quotes."
            )
        if match["size"] is not None and match["what"] not in _SIZED:
            raise InputError(f"`stop_when` {text}: only overlooked and unvisited take a size.")
        size = _share(match["size"], text) if match["size"] else REGION
        return cls(match["what"], _share(match["below"], text), size)

    def value(self, known: CriticalSet) -> float:
        """Value of the quantity, from 0 to 1; 1 where nothing can be said of it."""
        if self.what == "missed":
            return 1.0 if known.missed_doubt else min(known.missed.high + known.hidden, 1.0)
        if self.what == "audited-missed":
            return known.audited_missed_at_most
        if self.what == "interval":
            return 1.0 if known.doubt else known.share.high - known.share.low
        return known.overlooked(self.size) if self.what == "overlooked" else known.unvisited(self.size)

    def words(self, value: float) -> str:
        """Say what was reached."""
        if self.what == "missed":
            return f"at most {value:.2%} of the critical set is missed"
        if self.what == "audited-missed":
            return f"by the audits at most {value:.2%} of the critical set is missed"
        if self.what == "interval":
            return f"the critical share is known within {value:.2%}"
        if self.what == "unvisited":
            return f"a region of {self.size:.2%} in {value:.2%} of the space would hold nothing that was run"
        return f"with a probability of {value:.2%} a critical region of {self.size:.2%} or more was overlooked"


class Stopping:
    """Tells when enough is known of the critical set: when all criteria are fulfilled.

    Parameters
    ----------
    criteria : sequence of Criterion
        Without any, never.
    space : ParameterSpace
    threshold : float or None
        Oriented score up to which a scenario is critical.
    seed : int
    optimizer : str
        Name of the search, which says what of it fills the space.
    audited : bool, default False
        Whether there are audits.
    elsewhere : Elsewhere, optional
        What the study that the search began from predicts.

    Raises
    ------
    InputError
        There are criteria but no threshold, or one that needs audits.
    """

    def __init__(
        self,
        criteria: Sequence[Criterion],
        space: ParameterSpace,
        threshold: float | None,
        seed: int,
        optimizer: str,
        audited: bool = False,
        elsewhere: Elsewhere | None = None,
    ) -> None:
        if not audited and any(one.what == "audited-missed" for one in criteria):
            raise InputError("`stop_when`: audited-missed needs audits; ask for some with `audit`, such as 0.1.")
        if criteria and threshold is None:
            raise InputError("`stop_when`: needs a threshold; give one with `critical`.")
        self._criteria, self._space, self._threshold, self._seed = tuple(criteria), space, threshold, seed
        self._optimizer, self._elsewhere = optimizer, elsewhere
        self._points, self._scores = np.zeros((0, space.dimension)), np.zeros(0)
        self._audits, self._audited = self._points, self._scores
        self._features: list[FloatArray] = []

    def tell(self, points: FloatArray, scores: FloatArray, features: FloatArray | None = None) -> None:
        """Take oriented scores, shape (m,), of points, shape (m, d); NaN for a scenario that failed.

        Where the search learns from features of the recordings, of shape (m, f), they judge it too.
        """
        if self._criteria:
            self._features += [] if features is None else [features]
            self._points = np.concatenate([self._points, points])
            self._scores = np.concatenate([self._scores, scores])

    def tell_audits(self, points: FloatArray, scores: FloatArray) -> None:
        """Take audits as in `tell`."""
        if self._criteria:
            self._audits = np.concatenate([self._audits, points])
            self._audited = np.concatenate([self._audited, scores])

    @property
    def ready(self) -> bool:
        """Whether there are criteria, and enough scenarios to judge them."""
        return bool(self._criteria) and len(self._scores) >= _LEAST

    def reason(self) -> str | None:
        """Say why enough is known; None while it is not."""
        if not self.ready or self._threshold is None:
            return None
        try:
            known = CriticalSet(
                self._space,
                self._points,
                self._scores,
                self._threshold,
                self._seed,
                filling=chosen_blindly(self._optimizer, self._space, self._seed, self._points),
                audits=(self._audits, self._audited),
                happened=(known_features(), np.concatenate(self._features)) if self._features else None,
                elsewhere=self._elsewhere,
            )
        except ValueError:
            return None
        values = [criterion.value(known) for criterion in self._criteria]
        if any(value >= one.below for one, value in zip(self._criteria, values, strict=True)):
            return None
        return " and ".join(one.words(value) for one, value in zip(self._criteria, values, strict=True))


def _share(text: str, whole: str) -> float:
    try:
        number = float(text)
    except ValueError:
        number = float("nan")
    if not 0.0 < number <= 1.0:
        raise InputError(f"`stop_when` {whole}: '{text}' has to be a number above 0 and up to 1.")
    return number
