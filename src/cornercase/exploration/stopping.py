"""Stop criteria on how well the critical set is known."""

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

# Minimum number of scenarios to judge a critical set.
_LEAST: Final = 40

_FORM = re.compile(r"(?P<what>[a-z-]+)(?:\((?P<size>[^()]*)\))?<(?P<below>.+)")

_SIZED = ("overlooked", "unvisited")
_KINDS = ("missed", "interval", "audited-missed", *_SIZED)


@dataclass(frozen=True)
class Criterion:
    """An upper bound on a quantity of a `CriticalSet`.

    `what`: ``missed``: upper end of the 90 % interval of the missed fraction of the critical set, plus what an
    undetected region could add; ``interval``: width of the interval of the critical fraction of the space;
    ``audited-missed``: upper bound of the missed fraction by the audits; ``overlooked``: probability that a critical
    region was overlooked; ``unvisited``: fraction of the space around which nothing was run. `size` is the smallest
    region that counts, as a fraction of the space.
    """

    what: str
    below: float
    size: float = REGION

    @classmethod
    def parse(cls, text: str) -> Criterion:
        """Parse a criterion such as ``missed<0.01`` or ``overlooked(0.02)<0.05``."""
        match = _FORM.fullmatch(text.replace(" ", ""))
        if match is None or match["what"] not in _KINDS:
            raise InputError(
                f"`stop_when` {text}: write it as missed<0.01, interval<0.05, overlooked(0.01)<0.05,"
                " unvisited(0.01)<0.05 or audited-missed<0.1, in quotes."
            )
        if match["size"] is not None and match["what"] not in _SIZED:
            raise InputError(f"`stop_when` {text}: only overlooked and unvisited accept a size.")
        size = _share(match["size"], text) if match["size"] else REGION
        return cls(match["what"], _share(match["below"], text), size)

    def value(self, known: CriticalSet) -> float:
        """Value of the quantity, from 0 to 1; 1 if it is unknown."""
        if self.what == "missed":
            return 1.0 if known.missed_doubt else min(known.missed.high + known.hidden, 1.0)
        if self.what == "audited-missed":
            return known.audited_missed_at_most
        if self.what == "interval":
            return 1.0 if known.doubt else known.share.high - known.share.low
        return known.overlooked(self.size) if self.what == "overlooked" else known.unvisited(self.size)

    def words(self, value: float) -> str:
        """Describe the value that was reached."""
        if self.what == "missed":
            return f"at most {value:.2%} of the critical set is missed"
        if self.what == "audited-missed":
            return f"according to the audits, at most {value:.2%} of the critical set is missed"
        if self.what == "interval":
            return f"the critical share is known within {value:.2%}"
        if self.what == "unvisited":
            return f"in {value:.2%} of the space, no scenario was run within a region of {self.size:.2%}"
        return f"with a probability of {value:.2%} a critical region of {self.size:.2%} or more was overlooked"


class Stopping:
    """Collects results and checks if all stop criteria hold.

    `threshold` is a minimized score, `optimizer` the search (it determines which points are independent of scores).
    Raises `InputError` if there are criteria without a threshold, or ``audited-missed`` without audits.
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
        if not audited and any(criterion.what == "audited-missed" for criterion in criteria):
            raise InputError("`stop_when`: audited-missed needs audits; set `audit`, for example to 0.1.")
        if criteria and threshold is None:
            raise InputError("`stop_when`: needs a threshold; set one with `critical`.")
        self._criteria, self._space, self._threshold, self._seed = tuple(criteria), space, threshold, seed
        self._optimizer, self._elsewhere = optimizer, elsewhere
        self._points, self._scores = np.zeros((0, space.dimension)), np.zeros(0)
        self._audits, self._audited = self._points, self._scores
        self._features: list[FloatArray] = []

    def tell(self, points: FloatArray, scores: FloatArray, features: FloatArray | None = None) -> None:
        """Add points (m, d), minimized scores (m,), NaN if failed, and features (m, f) if the search uses them."""
        if self._criteria:
            self._features += [] if features is None else [features]
            self._points = np.concatenate([self._points, points])
            self._scores = np.concatenate([self._scores, scores])

    def tell_audits(self, points: FloatArray, scores: FloatArray) -> None:
        """Add audits as in `add_results`."""
        if self._criteria:
            self._audits = np.concatenate([self._audits, points])
            self._audited = np.concatenate([self._audited, scores])

    @property
    def ready(self) -> bool:
        """Whether there are criteria and enough scenarios to check them."""
        return bool(self._criteria) and len(self._scores) >= _LEAST

    def reason(self) -> str | None:
        """Describe how well the critical set is known if all criteria hold, else None."""
        if not self.ready or self._threshold is None:
            return None
        try:
            critical_set = CriticalSet(
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
        values = [criterion.value(critical_set) for criterion in self._criteria]
        if any(value >= criterion.below for criterion, value in zip(self._criteria, values, strict=True)):
            return None
        return " and ".join(criterion.words(value) for criterion, value in zip(self._criteria, values, strict=True))


def _share(text: str, whole: str) -> float:
    try:
        number = float(text)
    except ValueError:
        number = float("nan")
    if not 0.0 < number <= 1.0:
        raise InputError(f"`stop_when` {whole}: '{text}' has to be a number above 0 and up to 1.")
    return number
