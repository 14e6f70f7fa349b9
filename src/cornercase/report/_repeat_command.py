"""Command line, or study file (TOML for ``explore --config``), that repeats a study."""

from __future__ import annotations

import json
import os
import re
import shlex
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

from cornercase._common.errors import InputError
from cornercase._common.option import Option
from cornercase.drivers._resolve import may_be_named_in_file
from cornercase.drivers._serialization import driver_command_option, format_driver
from cornercase.exploration._explore_options import OPTIONS, read_stored_options
from cornercase.scenario import LogicalScenario, Parameter, ParameterSpace
from cornercase.scenario._file import ScenarioFile
from cornercase.study import StudyFile, StudyMeta
from cornercase.study._import_recordings import IMPORTED_SIMULATOR
from cornercase.study._scenario_file import find_explored_scenario
from cornercase.study._study_file import open_study

_SPACE_PLACEHOLDER: Final = "SPACE.xosc"
_BOOLEANS: Final = ("false", "true")
_ESTIMATE_PREFIX: Final = "importance-sampling:"
_DRIVER_PLACEHOLDER: Final = "DRIVER"
# Limits when searching the file of the parameter space.
_MAX_FILES: Final = 100
_MAX_BYTES: Final = 1_000_000
_MEASURE: Final = ("ego", "other", "metrics")
_SIMULATION: Final = ("simulator", "time_step", "duration", "on_collision", "drivers")


def format_repeat_command(meta: StudyMeta) -> str:
    """Return the command line that makes a study again, if run in the folder of its scenario or imported recordings."""
    if meta.optimizer.startswith(_ESTIMATE_PREFIX):
        arguments = ["estimate", "STUDY.db", *_arguments(meta, "budget", "seed")]
    elif meta.simulator == IMPORTED_SIMULATOR:
        options = _arguments(meta, *_MEASURE, "critical_if", "critical")
        arguments = ["import", meta.file_name, *options, *_parameter_table_option(meta)]
    elif meta.suite:
        requirements = (text for requirement in meta.requirements for text in ("--require", requirement))
        arguments = ["test", meta.title, *_arguments(meta, *_MEASURE), *requirements, *_arguments(meta, *_SIMULATION)]
    else:
        arguments = ["explore", meta.file_name, *_arguments(meta, *OPTIONS)]
    return shlex.join(["cornercase", *arguments, "-o", "study.db"])


def _arguments(meta: StudyMeta, *names: str) -> Iterator[str]:
    """Yield command line arguments for the options with these names, with the values that the study holds.

    Options for which the study holds no value are left out.
    """
    for name, texts in _format_options(meta).items():
        if name in names:
            flag = OPTIONS[name].flag
            yield from (
                (item for text in texts for item in (flag, text)) if OPTIONS[name].annotation != "bool" else [flag]
            )


def _format_options(meta: StudyMeta) -> dict[str, list[str]]:
    """Return the values of a study's options as texts for the command line, by option name."""
    values = read_stored_options(meta) | _format_space_option(meta)
    return {
        name: _format_values(option, value)
        for name, option in OPTIONS.items()
        if (value := values.get(name)) is not None and value is not False and value not in ((), [], {})
    }


def _format_values(option: Option, value: Any) -> list[str]:
    if option.name == "drivers":
        commands = {entity: driver_command_option(driver) for entity, driver in value.items()}
        return [
            f"{entity}={_DRIVER_PLACEHOLDER if command is None else command}" for entity, command in commands.items()
        ]
    if option.is_mapping:
        return [f"{name}={_format_number(number)}" for name, number in value.items()]
    if option.is_list:
        return list(value)
    return [_format_number(value) if option.annotation == "float" else str(value)]


def _format_space_option(meta: StudyMeta) -> dict[str, list[str] | str]:
    """Return a study's parameter space as ``--range`` options, or a file placeholder if these cannot express it."""
    if not all(map(_is_expressible_as_range, meta.space.parameters)):
        return {"space": _SPACE_PLACEHOLDER}
    return {"ranges": [_format_range(parameter) for parameter in meta.space.parameters]}


def _format_range(parameter: Parameter) -> str:
    step = "" if parameter.step is None or parameter.choices else f":{_format_number(parameter.step)}"
    return f"{parameter.name}={_format_number(parameter.low)}:{_format_number(parameter.high)}{step}"


def describe_inexpressible_parts(meta: StudyMeta, n_ended: int, *, has_space_file: bool = False) -> Iterator[str]:
    """Yield a sentence for each part of a study that the command of `format_repeat_command` cannot express.

    `n_ended` is the number of scenarios that have ended. `has_space_file` is True if the command names the file of the
    parameter space.
    """
    if meta.optimizer.startswith(_ESTIMATE_PREFIX):
        yield "STUDY.db stands for the study that the estimate was made of."
    elif meta.suite:
        yield from describe_unnamed_drivers(meta)
    elif meta.simulator != IMPORTED_SIMULATOR:
        if not has_space_file and not all(map(_is_expressible_as_range, meta.space.parameters)):
            yield (
                f"{_SPACE_PLACEHOLDER} stands for the file that says what varies: the study holds"
                f" its content, but not its name."
            )
        yield from describe_unnamed_drivers(meta)
        if n_ended < meta.budget:
            yield (
                f"The study holds {n_ended} scenarios of {meta.budget}: the search was interrupted, or goes on, or"
                " rules such as --stop-when ended it, which a study does not hold."
            )


def describe_unnamed_drivers(meta: StudyMeta) -> Iterator[str]:
    """Yield a sentence for each driver of a study that no command can name, because Python code created the driver."""
    for entity, driver in meta.drivers.items():
        if driver_command_option(driver) is None:
            yield (
                f"{_DRIVER_PLACEHOLDER} stands for the driver of {entity}, an object that Python code made"
                f" ({format_driver(driver)}): the study does not hold how."
            )


def describe_retry(meta: StudyMeta, file_name: str) -> str:
    """Return a text that tells the user how to run the failed scenarios of the study in a file again."""
    if meta.simulator == IMPORTED_SIMULATOR:
        return "Mend the recordings, and import them into another study."
    if meta.suite or meta.optimizer.startswith(_ESTIMATE_PREFIX):
        return "Mend the cause, and give the same command with another study."
    return (
        f"Mend the cause. The command below with --retry-failed and -o {shlex.quote(file_name)} runs the failed"
        " scenarios again, as long as nothing of the scenario or of the simulator's settings has changed; if it has,"
        " name another study."
    )


def _is_expressible_as_range(parameter: Parameter) -> bool:
    """Return whether the option ``--range`` can express a parameter."""
    plain = not parameter.choices or parameter.choices == _BOOLEANS
    return plain and parameter.distribution is None and parameter.low < parameter.high


def _parameter_table_option(meta: StudyMeta) -> Iterator[str]:
    # Only the name, as folders of the author are private.
    table = re.split(r"[\\/]", str(meta.settings.get("table", "")))[-1]
    if table not in ("", "parameters.csv"):
        yield from ("--parameters", table)


def _format_number(value: float) -> str:
    """Format a number with all digits that distinguish it from other numbers."""
    return repr(int(value)) if float(value).is_integer() and abs(value) < 1e15 else repr(float(value))


def format_toml_study_file(study: StudyFile | Path | str) -> str:
    """Return the text of a study file (TOML for ``explore --config``) that makes a study again.

    Comments list the parts of the study that TOML cannot express. The path of the scenario is relative to the current
    folder. InputError if `explore` did not make the study.
    """
    with open_study(study, readonly=True) as opened:
        meta = opened.meta
        if meta.optimizer.startswith(_ESTIMATE_PREFIX) or meta.simulator == IMPORTED_SIMULATOR or meta.suite:
            raise InputError(f"{opened.path}: was not made by `explore`, so no study file (TOML) can repeat it.")
        lines = [f"# Makes {opened.path.name} again: cornercase explore --config FILE.toml -o STUDY.db"]
        options = _format_options(meta)
        n_ended = sum(row.state != "pending" for row in opened.rows())
        scenario, space = None, None
        with suppress(InputError):
            scenario = find_explored_scenario(opened, search_remembered_path=False)
        if scenario is not None and (space := _find_space_file(scenario, opened.space)) is not None:
            options.pop("ranges", None)
            options |= {"space": [_relative_path(space)]}
        limits = describe_inexpressible_parts(meta, n_ended, has_space_file=space is not None)
        lines += [f"# {sentence}" for sentence in limits]
        name = meta.file_name if scenario is None else _relative_path(scenario.path)
        lines += [f"scenario = {_format_toml_string(name)}", *_format_settings(options)]
    return "\n".join(map(_keep_comment_on_one_line, lines)) + "\n"


def _relative_path(path: Path) -> str:
    try:
        return Path(os.path.relpath(path)).as_posix()
    except ValueError:
        # There is no relative path to another drive.
        return str(path)


def _find_space_file(scenario: ScenarioFile, space: ParameterSpace) -> Path | None:
    """Return the file beside the scenario that holds the parameter space; None if there is none.

    The file is needed because options of the command line cannot express units, distributions and sets of choices.
    """
    for path in sorted(scenario.path.parent.glob("*.xosc"))[:_MAX_FILES]:
        with suppress(InputError, OSError):
            if path.stat().st_size > _MAX_BYTES:
                continue
            if LogicalScenario.read(scenario, path).space.to_json() == space.to_json():
                return path
    return None


def _format_settings(options: dict[str, list[str]]) -> Iterator[str]:
    for option, values in ((OPTIONS[name], values) for name, values in options.items()):
        if option.name == "simulator" and ":" in values[0]:
            yield f"# Its options are not for a file: --simulator {values[0]}"
            values = [values[0].partition(":")[0]]
        if option.name == "drivers":
            unregistered = [driver for driver in values if not may_be_named_in_file(driver.partition("=")[2])]
            yield from (
                f"# A class of one's own has to be given again: --driver {shlex.quote(driver)}"
                for driver in unregistered
            )
            values = [driver for driver in values if driver not in unregistered]
        if option.is_list:
            if values:
                yield f"{option.key} = [{', '.join(map(_format_toml_string, values))}]"
        elif option.annotation in ("int", "float", "bool"):
            yield f"{option.key} = {values[0].lower()}"
        else:
            yield f"{option.key} = {_format_toml_string(values[0])}"


def _format_toml_string(value: str) -> str:
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")


def _keep_comment_on_one_line(line: str) -> str:
    """Replace line breaks by spaces if the text is a TOML comment, since names in comments may contain line breaks."""
    return " ".join(line.splitlines()) if line.startswith("#") else line
