"""The command line and the study file that make a study again."""

from __future__ import annotations

import json
import os
import re
import shlex
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Final

from cornercase._common.errors import InputError
from cornercase.drivers._description import driver_command_option, format_driver
from cornercase.drivers._resolve import create_driver_named_in_file
from cornercase.metrics._critical_if import find_critical_if_condition
from cornercase.scenario import LogicalScenario, Parameter, ParameterSpace
from cornercase.scenario._file import ScenarioFile
from cornercase.study import StudyFile, StudyMeta
from cornercase.study._import_recordings import IMPORTED_SIMULATOR
from cornercase.study._scenario_file import find_explored_scenario
from cornercase.study._study_file import open_study

OPTION_BY_SETTING: Final = {"time_step": "--time-step", "duration": "--duration", "on_collision": "--on-collision"}
"""Command option of each simulator setting."""

_SPACE_PLACEHOLDER: Final = "SPACE.xosc"
_BOOLEANS: Final = ("false", "true")
_FLAG_OPTIONS: Final = ("--pareto", "--asynchronous")
_ESTIMATE_PREFIX: Final = "importance-sampling:"
_DRIVER_PLACEHOLDER: Final = "DRIVER"
# Limits when searching the file of the parameter space.
_MAX_FILES: Final = 100
_MAX_BYTES: Final = 1_000_000
_LIST_OPTIONS: Final = ("other", "metric", "range", "weight", "driver")
_TEXT_OPTIONS: Final = (
    "ego",
    "space",
    "warm-start",
    "critical-if",
    "optimizer",
    "simulator",
    "on-collision",
    *_LIST_OPTIONS,
)


def format_command(meta: StudyMeta) -> str:
    """Return the command that makes a study again, to be run in the folder of the scenario or imported recordings."""
    if meta.optimizer.startswith(_ESTIMATE_PREFIX):
        arguments = ["estimate", "STUDY.db", *_budget_and_seed_options(meta)]
    elif meta.simulator == IMPORTED_SIMULATOR:
        arguments = ["import", meta.file_name, *_measure_and_threshold_options(meta), *_parameter_table_option(meta)]
    elif meta.suite:
        arguments = [
            "test",
            meta.title,
            *_measure_options(meta),
            *_requirement_options(meta),
            *_simulator_options(meta),
        ]
    else:
        arguments = [
            "explore",
            meta.file_name,
            *_range_options(meta),
            *_measure_and_threshold_options(meta),
            *_search_options(meta),
            *_simulator_options(meta),
        ]
    return shlex.join(["cornercase", *arguments, "-o", "study.db"])


def list_explore_options(meta: StudyMeta) -> dict[str, list[str]] | None:
    """Return the `explore` options of a study as values by option name; None if another command made it."""
    if meta.optimizer.startswith(_ESTIMATE_PREFIX) or meta.simulator == IMPORTED_SIMULATOR or meta.suite:
        return None
    arguments = iter(
        [
            *_range_options(meta),
            *_measure_and_threshold_options(meta),
            *_search_options(meta),
            *_simulator_options(meta),
        ]
    )
    values_by_option: dict[str, list[str]] = {}
    for option in arguments:
        values = values_by_option.setdefault(option.removeprefix("--"), [])
        if option not in _FLAG_OPTIONS:
            values.append(next(arguments))
    return values_by_option


def describe_limits(meta: StudyMeta, n_ended: int) -> Iterator[str]:
    """Describe what the command cannot express, given the number of scenarios that have ended."""
    if meta.optimizer.startswith(_ESTIMATE_PREFIX):
        yield "STUDY.db stands for the study that the estimate was made of."
    elif meta.suite:
        yield from describe_unnamed_drivers(meta)
    elif meta.simulator != IMPORTED_SIMULATOR:
        if not all(map(_is_expressible_as_range, meta.space.parameters)):
            yield (
                f"{_SPACE_PLACEHOLDER} stands for the file that says what varies: the study holds"
                f" its content, but not its name."
            )
        yield from describe_unnamed_drivers(meta)
        if n_ended < meta.budget:
            yield f"The study holds {n_ended} scenarios of {meta.budget}: the search was ended before, or goes on."


def describe_unnamed_drivers(meta: StudyMeta) -> Iterator[str]:
    """Describe the drivers that no command can name because Python code created them."""
    for entity, driver in meta.drivers.items():
        if driver_command_option(driver) is None:
            yield (
                f"{_DRIVER_PLACEHOLDER} stands for the driver of {entity}, an object that Python code made"
                f" ({format_driver(driver)}): the study does not hold how."
            )


def describe_retry(meta: StudyMeta) -> str:
    """Describe how to run the failed scenarios of a study again."""
    if meta.simulator == IMPORTED_SIMULATOR:
        return "Mend the recordings, and import them into another study."
    if meta.suite or meta.optimizer.startswith(_ESTIMATE_PREFIX):
        return "Mend the cause, and give the same command with another study."
    return (
        "Mend the cause. The command below with --retry-failed runs the failed scenarios again, as long as nothing of"
        " the scenario or of the simulator's settings has changed; if it has, name another study."
    )


def _is_expressible_as_range(parameter: Parameter) -> bool:
    """Return whether ``--range`` can express the parameter."""
    plain = not parameter.choices or parameter.choices == _BOOLEANS
    return plain and parameter.distribution is None and parameter.low < parameter.high


def _range_options(meta: StudyMeta) -> Iterator[str]:
    if not all(map(_is_expressible_as_range, meta.space.parameters)):
        yield from ("--space", _SPACE_PLACEHOLDER)
        return
    for parameter in meta.space.parameters:
        step = "" if parameter.step is None or parameter.choices else f":{_format_number(parameter.step)}"
        yield from (
            "--range",
            f"{parameter.name}={_format_number(parameter.low)}:{_format_number(parameter.high)}{step}",
        )


def _measure_options(meta: StudyMeta) -> Iterator[str]:
    yield from ("--ego", meta.ego)
    for other in meta.others:
        yield from ("--other", other)
    for name in meta.metrics:
        yield from ("--metric", name)


def _requirement_options(meta: StudyMeta) -> Iterator[str]:
    for requirement in meta.requirements:
        yield from ("--require", requirement)


def _measure_and_threshold_options(meta: StudyMeta) -> Iterator[str]:
    condition = find_critical_if_condition(meta.metrics)
    yield from _measure_options(replace(meta, metrics=meta.metrics[1:]) if condition else meta)
    if condition:
        yield from ("--critical-if", condition)
    elif meta.critical is not None:
        yield from ("--critical", _format_number(meta.critical))


def _search_options(meta: StudyMeta) -> Iterator[str]:
    yield from ("--optimizer", meta.optimizer, *_budget_and_seed_options(meta))
    if meta.batch:
        yield from ("--batch", str(meta.batch))
    for name, weight in meta.weights.items():
        yield from ("--weight", f"{name}={_format_number(weight)}")
    if meta.pareto:
        yield "--pareto"
    if meta.repeats > 1:
        yield from ("--repeats", str(meta.repeats))
    if meta.most_repeats is not None:
        yield from ("--max-repeats", str(meta.most_repeats))
    if meta.audit:
        yield from ("--audit", _format_number(meta.audit))
    if meta.asynchronous:
        yield "--asynchronous"
    if meta.elsewhere:
        yield from ("--warm-start", meta.elsewhere["study"])


def _budget_and_seed_options(meta: StudyMeta) -> Iterator[str]:
    yield from ("--budget", str(meta.budget), "--seed", str(meta.seed))


def _simulator_options(meta: StudyMeta) -> Iterator[str]:
    yield from ("--simulator", meta.simulator)
    for name, option in OPTION_BY_SETTING.items():
        if name in meta.settings:
            value = meta.settings[name]
            yield from (option, _format_number(value) if isinstance(value, int | float) else str(value))
    for entity, driver in meta.drivers.items():
        command = driver_command_option(driver)
        yield from ("--driver", f"{entity}={_DRIVER_PLACEHOLDER if command is None else command}")


def _parameter_table_option(meta: StudyMeta) -> Iterator[str]:
    # Only the name, as folders of the author are private.
    table = re.split(r"[\\/]", str(meta.settings.get("table", "")))[-1]
    if table not in ("", "parameters.csv"):
        yield from ("--parameters", table)


def _format_number(value: float) -> str:
    """Format a number with all its digits."""
    return repr(int(value)) if float(value).is_integer() and abs(value) < 1e15 else repr(float(value))


def format_study_file(study: StudyFile | Path | str) -> str:
    """Return a study file (TOML for ``explore --config``) that makes a study again; limits are comments.

    The scenario path is relative to the current folder. InputError if `explore` did not make the study.
    """
    with open_study(study, readonly=True) as opened:
        options = list_explore_options(opened.meta)
        if options is None:
            raise InputError(f"{opened.path}: was not made by `explore`, so no study file can repeat it.")
        lines = [f"# Makes {opened.path.name} again: cornercase explore --config FILE.toml -o STUDY.db"]
        n_ended = sum(row.state != "pending" for row in opened.rows())
        scenario, space = None, None
        with suppress(InputError):
            scenario = find_explored_scenario(opened)
        if scenario is not None and (space := _find_space_file(scenario, opened.space)) is not None:
            options = options | {"space": [_relative_path(space)]}
            options.pop("range", None)
        limits = [] if space is not None else describe_limits(opened.meta, n_ended)
        lines += [f"# {sentence}" for sentence in limits]
        name = opened.meta.file_name if scenario is None else _relative_path(scenario.path)
        lines += [f"scenario = {_format_toml_string(name)}", *_format_settings(options)]
    return "\n".join(map(_on_one_line, lines)) + "\n"


def _relative_path(path: Path) -> str:
    try:
        return Path(os.path.relpath(path)).as_posix()
    except ValueError:
        # There is no relative path to another drive.
        return str(path)


def _find_space_file(scenario: ScenarioFile, space: ParameterSpace) -> Path | None:
    """Find the file beside the scenario with the parameter space: options cannot express units and constraints."""
    for path in sorted(scenario.path.parent.glob("*.xosc"))[:_MAX_FILES]:
        with suppress(InputError, OSError):
            if path.stat().st_size > _MAX_BYTES:
                continue
            if LogicalScenario.read(scenario, path).space.to_json() == space.to_json():
                return path
    return None


def _format_settings(options: dict[str, list[str]]) -> Iterator[str]:
    for key, values in options.items():
        if key == "simulator" and ":" in values[0]:
            yield f"# Its options are not for a file: --simulator {values[0]}"
            values = [values[0].partition(":")[0]]
        if key == "driver":
            unregistered = [driver for driver in values if not _is_registered_driver(driver.partition("=")[2])]
            yield from (f"# A class of one's own has to be given again: --driver {driver}" for driver in unregistered)
            values = [driver for driver in values if driver not in unregistered]
        if key in _LIST_OPTIONS:
            if values:
                yield f"{key} = [{', '.join(map(_format_toml_string, values))}]"
        elif not values:
            yield f"{key} = true"
        else:
            yield f"{key} = {_format_toml_string(values[0]) if key in _TEXT_OPTIONS else values[0]}"


def _is_registered_driver(driver: str) -> bool:
    try:
        create_driver_named_in_file(driver)
    except InputError:
        return False
    return True


def _format_toml_string(value: str) -> str:
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")


def _on_one_line(line: str) -> str:
    """Keep a comment on one line, whatever names it contains."""
    return " ".join(line.splitlines()) if line.startswith("#") else line
