"""The scenario file to explore, also if numbers in it that are no parameters are varied."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path

from cornercase._common.arguments import texts
from cornercase._common.errors import InputError
from cornercase._common.files import read_file, require_other_file, write_files
from cornercase.scenario import LogicalScenario, Parameter, ParameterSpace, VariedScenario, value_text


@contextmanager
def explored_file(
    scenario: LogicalScenario | Path | str | None,
    study: Path,
    space: Path | str | None,
    ranges: Sequence[str],
    vary: Sequence[str],
    continuous: bool,
) -> Iterator[LogicalScenario]:
    """Read the logical scenario of `explore`; with `vary`, write and read a copy with parameters next to the study.

    The copy is removed if no study is created. Raises `InputError` if an argument cannot be used, or the study belongs
    to another scenario.
    """
    if isinstance(scenario, LogicalScenario):
        if space is not None or ranges or vary or continuous:
            raise InputError(
                "`space`, `ranges`, `vary` and `continuous` apply to scenario files only; this scenario has a space."
            )
        yield scenario
        return
    variables = texts("vary", vary)
    if not variables:
        yield LogicalScenario.read(scenario, space, ranges, continuous)
        return
    if scenario is None:
        if space is None:
            raise InputError("`vary`: no scenario given; name an OpenSCENARIO file.")
        scenario = ParameterSpace.scenario_file(space)
    varied = VariedScenario.read(scenario, variables)
    file = study.with_name(f"{study.stem}.varied.xosc")
    created = [target for target in (file, *file.parents) if not target.exists()]
    extra_files = varied.beside(file.parent)
    _write(varied, extra_files, file, study)
    try:
        all_ranges = [*texts("ranges", ranges), *map(_range_text, varied.parameters)]
        logical = LogicalScenario.read(file, space, all_ranges, continuous)
        _require_roads_here(logical, varied, file)
        yield replace(logical, space=varied.with_units(logical.space))
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
            raise InputError(str(error).replace(str(file), str(varied.source.path))) from error
        raise


def _write(varied: VariedScenario, beside: Mapping[Path, bytes], file: Path, study: Path) -> None:
    """Write the copy; an existing study requires an identical one."""
    for source_file in varied.source.files():
        require_other_file(file, source_file, "study")
    content = varied.content(file.parent)
    previous = read_file(file) if file.exists() else None
    if previous == content:
        return
    if previous is not None and study.exists():
        raise InputError(
            f"{study}: was created with another scenario file or other names for `vary` ({file.name} differs); give the"
            " same, or name another study."
        )
    write_files({**beside, file: content})


def _range_text(one: Parameter) -> str:
    step = "" if one.step is None else f":{value_text(one.step)}"
    return f"{one.name}={value_text(one.low)}:{value_text(one.high)}{step}"


def _require_roads_here(logical: LogicalScenario, varied: VariedScenario, file: Path) -> None:
    """Refuse a space that names road files relative to a folder other than that of the study."""
    roads = set(logical.space.assigns) & varied.source.path_parameters
    if roads and file.parent.resolve() != varied.source.path.parent.resolve():
        raise InputError(
            f"{varied.source.path}: the parameter {min(roads)} names road files relative to the scenario's folder; with"
            f" `vary`, write the study into that folder instead of {file.parent}."
        )
