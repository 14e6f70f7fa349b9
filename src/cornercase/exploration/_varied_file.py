"""The scenario file to explore, with new parameters if numbers in the file are varied (option `vary`)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path

from cornercase._common.errors import InputError
from cornercase._common.io.files import check_output_differs_from_source, read_file, write_files
from cornercase._common.validation import check_str_sequence
from cornercase.scenario import LogicalScenario, Parameter, ParameterSpace
from cornercase.scenario._range_syntax import format_ranges
from cornercase.scenario._types import format_value
from cornercase.scenario._vary import VariedScenario


@contextmanager
def open_logical_scenario(
    scenario: LogicalScenario | Path | str | None,
    study: Path,
    space: Path | str | None = None,
    ranges: Sequence[str] = (),
    vary: Sequence[str] = (),
    continuous: bool = False,
) -> Iterator[LogicalScenario]:
    """Read the logical scenario of `explore`.

    With `vary`, a copy of the file with the new parameters is written next to the study and read. The copy is removed
    if no study is created. Raises `InputError` if an argument cannot be used, or the study belongs to another scenario.
    """
    if isinstance(scenario, LogicalScenario):
        if space is not None or ranges or vary or continuous:
            raise InputError(
                "`space`, `ranges`, `vary` and `continuous` apply to scenario files only; this scenario has a space"
                " already."
            )
        yield scenario
        return
    variables = check_str_sequence("vary", vary)
    if not variables:
        yield LogicalScenario.read(scenario, space, ranges, continuous)
        return
    if scenario is None:
        if space is None:
            raise InputError("`vary`: no scenario given; name an OpenSCENARIO file.")
        scenario = ParameterSpace.read_scenario_path(space)
    varied = VariedScenario.select(scenario, variables)
    file = study.with_name(f"{study.stem}.varied.xosc")
    created = [target for target in (file, *file.parents) if not target.exists()]
    extra_files = varied.companion_files(file.parent)
    _write_varied_scenario(varied, extra_files, file, study)
    try:
        all_ranges = [*format_ranges(ranges), *map(_format_range, varied.parameters)]
        logical = LogicalScenario.read(file, space, all_ranges, continuous)
        _require_same_folder_for_roads(logical, varied, file)
        yield replace(logical, space=varied.add_units(logical.space))
    except BaseException as error:
        if file not in created or study.exists():
            raise
        for target in (file, *extra_files):
            target.unlink(missing_ok=True)
        with suppress(OSError):
            for folder in created[1:]:
                folder.rmdir()
        if type(error) is InputError:
            # Name the user's file: the copy has been removed.
            raise InputError(str(error).replace(str(file), str(varied.file.path))) from error
        raise


def _write_varied_scenario(varied: VariedScenario, extra_files: Mapping[Path, bytes], file: Path, study: Path) -> None:
    """Write the copy of the scenario; if the study exists, the existing copy has to be identical."""
    for source_file in varied.file.all_paths():
        check_output_differs_from_source(file, source_file, "study")
    content = varied.scenario_content(file.parent)
    previous = read_file(file) if file.exists() else None
    if previous == content:
        return
    if previous is not None and study.exists():
        raise InputError(
            f"{study}: was created with another scenario file or other names for `vary` ({file.name} differs); give the"
            " same file and names, or name another study."
        )
    write_files({**extra_files, file: content})


def _format_range(parameter: Parameter) -> str:
    step = "" if parameter.step is None else f":{format_value(parameter.step)}"
    return f"{parameter.name}={format_value(parameter.low)}:{format_value(parameter.high)}{step}"


def _require_same_folder_for_roads(logical: LogicalScenario, varied: VariedScenario, file: Path) -> None:
    """Raise `InputError` if a parameter names road files, and the study is not in the folder of the scenario file."""
    roads = set(logical.space.assigned_names) & varied.file.path_parameters
    if roads and file.parent.resolve() != varied.file.path.parent.resolve():
        raise InputError(
            f"{varied.file.path}: the parameter {min(roads)} names road files relative to the scenario's folder; with"
            f" `vary`, write the study into the scenario's folder, not into {file.parent}."
        )
