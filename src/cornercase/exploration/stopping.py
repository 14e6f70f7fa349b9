"""When enough is known of a critical set to stop."""

from __future__ import annotations

import re
from dataclasses import dataclass

from cornercase._common.errors import InputError
from cornercase.evidence import REGION, CriticalSet

_FORM = re.compile(r"(?P<what>[a-z]+)(?:\((?P<size>[^()]*)\))?<(?P<below>.+)")

_SIZED = ("overlooked", "unvisited")
_KINDS = ("missed", "interval", *_SIZED)


@dataclass(frozen=True)
class Criterion:
    """A quantity of a `CriticalSet` that is to fall below a limit.

    Attributes
    ----------
    what : {"missed", "interval", "overlooked", "unvisited"}
        The upper end of the 90 % interval of the share of the critical set that is missed; the width of that of the
        critical share of the space; the probability that a critical region was overlooked; the share of the space
        around which nothing was run.
    below : float
    size : float
        Share of the space from which a region counts.
    """

    what: str
    below: float
    size: float = REGION

    @classmethod
    def parse(cls, text: str) -> Criterion:
        """Criterion of a text such as ``missed<0.01`` or ``overlooked(0.02)<0.05``.

        Raises
        ------
        InputError
        """
        match = _FORM.fullmatch(text.replace(" ", ""))
        if match is None or match["what"] not in _KINDS:
            raise InputError(
                f"--stop-when {text}: write it as missed<0.01, interval<0.05, overlooked(0.01)<0.05 or"
                " unvisited(0.01)<0.05, in quotes."
            )
        if match["size"] is not None and match["what"] not in _SIZED:
            raise InputError(f"--stop-when {text}: only overlooked and unvisited take a size.")
        size = _share(match["size"], text) if match["size"] else REGION
        return cls(match["what"], _share(match["below"], text), size)

    def value(self, known: CriticalSet) -> float:
        """What the quantity is."""
        if self.what == "missed":
            return known.missed.high
        if self.what == "interval":
            return known.share.high - known.share.low
        return known.overlooked(self.size) if self.what == "overlooked" else known.unvisited(self.size)

    def words(self, value: float) -> str:
        """Say what was reached."""
        if self.what == "missed":
            return f"at most {value:.2%} of the critical set is missed"
        if self.what == "interval":
            return f"the critical share is known within {value:.2%}"
        if self.what == "unvisited":
            return f"a region of {self.size:.2%} in {value:.2%} of the space would hold nothing that was run"
        return f"with a probability of {value:.2%} a critical region of {self.size:.2%} or more was overlooked"


def _share(text: str, whole: str) -> float:
    try:
        number = float(text)
    except ValueError:
        number = float("nan")
    if not 0.0 < number <= 1.0:
        raise InputError(f"--stop-when {whole}: '{text}' has to be a number above 0 and up to 1.")
    return number
