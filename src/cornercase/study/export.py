"""Studies as tables: in memory, as CSV and as Parquet."""

from __future__ import annotations

import importlib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from cornercase._common.errors import InputError
from cornercase._common.files import written_whole
from cornercase._common.typing import FloatArray
from cornercase.recordings import Recording, write_courses

if TYPE_CHECKING:
    import pandas as pd


def write_table(folder: Path, table: pd.DataFrame, parquet: bool = False) -> None:
    """Write the table of the scenarios.

    Parameters
    ----------
    folder : Path
        Gets ``scenarios.csv``.
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
        table.to_csv(temporary, index=False, lineterminator="\n", encoding="utf-8")


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
