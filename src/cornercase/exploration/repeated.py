"""Scenarios that are run several times, and more often where it is open whether they are critical."""

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
    """A scenario, and what came of its runs so far.

    Attributes
    ----------
    row : Row
    wanted : int
        Number of runs that it needs next; 0 if it needs none.
    ran : int
        Number of runs so far, including those that failed.
    runs : list of (Recording, dict of str to Measured)
        The recording of each run that did not fail, and its course and score by metric.
    error : SimulationError or None
        Why the first of the failed runs failed.
    """

    row: Row
    wanted: int
    ran: int = 0
    runs: list[tuple[Recording, dict[str, Measured]]] = field(default_factory=list)
    error: SimulationError | None = None


class Repetition:
    """Says how often scenarios are run.

    Each is run `repeats` times. A scenario is open while its runs do not tell on which side of the threshold it is
    (`are_open`). With `most_repeats`, an open scenario is run `repeats` times more, again and again, until it is no
    longer open or has had `most_repeats` runs. A scenario whose runs all failed is not run again.

    Parameters
    ----------
    configuration : Configuration
    objective : Objective
        Its metrics are measured.

    Raises
    ------
    InputError
        Nothing says what is critical, but `most_repeats` needs it.
    """

    def __init__(self, configuration: Configuration, objective: Objective) -> None:
        self._about, self._objective = configuration, objective
        self._threshold = configuration.threshold(objective)

    def begin(self, row: Row) -> RepeatedScenario:
        """Begin with a scenario that was not run yet.

        Parameters
        ----------
        row : Row

        Returns
        -------
        RepeatedScenario
        """
        return RepeatedScenario(row, self._about.repeats)

    def take(self, one: RepeatedScenario, outcomes: Sequence[Recording | SimulationError]) -> None:
        """Measure runs of a scenario, and say whether it needs more.

        Parameters
        ----------
        one : RepeatedScenario
        outcomes : sequence of Recording or SimulationError
            Of the runs that were wanted.
        """
        about = self._about
        for outcome in outcomes:
            try:
                if isinstance(outcome, SimulationError):
                    raise outcome
                one.runs.append((outcome, measured(self._objective.metrics, outcome, about.ego, about.others)))
            except SimulationError as error:
                one.error = one.error or error
        one.ran += len(outcomes)
        one.wanted = self._more(one)

    def scores(self, one: RepeatedScenario) -> FloatArray:
        """Oriented scores of the runs of a scenario.

        Parameters
        ----------
        one : RepeatedScenario
            One of its runs at least did not fail.

        Returns
        -------
        ndarray of float64, shape (n,), or (n, metrics) for a Pareto front
        """
        return self._objective.oriented(np.array([[each.score for each in run.values()] for _, run in one.runs]))

    def _more(self, one: RepeatedScenario) -> int:
        most = self._about.most_repeats
        if most is None or self._threshold is None or not one.runs:
            return 0
        more = min(self._about.repeats, most - one.ran)
        return more if more and are_open(self.scores(one).tolist(), self._threshold) else 0
