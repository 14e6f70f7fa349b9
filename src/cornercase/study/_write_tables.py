"""Write studies as tables: CSV and Parquet."""

from __future__ import annotations

import csv
import importlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from cornercase._common.errors import InputError
from cornercase._common.io.files import atomic_write
from cornercase._common.optional_packages import describe_install
from cornercase._common.text.sanitize import escape_csv_cell
from cornercase._common.typing import FloatArray
from cornercase.recordings import Recording
from cornercase.recordings._csv import write_courses
from cornercase.scenario import Value

if TYPE_CHECKING:
    import pandas as pd

PARAMETER_TABLE: Final = "parameters.csv"
"""File name of the table of recordings and their parameters."""

FILE_COLUMN: Final = "file"
"""Column of the table of recordings: path of each recording, relative to the folder of the table."""


def write_table(folder: Path, table: pd.DataFrame, parquet: bool = False) -> None:
    """Write `scenarios.csv`, and with `parquet` also `scenarios.parquet`; column names have underscores for spaces.

    In the CSV, texts that a spreadsheet would take for formulas begin with an apostrophe.
    """
    columns = table.reset_index()
    renamed = columns.set_axis(replace_spaces_in_names(map(str, columns.columns)), axis="columns")
    if parquet:
        path = folder / "scenarios.parquet"
        _require_pyarrow(path)
        with atomic_write(path) as temporary:
            renamed.to_parquet(temporary, engine="pyarrow", index=False)
    with atomic_write(folder / "scenarios.csv") as temporary:
        _escape_formulas(renamed).to_csv(temporary, index=False, lineterminator="\n", encoding="utf-8")


def write_parameters(folder: Path, values: Mapping[int, Mapping[str, Value]], names: Sequence[str]) -> None:
    """Write `parameters.csv` for `import_recordings`: the recording file and the parameters of each scenario."""
    with atomic_write(folder / PARAMETER_TABLE) as temporary, temporary.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow([FILE_COLUMN, *map(escape_csv_cell, names)])
        for scenario, own in values.items():
            cells = [escape_csv_cell(value) if isinstance(value, str) else value for value in map(own.get, names)]
            writer.writerow([_recording_file(scenario), *cells])


def _recording_file(scenario: int) -> str:
    return f"recordings/{scenario:05}.csv"


def replace_spaces_in_names(names: Iterable[str]) -> list[str]:
    """Replace spaces in column names by underscores, keeping the names distinct."""
    unique: list[str] = []
    for name in names:
        column = "_".join(name.split()) or "_"
        while column in unique:
            column += "_"
        unique.append(column)
    return unique


def _require_pyarrow(path: Path) -> None:
    try:
        importlib.import_module("pyarrow")
    except ImportError as error:
        # An installed version may be incompatible with NumPy.
        reason = "" if isinstance(error, ModuleNotFoundError) else f" ({error})"
        raise InputError(f"{path}: Parquet needs pyarrow{reason}; {describe_install('parquet')}.") from None


def _escape_formulas(table: pd.DataFrame) -> pd.DataFrame:
    """Put an apostrophe before texts that a spreadsheet would take for formulas."""
    cells = table.copy()
    for name in table.columns:
        if any(isinstance(value, str) for value in table[name]):
            cells[name] = table[name].map(lambda value: escape_csv_cell(value) if isinstance(value, str) else value)
    return cells.set_axis([escape_csv_cell(str(name)) for name in table.columns], axis="columns")


def write_scenarios(
    folder: Path, scenarios: Iterable[tuple[int, Recording, Mapping[str, FloatArray]]], parquet: bool = False
) -> None:
    """Write `recordings/ID.csv` and `courses/ID.csv` for each scenario, given as id, recording, and courses by metric.

    With `parquet`, also write `recordings.parquet` and `courses.parquet` of all scenarios. These have a column
    `scenario`, and one row group per scenario.
    """
    if not parquet:
        for number, recording, courses in scenarios:
            _write_scenario_csv(folder, number, recording, courses)
        return
    with (
        _open_parquet_writer(folder / "recordings.parquet") as add_recording,
        _open_parquet_writer(folder / "courses.parquet") as add_courses,
    ):
        for number, recording, courses in scenarios:
            _write_scenario_csv(folder, number, recording, courses)
            table = recording.to_dataframe()
            add_recording(
                {"scenario": np.full(len(table), number)} | {name: table[name].to_numpy() for name in table.columns}
            )
            names = replace_spaces_in_names(["scenario", "time", *courses])
            columns = [np.full(len(recording.time), number), recording.time, *courses.values()]
            add_courses(dict(zip(names, columns, strict=True)))


def _write_scenario_csv(
    folder: Path, scenario_id: int, recording: Recording, courses: Mapping[str, FloatArray]
) -> None:
    recording.to_csv(folder / _recording_file(scenario_id))
    write_courses(folder / "courses" / f"{scenario_id:05}.csv", recording.time, courses)


@contextmanager
def _open_parquet_writer(path: Path) -> Iterator[Callable[[Mapping[str, Any]], None]]:
    """Open a Parquet file, and yield a function that appends a table; only one table at a time is in memory."""
    _require_pyarrow(path)
    import pyarrow
    from pyarrow import parquet

    writer: Any = None
    with atomic_write(path) as temporary:

        def append(columns: Mapping[str, Any]) -> None:
            nonlocal writer
            table = pyarrow.table(dict(columns))
            if writer is None:
                writer = parquet.ParquetWriter(temporary, table.schema)
            writer.write_table(table)

        try:
            yield append
        finally:
            if writer is not None:
                writer.close()
        if writer is None:
            parquet.write_table(pyarrow.table({}), temporary)
