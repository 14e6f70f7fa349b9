"""Read the parameter values of many concrete scenarios from a CSV table."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from cornercase._common.errors import InputError, suggest_name
from cornercase._common.io.files import read_file
from cornercase._common.text.sanitize import check_comma_separated, unescape_csv_cell
from cornercase.scenario._constraints import read_declarations
from cornercase.scenario._file import ScenarioFile
from cornercase.scenario._parameter import Value
from cornercase.scenario._types import find_type_errors

FILE_COLUMN: Final = "file"
"""Column that names the recording of each scenario."""


@dataclass(frozen=True)
class ValueRow:
    """A row of a table: line number in the file, name of the recording (empty if not given), and parameter values."""

    line: int
    recording_name: str
    values: Mapping[str, Value]


def read_value_table(path: Path, scenario: ScenarioFile) -> tuple[ValueRow, ...]:
    """Read a CSV table with one scenario per line and one column per varied parameter.

    An optional column ``file`` names the recording of each scenario.
    """
    try:
        reader = csv.DictReader(io.StringIO(read_file(path).decode("utf-8-sig"), newline=""))
        names = list(reader.fieldnames or ())
        lines = [(reader.line_num, row) for row in reader]
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{path}: is not a CSV table in UTF-8 ({error}).") from error
    check_comma_separated(path, names)
    parameters = {name: unescape_csv_cell(name) for name in names if name != FILE_COLUMN}
    if not parameters or len({*parameters.values()}) + (FILE_COLUMN in names) < len(names):
        raise InputError(f"{path}: needs a header with each parameter once, not {', '.join(names) or 'an empty one'}.")
    declared, of_drivers = scenario.parameters, scenario.parse_driver_option_names(parameters.values())
    for name in parameters.values():
        if name not in declared and name not in of_drivers:
            raise InputError(
                f"{path}: has a column '{name}', but {scenario.path} declares no such parameter;"
                f" {suggest_name(name, declared)}"
            )
    if not lines:
        raise InputError(f"{path}: has a header but no rows.")
    rows = []
    for line, cells in lines:
        if None in cells or None in cells.values() or "" in cells.values():
            raise InputError(f"{path}, line {line}: has an empty field, or too many fields.")
        values = {parameter: unescape_csv_cell(cells[name]).strip() for name, parameter in parameters.items()}
        rows.append(ValueRow(line, unescape_csv_cell(cells.get(FILE_COLUMN, "")), values))
    declarations = read_declarations(scenario.root, str(scenario.path))
    for index, problem in find_type_errors(declarations, [row.values for row in rows]).items():
        raise InputError(f"{path}, line {rows[index].line}: {problem}.")
    return tuple(rows)
