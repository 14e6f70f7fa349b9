"""The scenario that a study explores, also where numbers of its file vary that are no parameters."""

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
    """Read the logical scenario of an exploration; arguments are those of `explore`.

    Yields
    ------
    LogicalScenario
        With `vary`, that of a file written beside the study; it is removed where no study comes of it.

    Raises
    ------
    InputError
        Something cannot be used, or the study is of another scenario.
    """
    if isinstance(scenario, LogicalScenario):
        if space is not None or ranges or vary or continuous:
            raise InputError(
                "`space`, `ranges`, `vary` and `continuous` belong to a scenario file; this scenario has its space."
            )
        yield scenario
        return
    asked = texts("vary", vary)
    if not asked:
        yield LogicalScenario.read(scenario, space, ranges, continuous)
        return
    if scenario is None:
        if space is None:
            raise InputError("`vary`: there is no scenario; name an OpenSCENARIO file.")
        scenario = ParameterSpace.scenario_file(space)
    varied = VariedScenario.read(scenario, asked)
    file = study.with_name(f"{study.stem}.varied.xosc")
    made = [one for one in (file, *file.parents) if not one.exists()]
    beside = varied.beside(file.parent)
    _write(varied, beside, file, study)
    try:
        every = [*texts("ranges", ranges), *map(_range_text, varied.parameters)]
        logical = LogicalScenario.read(file, space, every, continuous)
        _require_roads_here(logical, varied, file)
        yield replace(logical, space=varied.with_units(logical.space))
    except BaseException as error:
        if file not in made or study.exists():
            raise
        for one in (file, *beside):
            one.unlink(missing_ok=True)
        with suppress(OSError):
            for folder in made[1:]:
                folder.rmdir()
        if type(error) is InputError:
            # What it names is not there any more.
            raise InputError(str(error).replace(str(file), str(varied.source.path))) from error
        raise


def _write(varied: VariedScenario, beside: Mapping[Path, bytes], file: Path, study: Path) -> None:
    """Write the scenario beside the study; one that is there goes on with the same only."""
    for one in varied.source.files():
        require_other_file(file, one, "study")
    content = varied.content(file.parent)
    before = read_file(file) if file.exists() else None
    if before == content:
        return
    if before is not None and study.exists():
        raise InputError(
            f"{study}: was begun with another scenario file or other names for `vary` ({file.name} differs); give the"
            " same, or name another study."
        )
    write_files({**beside, file: content})


def _range_text(one: Parameter) -> str:
    step = "" if one.step is None else f":{value_text(one.step)}"
    return f"{one.name}={value_text(one.low)}:{value_text(one.high)}{step}"


def _require_roads_here(logical: LogicalScenario, varied: VariedScenario, file: Path) -> None:
    """Refuse a space that names road files, where these are named from another folder."""
    roads = set(logical.space.assigns) & varied.source.path_parameters
    if roads and file.parent.resolve() != varied.source.path.parent.resolve():
        raise InputError(
            f"{varied.source.path}: the parameter {min(roads)} names road files from the folder of the scenario; with"
            f" `vary`, write the study into that folder, instead of {file.parent}."
        )
