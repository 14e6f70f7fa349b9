"""Records of the scenarios of a study, and a table of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from cornercase._common.typing import FloatArray, IntArray
from cornercase.metrics._outcome import Impact
from cornercase.scenario import ParameterSpace, Value

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, eq=False)
class ScenarioRecord:
    """One concrete scenario of a study.

    Attributes
    ----------
    id, round : int
        Id of the scenario, and number of its round; both count from 1.
    point : ndarray of float64, shape (d,)
        Point in the unit cube of the parameter space.
    values : dict of str to float or str
        Parameter values.
    state : {"pending", "done", "failed"}
        The scenario has not run yet, has run, or has failed.
    error : str or None
        Why the scenario failed; None if it has not failed.

    Examples
    --------
    >>> from cornercase.study import StudyFile
    >>> with StudyFile.open("study.db") as study:  # doctest: +SKIP
    ...     first = study.rows()[0]
    >>> first.id, first.state, first.values  # doctest: +SKIP
    (1, 'done', {'ego_start': 44.6, 'pedestrian_wait': 9.72, 'p1_speed': 11.2})
    """

    id: int
    round: int
    point: FloatArray
    values: dict[str, Value]
    state: str
    error: str | None


def build_scenario_table(
    rows: Sequence[ScenarioRecord],
    space: ParameterSpace,
    scores: Mapping[str, FloatArray],
    clusters: Mapping[str, tuple[IntArray, IntArray]],
    outcomes: Mapping[int, str],
    audits: Sequence[bool] | None = None,
    notes: Mapping[int, str] | None = None,
    score_sources: Mapping[str, Mapping[int, str | None]] | None = None,
    run_counts: Mapping[int, int] | None = None,
    impacts: Mapping[int, Sequence[Impact]] | None = None,
) -> pd.DataFrame:
    """Build the table that `StudyFile.table` returns, with one row per scenario.

    `scores` maps the name of a column to one value for each scenario that ran. `clusters` maps an aspect (what
    scenarios are compared by) to scenario ids and cluster labels. `audits` is True for scenarios that were drawn at
    random to check the search. `score_sources` maps a metric to the entity that each score is measured against, by
    scenario id. The other mappings are by scenario id.
    """
    # Imported here, since opening a study does not need it.
    import pandas as pd

    ids = np.array([row.id for row in rows], dtype=np.int64)
    done = np.array([row.state == "done" for row in rows], dtype=np.bool_)
    columns: dict[str, Any] = {}
    for name, values in scores.items():
        columns[name] = np.full(len(rows), np.nan)
        columns[name][done] = values
    if run_counts is not None:
        columns["runs"] = pd.array([run_counts.get(row.id) for row in rows], dtype="Int64")
    for name, sources in (score_sources or {}).items():
        columns[f"other by {name}"] = pd.Series([sources.get(row.id) for row in rows], dtype=object)
    first_impacts = [next(iter((impacts or {}).get(row.id, ())), None) for row in rows]
    columns["collision"] = pd.Series([None if hit is None else hit.entity for hit in first_impacts], dtype=object)
    columns["impact speed"] = np.array([np.nan if hit is None else hit.speed for hit in first_impacts])
    faults = [None if hit is None else hit.fault for hit in first_impacts]
    columns["fault"] = pd.Series([None if fault is None else fault.who for fault in faults], dtype=object)
    columns["fault reason"] = pd.Series(
        [None if fault is None else "; ".join(fault.reasons) for fault in faults], dtype=object
    )
    for name, (members, labels) in clusters.items():
        column = pd.Series(pd.NA, index=ids, dtype="Int64")
        column.loc[members] = labels
        columns[f"cluster by {name}"] = column.array
    if outcomes:
        columns["outcome"] = pd.Series([outcomes.get(row.id) for row in rows], dtype=object)
    if notes:
        columns["note"] = pd.Series([notes.get(row.id) for row in rows], dtype=object)
    # As objects, so that None stays None in all versions of pandas.
    columns["error"] = pd.Series([row.error for row in rows], dtype=object)
    leading: dict[str, Any] = {"id": ids, "round": np.array([row.round for row in rows], dtype=np.int64)}
    leading["state"] = [row.state for row in rows]
    if audits is not None:
        leading["audit"] = list(audits)
    varied = {parameter.name: [parameter.extract_value(row.values) for row in rows] for parameter in space.parameters}
    # A parameter may have the same name as another column.
    varied = {
        f"parameter {name}" if name in leading or name in columns else name: values_ for name, values_ in varied.items()
    }
    return pd.DataFrame(leading | varied | columns).set_index("id")
