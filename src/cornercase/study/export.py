"""Studies as tables: in memory, as CSV and as Parquet."""

from __future__ import annotations

import importlib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from cornercase._common.errors import InputError
from cornercase._common.files import written_whole
from cornercase._common.texts import cell_text
from cornercase._common.typing import FloatArray
from cornercase.recordings import Recording, write_courses

if TYPE_CHECKING:
    import pandas as pd


def write_table(folder: Path, table: pd.DataFrame, parquet: bool = False) -> None:
    """Write the table of the scenarios.

    Parameters
    ----------
    folder : Path
        Gets ``scenarios.csv``; texts in it that a spreadsheet would take for formulas have an apostrophe before them.
    table : DataFrame
    parquet : bool, default False
        Write ``scenarios.parquet`` too.

    Raises
    ------
    InputError
        The folder cannot be written, or the package that writes Parquet is not installed.
    """
    if parquet:
        path = folder / "scenarios.parquet"
        try:
            importlib.import_module("pyarrow")
        except ImportError:
            raise InputError(
                f"{path}: Parquet needs pyarrow; install it with 'pip install cornercase[parquet]'."
            ) from None
        with written_whole(path) as temporary:
            table.to_parquet(temporary, engine="pyarrow", index=False)
    with written_whole(folder / "scenarios.csv") as temporary:
        _as_cells(table).to_csv(temporary, index=False, lineterminator="\n", encoding="utf-8")


def _as_cells(table: pd.DataFrame) -> pd.DataFrame:
    """Texts of a table such that no spreadsheet takes them for formulas."""
    written = table.copy()
    for name in table.columns:
        if any(isinstance(one, str) for one in table[name]):
            written[name] = table[name].map(lambda one: cell_text(one) if isinstance(one, str) else one)
    return written.set_axis([cell_text(str(name)) for name in table.columns], axis="columns")


def write_scenarios(folder: Path, scenarios: Iterable[tuple[int, Recording, Mapping[str, FloatArray]]]) -> None:
    """Write recording and courses of each scenario.

    Parameters
    ----------
    folder : Path
        Gets ``recordings/ID.csv`` and ``courses/ID.csv``.
    scenarios : iterable of (int, Recording, mapping of str to ndarray of float64, shape (T,))
        Id, recording, and courses by metric.

    Raises
    ------
    InputError
        The folder cannot be written.
    """
    for number, recording, courses in scenarios:
        recording.to_csv(folder / "recordings" / f"{number:05}.csv")
        write_courses(folder / "courses" / f"{number:05}.csv", recording.time, courses)
