"""What is run next, and what a search was told before it said so."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import groupby
from typing import Any

import numpy as np

from cornercase._common.parts import guarded
from cornercase._common.typing import FloatArray
from cornercase.exploration.judging import audits_of
from cornercase.optimizers import Optimizer
from cornercase.study import Row, Study, count_audits


class Search:
    """An optimizer that is asked in rounds, or without rounds beside what is being run.

    Parameters
    ----------
    optimizer : Optimizer
    asynchronous : bool

    Attributes
    ----------
    pending : ndarray of float64, shape (p, d)
        Points that are being run while it is asked, of a search without rounds.
    """

    def __init__(self, optimizer: Optimizer, asynchronous: bool) -> None:
        self._optimizer, self._asynchronous = optimizer, asynchronous
        self.pending: FloatArray | None = None
        self._name = f"The search '{optimizer.name}'"
        self._sums: list[list[FloatArray]] = []

    def ask(self, n: int) -> FloatArray:
        """Propose at most `n` points, shape (m, d), as in `Optimizer.ask`."""
        with guarded(self._name, self._optimizer, "in ask"):
            if not self._asynchronous:
                return self._optimizer.ask(n)
            points = np.zeros((0, 0)) if self.pending is None else self.pending
            return self._optimizer.ask_beside(n, points, *self._lies(len(points)))

    def tell(self, points: FloatArray, *results: FloatArray) -> None:
        """Take scores, shape (m,) or (m, k), and features, shape (m, f), of points, shape (m, d)."""
        tell: Any = self._optimizer.tell
        with guarded(self._name, self._optimizer, "in tell"):
            tell(points, *results)
        if self._asynchronous:
            # Sums and numbers, so that a lie takes no longer when much was told.
            finite = [np.isfinite(one) for one in results]
            new = [np.where(good, one, 0.0).sum(axis=0) for good, one in zip(finite, results, strict=True)]
            counts = [good.sum(axis=0) for good in finite]
            before = self._sums or [[np.zeros_like(one), np.zeros_like(one)] for one in new]
            self._sums = [[a + n, b + c] for (a, b), n, c in zip(before, new, counts, strict=True)]

    def _lies(self, count: int) -> list[FloatArray]:
        """What a constant liar tells of so many points: the mean of all that was told, NaN where nothing was."""
        with np.errstate(invalid="ignore"):
            return [np.repeat((total / number)[None], count, axis=0) for total, number in self._sums]


class Proposer:
    """Chooses the scenarios that are run: those of a search, with audits among them.

    Parameters
    ----------
    search : Search
    study : Study
        Says which scenarios are audits.
    """

    def __init__(self, search: Search, study: Study) -> None:
        self._search, self._study = search, study
        self._audits = audits_of(study.space, study.meta.seed)

    def propose(self, done: int, wanted: int) -> FloatArray:
        """Choose scenarios.

        Parameters
        ----------
        done : int
            Number of those that were chosen before.
        wanted : int

        Returns
        -------
        ndarray of float64, shape (m, d)
            Snapped; m < wanted only when there are no more.
        """
        meta, space = self._study.meta, self._study.space
        audits = [meta.is_audit(done + k + 1) for k in range(wanted)]
        searched = iter(self._search.ask(wanted - sum(audits)) if not all(audits) else ())
        first, last = (count_audits(meta.audit, count) for count in (done, done + wanted))
        drawn = iter(self._audits.ask(last)[first:])
        points = []
        for audit in audits:
            point = next(drawn if audit else searched, None)
            if point is None:
                break
            points.append(point)
        return space.snap(np.array(points).reshape(-1, space.dimension))


@dataclass(frozen=True)
class Turn:
    """A round of a study, and what was known when it was proposed.

    Attributes
    ----------
    ended : tuple of Row
        Scenarios whose results had come since the round before, in the order in which they came.
    pending : tuple of Row
        Scenarios that were being run.
    proposed : tuple of Row
        Those of the round; empty of results that no round was proposed with yet.
    """

    ended: tuple[Row, ...]
    pending: tuple[Row, ...]
    proposed: tuple[Row, ...]


def turns_of(study: Study) -> Iterator[Turn]:
    """Go through the rounds of a study again.

    Parameters
    ----------
    study : Study

    Yields
    ------
    Turn
        Of each round in turn. In a study without rounds a last one has the results that no round was proposed with yet.
    """
    rows = study.rows()
    rounds = {number: tuple(members) for number, members in groupby(rows, key=lambda row: row.round)}
    if not study.meta.asynchronous:
        ended: tuple[Row, ...] = ()
        for members in rounds.values():
            yield Turn(ended, (), members)
            ended = members
        return
    by_id = {row.id: row for row in rows}
    came: dict[int, list[Row]] = {}
    for scenario, turn in study.results():
        came.setdefault(turn, []).append(by_id[scenario])
    pending: dict[int, Row] = {}
    for number in sorted({*rounds, *came}):
        known = tuple(came.get(number, ()))
        for row in known:
            del pending[row.id]
        proposed = rounds.get(number, ())
        yield Turn(known, tuple(pending.values()), proposed)
        pending |= {row.id: row for row in proposed}
