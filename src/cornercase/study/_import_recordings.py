"""Make studies from recordings that other programs wrote."""

from __future__ import annotations

import csv
import hashlib
import io
import math
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

from rich.console import Console
from rich.progress import track

from cornercase._common import validation
from cornercase._common.errors import InputError, SimulationError, is_machine_error, suggest_name
from cornercase._common.io.files import read_file
from cornercase._common.text.sanitize import check_comma_separated, unescape_csv_cell
from cornercase._common.unknown_names import suggest_arguments
from cornercase.metrics import Metric
from cornercase.metrics._measure import evaluate_metrics
from cornercase.metrics._other_entities import ALL_OTHERS, resolve_others
from cornercase.metrics._own_metrics import resolve_metrics
from cornercase.recordings import read_recording
from cornercase.scenario import Parameter, ParameterSpace, Value
from cornercase.study._meta import StudyMeta, metric_fields
from cornercase.study._objective import Objective
from cornercase.study._scenario_table import ScenarioRecord
from cornercase.study._stored_paths import format_stored_path
from cornercase.study._study_file import StudyFile, open_or_create_study
from cornercase.study._write_tables import FILE_COLUMN, PARAMETER_TABLE

IMPORTED_SIMULATOR: Final = "imported"
"""Name that stands for the simulator in a study of imported recordings."""

_MAX_CHOICES: Final = 50
# First columns of the table that `export` writes.
_EXPORT_COLUMNS: Final = ["id", "round", "state"]


@dataclass(frozen=True)
class ImportResult:
    """Result of an import.

    Attributes
    ----------
    study : Path
        Path of the study.
    done : int
        Number of recordings that could be read and measured.
    failed : int
        Number of recordings that could not be read or measured.
    reason : str
        Why the first of the failed recordings could not be used, in a sentence; empty if none failed. The study stores
        the reason for each failed recording.

    Examples
    --------
    >>> import cornercase as cc
    >>> entities = {"ego": "Ego", "other": "C"}
    >>> result = cc.import_recordings("recordings", "imported.db", **entities, metrics=["ttc"])  # doctest: +SKIP
    >>> result.done, result.failed, result.reason  # doctest: +SKIP
    (100, 0, '')
    """

    study: Path
    done: int
    failed: int
    reason: str = ""

    def __repr__(self) -> str:
        failures = f"; {self.failed} could not be read or measured, the first: {self.reason}" if self.failed else ""
        return f"<ImportResult: {self.done} recordings measured, in {str(self.study)!r}{failures}>"


@suggest_arguments
def import_recordings(
    folder: Path | str,
    study: Path | str,
    *,
    ego: str,
    other: str | Sequence[str],
    metrics: Metric | str | Sequence[Metric | str],
    table: Path | str | None = None,
    critical: float | None = None,
    progress: bool = False,
) -> ImportResult:
    """Make a study from recordings in files, or continue an earlier import.

    Parameters
    ----------
    folder : path
        Folder with the recordings, in any format that `cornercase.recordings.read_recording` reads. It may be a folder
        that `Study.export` wrote.
    study : path
        Study to write.
    ego : str
        Name of the entity under test.
    other : str or sequence of str
        Entity that the ego is measured against; ``"*"`` stands for all other entities. If there are several, the most
        critical score counts, and entities that a recording lacks are ignored in that recording. A recording that has
        none of the entities cannot be measured.
    metrics : Metric or str, or sequence of these
        The first one defines criticality.
    table : path, optional
        CSV table of the recordings; by default ``parameters.csv`` in the folder. The column ``file`` has the path of
        each recording, relative to the folder; each other column is a parameter. A column of numbers becomes a range
        from its minimum to its maximum, any other column a set of choices.
    critical : float, optional
        Threshold of the first metric; by default the default threshold of this metric.
    progress : bool, default False
        Show a progress bar.

    Returns
    -------
    ImportResult

    Raises
    ------
    InputError
        The table cannot be used, no recording can be read and measured, or the study exists and has other content.

    Examples
    --------
    >>> import cornercase as cc
    >>> folder = "examples/x_intersection/x_intersection"
    >>> scenario = cc.LogicalScenario.read(f"{folder}.xosc", f"{folder}.space.xosc")
    >>> problem = cc.Problem(scenario, ego="Ego", other="Pedestrian", metrics=["wttc"])
    >>> study = cc.Study.create("explored.db", problem)
    >>> _ = study.explore("sobol", budget=4)
    >>> study.export("exported")
    >>> cc.import_recordings("exported", "imported.db", ego="Ego", other="Pedestrian", metrics=["ttc"])
    <ImportResult: 4 recordings measured, in 'imported.db'>
    """
    folder, path = validation.check_path("folder", folder), validation.check_path("study", study)
    if not folder.is_dir():
        problem = "is a file" if folder.exists() else "there is no such folder"
        raise InputError(f"{folder}: {problem}; name the folder that holds the recordings.")
    if table is None and not (folder / PARAMETER_TABLE).exists():
        above = folder.resolve().parent
        hint = f"name the folder above, {above}, which has one" if (above / PARAMETER_TABLE).exists() else "write one"
        raise InputError(
            f"{folder}: has no {PARAMETER_TABLE} with the parameter values of each recording; {hint}, or name"
            " another table with `table`."
        )
    table = folder / PARAMETER_TABLE if table is None else validation.check_path("table", table)
    files, values = _read_parameter_table(folder, table)
    others = _resolve_others(other, ego, [folder / file for file in files])
    instances = resolve_metrics(metrics)
    if not instances:
        raise InputError("`metrics`: name at least one.")
    meta = StudyMeta(
        scenario=format_stored_path(folder, path),
        fingerprint=_hash_inputs(table, folder, files),
        space=_infer_space(values),
        ego=ego,
        other=others[0] if len(others) == 1 else others,
        **metric_fields(instances),
        optimizer="none",
        simulator=IMPORTED_SIMULATOR,
        settings={"table": format_stored_path(table, path)},
        critical=Objective(instances).with_threshold(critical, is_required=False).threshold,
        budget=len(files),
        batch=len(files),
        files=tuple(files),
    )
    if not path.exists():
        # Check first, since a study with a misspelt name would have to be removed.
        _require_measurable([folder / file for file in files], instances, ego, others)
    with open_or_create_study(path, meta) as opened:
        # The table may have moved; the fingerprint identifies it.
        opened.writer.check_and_update_meta(replace(meta, settings=opened.meta.settings))
        rows = opened.rows() or opened.writer.add_pending(1, meta.space.points(values), values)
        pending = [row for row in rows if row.state == "pending"]
        bar = track(pending, "Recordings", console=Console(stderr=True), disable=not progress)
        start = time.monotonic()
        for row in bar:
            _measure_recording(opened, row, folder / files[row.id - 1], instances)
        opened.writer.add_elapsed_time("measure", time.monotonic() - start)
        failed = opened.failed_rows()
        return ImportResult(path, len(opened.finished_rows()), len(failed), failed[0].error or "" if failed else "")


def _resolve_others(other: object, ego: str, files: Sequence[Path]) -> tuple[str, ...]:
    """Return the names of the entities that the ego is measured against; "*" means all entities in the recordings."""
    names = resolve_others(other, ego, (ALL_OTHERS,))
    if len(names) == 1 and ALL_OTHERS not in names:
        return names
    found_names: dict[str, None] = {}
    for file in files:
        # An unreadable recording is reported later as a failed scenario.
        with suppress(InputError):
            found_names |= dict.fromkeys(read_recording(file).names)
        if set(names) <= set(found_names):
            break
    # A name that no recording has is misspelt; others may lack it.
    for name in names:
        if name != ALL_OTHERS and name not in found_names:
            raise InputError(
                f"`other` {name}: none of the recordings has an entity of this name;"
                f" {suggest_name(name, list(found_names))}"
            )
    return resolve_others(other, ego, list(found_names))


def _require_measurable(files: Sequence[Path], metrics: Sequence[Metric], ego: str, others: Sequence[str]) -> None:
    """Raise `InputError` unless at least one recording can be read and measured."""
    reasons = []
    for file in files:
        try:
            evaluate_metrics(metrics, read_recording(file), ego, others)
        except (InputError, SimulationError) as error:
            reasons.append(_describe_failure(file, error))
        else:
            return
    raise InputError(
        f"None of the {len(files)} recordings can be read and measured; the error of the first: {reasons[0]}"
    )


def _describe_failure(file: Path, error: InputError | SimulationError) -> str:
    """Return an error message that begins with the name of the file."""
    return str(error) if str(file) in str(error) else f"{file}: {error}"


def _measure_recording(study: StudyFile, row: ScenarioRecord, file: Path, metrics: Sequence[Metric]) -> None:
    try:
        recording = read_recording(file)
        courses = evaluate_metrics(metrics, recording, study.meta.ego, study.meta.others)
    except (InputError, SimulationError) as error:
        # A disk error is not the recording's fault; the same command can be run again.
        if is_machine_error(error):
            raise
        study.writer.record_failure(row.id, SimulationError(_describe_failure(file, error)))
        return
    study.writer.record_result(row.id, recording, courses)


def _read_parameter_table(folder: Path, table: Path) -> tuple[list[str], list[dict[str, Value]]]:
    """Read the CSV table of recordings, and return the file names and the parameter values for each file."""
    try:
        reader = csv.DictReader(io.StringIO(read_file(table).decode("utf-8-sig"), newline=""))
        names = list(reader.fieldnames or ())
        rows = [(reader.line_num, row) for row in reader]
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{table}: is not a CSV table ({error}).") from error
    check_comma_separated(table, names)
    if FILE_COLUMN not in names or len(names) < 2 or len(set(names)) < len(names):
        if names[: len(_EXPORT_COLUMNS)] == _EXPORT_COLUMNS and (table.parent / PARAMETER_TABLE).exists():
            raise InputError(
                f"{table}: is the table of an export, with scores beside parameters; leave `table` out, and name the"
                f" folder {table.parent}, which has a table of the parameters alone ({PARAMETER_TABLE})."
            )
        raise InputError(
            f"{table}: needs a header with '{FILE_COLUMN}' and at least one parameter, each once, but the header is"
            f" {', '.join(names)}."
        )
    if len(rows) < 2:
        raise InputError(f"{table}: names {len(rows)} recordings; at least 2 are needed.")
    files: list[str] = []
    values: list[dict[str, Value]] = []
    for line, row in rows:
        if None in row or None in row.values() or "" in row.values():
            raise InputError(f"{table}, line {line}: has an extra or an empty field.")
        if "\0" in row[FILE_COLUMN] or not (folder / row[FILE_COLUMN]).is_file():
            raise InputError(f"{table}, line {line}: there is no file {folder / row[FILE_COLUMN]}.")
        if row[FILE_COLUMN] in files:
            raise InputError(f"{table}, line {line}: names {row[FILE_COLUMN]} a second time.")
        files.append(row[FILE_COLUMN])
        values.append({unescape_csv_cell(name): unescape_csv_cell(row[name]) for name in names if name != FILE_COLUMN})
    for name in map(unescape_csv_cell, names):
        numbers = (
            [_parse_finite_number(str(row_values[name])) for row_values in values] if name != FILE_COLUMN else [None]
        )
        if all(number is not None for number in numbers):
            for row_values, number in zip(values, numbers, strict=True):
                row_values[name] = float(number or 0.0)
    return files, values


def _parse_finite_number(text: str) -> float | None:
    try:
        number = float(text)
    except ValueError:
        return None
    return number if math.isfinite(number) else None


def _infer_space(values: Sequence[dict[str, Value]]) -> ParameterSpace:
    parameters = []
    for name in values[0]:
        column = [text[name] for text in values]
        if isinstance(column[0], float):
            low, high = min(map(float, column)), max(map(float, column))
            # A constant becomes a range of one value.
            parameters.append(Parameter(name, low, high, None if low < high else 1.0))
            continue
        choices = tuple(sorted({str(text) for text in column}))
        if len(choices) > _MAX_CHOICES:
            raise InputError(
                f"The parameter '{name}' has {len(choices)} different texts, more than {_MAX_CHOICES}; leave its"
                " column out of the table."
            )
        parameters.append(Parameter(name, 0.0, float(len(choices) - 1), None, choices))
    return ParameterSpace(parameters).require_parameters()


def _hash_inputs(table: Path, folder: Path, files: Sequence[str]) -> str:
    """Return the SHA-256 of the table and all recordings."""
    digest = hashlib.sha256(read_file(table))
    for file in files:
        # Large files are hashed without loading them.
        try:
            with open(folder / file, "rb") as opened:
                digest.update(hashlib.file_digest(opened, "sha256").digest())
        except OSError as error:
            raise InputError(f"{folder / file}: cannot be read ({error.strerror}).") from error
    return digest.hexdigest()
