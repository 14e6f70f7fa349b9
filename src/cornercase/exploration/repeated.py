"""Repeated runs of a scenario, and extra runs while it is undecided whether it is critical."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from cornercase._common.errors import SimulationError
from cornercase._common.typing import FloatArray
from cornercase.exploration.configuration import Configuration
from cornercase.exploration.objective import Objective
from cornercase.metrics import Measured, measured
from cornercase.recordings import Recording
from cornercase.study import Row, are_open


@dataclass(eq=False)
class RepeatedScenario:
    """A scenario and its runs so far.

    `wanted`: runs to do next, 0 for none; `ran`: runs done, including failed ones; `runs`: recording and results by
    metric of each successful run; `error`: error of the first failed run.
    """

    row: Row
    wanted: int
    ran: int = 0
    runs: list[tuple[Recording, dict[str, Measured]]] = field(default_factory=list)
    error: SimulationError | None = None


class Repetition:
    """Decides how often scenarios are run.

    Each is run `repeats` times. With `most_repeats`, a scenario gets `repeats` further runs, up to `most_repeats`,
    while its runs do not tell on which side of the threshold it is (`are_open`). If all runs failed, there are no more.
    Raises `InputError` if `most_repeats` needs a threshold and there is none.
    """

    def __init__(self, configuration: Configuration, objective: Objective) -> None:
        self._about, self._objective = configuration, objective
        self._threshold = configuration.threshold(objective)

    def begin(self, row: Row) -> RepeatedScenario:
        """Create the state of a scenario without runs."""
        return RepeatedScenario(row, self._about.repeats)

    def take(self, one: RepeatedScenario, outcomes: Sequence[Recording | SimulationError]) -> None:
        """Measure finished runs, and set how many more are needed."""
        config = self._about
        for outcome in outcomes:
            try:
                if isinstance(outcome, SimulationError):
                    raise outcome
                one.runs.append((outcome, measured(self._objective.metrics, outcome, config.ego, config.others)))
            except SimulationError as error:
                one.error = one.error or error
        one.ran += len(outcomes)
        one.wanted = self._more(one)

    def scores(self, one: RepeatedScenario) -> FloatArray:
        """Minimized scores of the successful runs, shape (n,) or (n, metrics) for a front."""
        return self._objective.oriented(np.array([[result.score for result in run.values()] for _, run in one.runs]))

    def _more(self, one: RepeatedScenario) -> int:
        limit = self._about.most_repeats
        if limit is None or self._threshold is None or not one.runs:
            return 0
        n_more = min(self._about.repeats, limit - one.ran)
        return n_more if n_more and are_open(self.scores(one).tolist(), self._threshold) else 0
