"""The table of a study's scenarios."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from cornercase._common.typing import FloatArray, IntArray
from cornercase.scenario import ParameterSpace, Value

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, eq=False)
class Row:
    """One concrete scenario of a study.

    Attributes
    ----------
    id, round : int
        Both from 1 on.
    point : ndarray of float64, shape (d,)
        In the unit cube.
    values : dict of str to float or str
        Values of the scenario's parameters.
    state : {"pending", "done", "failed"}
        Whether it was run.
    error : str or None
        Why it could not be run.
    """

    id: int
    round: int
    point: FloatArray
    values: dict[str, Value]
    state: str
    error: str | None


def scenario_table(
    rows: Sequence[Row],
    space: ParameterSpace,
    scores: Mapping[str, FloatArray],
    clusters: Mapping[str, tuple[IntArray, IntArray]],
    outcomes: Mapping[int, str],
    audits: Sequence[bool] | None = None,
    notes: Mapping[int, str] | None = None,
    against: Mapping[str, Mapping[int, str | None]] | None = None,
    runs: Mapping[int, int] | None = None,
) -> pd.DataFrame:
    """Put together what is known of each scenario, a row for each.

    Parameters
    ----------
    rows : sequence of Row, length n
    space : ParameterSpace
    scores : mapping of str to ndarray of float64, shape (m,)
        By column; of the m scenarios that were run.
    clusters : mapping of str to (ndarray of int64, ndarray of int64), shapes (k,)
        By aspect, ids of scenarios and their clusters.
    outcomes : mapping of int to str
        By id.
    audits : sequence of bool, length n, optional
        Which scenarios are audits, where there are any.
    notes : mapping of int to str, optional
        By id.
    against : mapping of str to mapping of int to (str or None), optional
        By metric and id, whom of several others a score is against.
    runs : mapping of int to int, optional
        By id, how many runs of each scenario did not fail, where that is not the same of all.

    Returns
    -------
    DataFrame
        As `cornercase.study.Study.table`.
    """
    # Loaded here, since opening a study does not need it.
    import pandas as pd

    ids = np.array([row.id for row in rows], dtype=np.int64)
    done = np.array([row.state == "done" for row in rows], dtype=np.bool_)
    found: dict[str, Any] = {}
    for name, values in scores.items():
        found[name] = np.full(len(rows), np.nan)
        found[name][done] = values
    if runs is not None:
        found["runs"] = pd.array([runs.get(row.id) for row in rows], dtype="Int64")
    for name, whom in (against or {}).items():
        found[f"other by {name}"] = pd.Series([whom.get(row.id) for row in rows], dtype=object)
    for name, (members, labels) in clusters.items():
        column = pd.Series(pd.NA, index=ids, dtype="Int64")
        column.loc[members] = labels
        found[f"cluster by {name}"] = column.array
    if outcomes:
        found["outcome"] = pd.Series([outcomes.get(row.id) for row in rows], dtype=object)
    if notes:
        found["note"] = pd.Series([notes.get(row.id) for row in rows], dtype=object)
    # As objects, so that None stays None, whatever the version of pandas makes of texts.
    found["error"] = pd.Series([row.error for row in rows], dtype=object)
    first: dict[str, Any] = {"id": ids, "round": np.array([row.round for row in rows], dtype=np.int64)}
    first["state"] = [row.state for row in rows]
    if audits is not None:
        first["audit"] = list(audits)
    varied = {parameter.name: [parameter.read(row.values) for row in rows] for parameter in space.parameters}
    # A parameter may have the name of another column.
    varied = {f"parameter {name}" if name in first or name in found else name: each for name, each in varied.items()}
    return pd.DataFrame(first | varied | found)
