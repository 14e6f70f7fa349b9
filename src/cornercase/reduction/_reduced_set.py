"""Reduced set: the few selected scenarios that represent all scenarios of a study, and an evaluation of them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from cornercase._common.text.notebook_html import render_html_table
from cornercase.reduction._cluster_shapes import ClusterShape
from cornercase.reduction._coverage import Coverage
from cornercase.reduction._critical_coverage import CriticalCoverage
from cornercase.reduction._kill_matrix import MutantSelection
from cornercase.reduction._selection_state import Role
from cornercase.scenario import Value

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True)
class SelectedScenario:
    """A scenario of the reduced set.

    Attributes
    ----------
    id : int
        Id of the scenario in the study.
    file : str
        OpenSCENARIO file in the folder of the reduced set; for imported recordings, the file of the recording.
    cluster : int
        Cluster that the scenario represents; -1 for noise.
    role : {"archetype", "prototype", "critical prototype", "gap", "exposing", "chosen"}
        ``"archetype"``: an extreme scenario of a cluster. ``"prototype"``: the scenario most like all others of a
        cluster. ``"critical prototype"``: the scenario most like the critical scenarios of a cluster whose prototype is
        not critical. ``"gap"``: a scenario far from all scenarios selected before. ``"exposing"``: a scenario that
        kills mutants of the driver. ``"chosen"``: a scenario that a user chose by its id.
    why : str
        Reason for the selection of the scenario, in words.
    values : mapping of str to float or str
        Values of the scenario's parameters, by parameter name.
    scores : mapping of str to float
        Scores by metric, in the metric's unit.

    Examples
    --------
    >>> import cornercase as cc
    >>> first = cc.reduce("study.db", "reduced", size=10).scenarios[0]  # doctest: +SKIP
    >>> first.file, first.role  # doctest: +SKIP
    ('x_intersection-00017.xosc', 'critical prototype')
    >>> first.values  # doctest: +SKIP
    {'ego_start': 50.0, 'pedestrian_wait': 7.48, 'p1_speed': 9.5}
    """

    id: int
    file: str
    cluster: int
    role: Role
    why: str
    values: Mapping[str, Value]
    scores: Mapping[str, float]


@dataclass(frozen=True, repr=False)
class ReducedSet:
    """A reduced set: the selected concrete scenarios, and how well they represent all scenarios.

    Attributes
    ----------
    by : str
        Aspect (what scenarios are compared by) whose clusters are represented, or ``bands:METRIC`` if the scenarios
        represent bands of criticality by a metric.
    n_run : int
        Number of scenarios of the study that had been run when the set was selected.
    scenarios : tuple of SelectedScenario
        Selected scenarios, in the order of selection.
    shapes : tuple of ClusterShape
        Shapes of the clusters; empty if an early version of cornercase made the study.
    coverage : mapping of str to Coverage
        Coverage of all scenarios, by aspect. An aspect is missing if no selected scenario was analysed by it.
    critical : mapping of str to CriticalCoverage
        Coverage of the critical scenarios, by aspect; empty without a threshold.
    hulls : mapping of int to tuple of tuple of int
        Facets of the convex hull of each cluster in the parameter space, by cluster. If a cluster consists of
        near-convex parts, the facets of the hulls of all parts. Each facet is given by the ids of the scenarios at its
        corners.
    exposing : MutantSelection or None
        Result of the selection by mutants of a driver; None if there was no selection by mutants.
    threshold : float or None
        Score from which a scenario was critical when the set was selected; None without a threshold.

    Examples
    --------
    >>> import cornercase as cc
    >>> reduced = cc.reduce("study.db", "reduced", size=10)  # doctest: +SKIP
    >>> len(reduced), reduced.ids[:3], reduced.table().loc[17, "role"]  # doctest: +SKIP
    (10, [17, 3, 181], 'critical prototype')
    """

    by: str
    n_run: int
    scenarios: tuple[SelectedScenario, ...]
    shapes: tuple[ClusterShape, ...]
    coverage: Mapping[str, Coverage]
    critical: Mapping[str, CriticalCoverage]
    hulls: Mapping[int, tuple[tuple[int, ...], ...]]
    exposing: MutantSelection | None = None
    threshold: float | None = None

    def __len__(self) -> int:
        return len(self.scenarios)

    @property
    def ids(self) -> list[int]:
        """Ids of the selected scenarios, in the order of selection."""
        return [scenario.id for scenario in self.scenarios]

    def __repr__(self) -> str:
        roles = Counter(scenario.role for scenario in self.scenarios)
        words = {"gap": "to fill gaps between these", "exposing": "that expose mutants"}
        counts = ", ".join(
            f"{count} {words.get(role) or role + ('' if count == 1 else 's')}" for role, count in roles.items()
        )
        return f"<ReducedSet: {len(self.scenarios)} of {self.n_run} scenarios kept by {self.by}: {counts or 'none'}>"

    def table(self) -> pd.DataFrame:
        """Make a table of the selected scenarios.

        Returns
        -------
        DataFrame
            One row per scenario, indexed by its id in the study, in the order of selection: ``cluster``, ``role``, the
            parameters, the score by each metric, ``why`` and ``file``.
        """
        import pandas as pd

        rows = [
            {"id": scenario.id, "cluster": scenario.cluster, "role": scenario.role}
            | dict(scenario.values)
            | dict(scenario.scores)
            | {"why": scenario.why, "file": scenario.file}
            for scenario in self.scenarios
        ]
        return pd.DataFrame(rows).set_index("id") if rows else pd.DataFrame()

    def _repr_html_(self) -> str:
        """HTML table of the selected scenarios, for notebooks."""
        return render_html_table(repr(self), self.table(), n_rows=len(self))
