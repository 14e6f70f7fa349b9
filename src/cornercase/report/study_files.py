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
from cornercase.drivers import driver_command, driver_of_file, driver_text
from cornercase.metrics import condition_of
from cornercase.scenario import LogicalScenario, Parameter, ParameterSpace, Scenario
from cornercase.study import IMPORTED, Study, StudyMeta, explored_scenario, open_study

SIMULATOR_OPTIONS: Final = {"time_step": "--time-step", "duration": "--duration", "on_collision": "--on-collision"}
"""Command option of each simulator setting."""

_SPACE: Final = "SPACE.xosc"
_BOOLEANS: Final = ("false", "true")
_FLAGS: Final = ("--pareto", "--asynchronous")
_ESTIMATE: Final = "importance-sampling:"
_UNNAMED: Final = "DRIVER"
# Limits when searching the file of the parameter space.
_LOOKED_AT: Final = 100
_LARGEST: Final = 1_000_000
_LISTS: Final = ("other", "metric", "range", "weight", "driver")
_TEXTS: Final = ("ego", "space", "warm-start", "critical-if", "optimizer", "simulator", "on-collision", *_LISTS)


def name_command(meta: StudyMeta) -> str:
    """Return the command that makes a study again, to be run in the folder of the scenario or imported recordings."""
    if meta.optimizer.startswith(_ESTIMATE):
        arguments = ["estimate", "STUDY.db", *_numbers(meta)]
    elif meta.simulator == IMPORTED:
        arguments = ["import", meta.file_name, *_measures(meta), *_table(meta)]
    elif meta.suite:
        arguments = ["test", meta.title, *_measured(meta), *_required(meta), *_simulator(meta)]
    else:
        arguments = ["explore", meta.file_name, *_ranges(meta), *_measures(meta), *_search(meta), *_simulator(meta)]
    return shlex.join(["cornercase", *arguments, "-o", "study.db"])


def explore_options(meta: StudyMeta) -> dict[str, list[str]] | None:
    """Return the `explore` options of a study as values by option name; None if another command made it."""
    if meta.optimizer.startswith(_ESTIMATE) or meta.simulator == IMPORTED or meta.suite:
        return None
    arguments = iter([*_ranges(meta), *_measures(meta), *_search(meta), *_simulator(meta)])
    values_by_option: dict[str, list[str]] = {}
    for option in arguments:
        values = values_by_option.setdefault(option.removeprefix("--"), [])
        if option not in _FLAGS:
            values.append(next(arguments))
    return values_by_option


def tell_limits(meta: StudyMeta, run: int) -> Iterator[str]:
    """Describe what the command cannot express, given the number of scenarios that have ended."""
    if meta.optimizer.startswith(_ESTIMATE):
        yield "STUDY.db stands for the study that the estimate was made of."
    elif meta.suite:
        yield from tell_unnamed_drivers(meta)
    elif meta.simulator != IMPORTED:
        if not all(map(_is_range, meta.space.parameters)):
            yield f"{_SPACE} stands for the file that says what varies: the study holds its content, but not its name."
        yield from tell_unnamed_drivers(meta)
        if run < meta.budget:
            yield f"The study holds {run} scenarios of {meta.budget}: the search was ended before, or goes on."


def tell_unnamed_drivers(meta: StudyMeta) -> Iterator[str]:
    """Describe the drivers that no command can name because Python code created them."""
    for entity, driver in meta.drivers.items():
        if driver_command(driver) is None:
            yield (
                f"{_UNNAMED} stands for the driver of {entity}, an object that Python code made"
                f" ({driver_text(driver)}): the study does not hold how."
            )


def tell_again(meta: StudyMeta) -> str:
    """Describe how to run the failed scenarios of a study again."""
    if meta.simulator == IMPORTED:
        return "Mend the recordings, and import them into another study."
    if meta.suite or meta.optimizer.startswith(_ESTIMATE):
        return "Mend the cause, and give the same command with another study."
    return (
        "Mend the cause. The command below with --retry-failed runs the failed scenarios again, as long as nothing of"
        " the scenario or of the simulator's settings has changed; if it has, name another study."
    )


def _is_range(parameter: Parameter) -> bool:
    """Return whether ``--range`` can express the parameter."""
    plain = not parameter.choices or parameter.choices == _BOOLEANS
    return plain and parameter.distribution is None and parameter.low < parameter.high


def _ranges(meta: StudyMeta) -> Iterator[str]:
    if not all(map(_is_range, meta.space.parameters)):
        yield from ("--space", _SPACE)
        return
    for parameter in meta.space.parameters:
        step = "" if parameter.step is None or parameter.choices else f":{_format_number(parameter.step)}"
        yield from (
            "--range",
            f"{parameter.name}={_format_number(parameter.low)}:{_format_number(parameter.high)}{step}",
        )


def _measured(meta: StudyMeta) -> Iterator[str]:
    yield from ("--ego", meta.ego)
    for other in meta.others:
        yield from ("--other", other)
    for name in meta.metrics:
        yield from ("--metric", name)


def _required(meta: StudyMeta) -> Iterator[str]:
    for requirement in meta.requirements:
        yield from ("--require", requirement)


def _measures(meta: StudyMeta) -> Iterator[str]:
    condition = condition_of(meta.metrics)
    yield from _measured(replace(meta, metrics=meta.metrics[1:]) if condition else meta)
    if condition:
        yield from ("--critical-if", condition)
    elif meta.critical is not None:
        yield from ("--critical", _format_number(meta.critical))


def _search(meta: StudyMeta) -> Iterator[str]:
    yield from ("--optimizer", meta.optimizer, *_numbers(meta))
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


def _numbers(meta: StudyMeta) -> Iterator[str]:
    yield from ("--budget", str(meta.budget), "--seed", str(meta.seed))


def _simulator(meta: StudyMeta) -> Iterator[str]:
    yield from ("--simulator", meta.simulator)
    for name, option in SIMULATOR_OPTIONS.items():
        if name in meta.settings:
            value = meta.settings[name]
            yield from (option, _format_number(value) if isinstance(value, int | float) else str(value))
    for entity, driver in meta.drivers.items():
        command = driver_command(driver)
        yield from ("--driver", f"{entity}={_UNNAMED if command is None else command}")


def _table(meta: StudyMeta) -> Iterator[str]:
    # Only the name, as folders of the author are private.
    table = re.split(r"[\\/]", str(meta.settings.get("table", "")))[-1]
    if table not in ("", "parameters.csv"):
        yield from ("--parameters", table)


def _format_number(value: float) -> str:
    """Format a number with all its digits."""
    return repr(int(value)) if float(value).is_integer() and abs(value) < 1e15 else repr(float(value))


def tell_study_file(study: Study | Path | str) -> str:
    """Return a study file (TOML for ``explore --config``) that makes a study again; limits are comments.

    The scenario path is relative to the current folder. InputError if `explore` did not make the study.
    """
    with open_study(study, readonly=True) as opened:
        options = explore_options(opened.meta)
        if options is None:
            raise InputError(f"{opened.path}: was not made by `explore`, so no study file can repeat it.")
        lines = [f"# Makes {opened.path.name} again: cornercase explore --config FILE.toml -o STUDY.db"]
        n_ended = sum(row.state != "pending" for row in opened.rows())
        scenario, space = None, None
        with suppress(InputError):
            scenario = explored_scenario(opened)
        if scenario is not None and (space := _space_beside(scenario, opened.space)) is not None:
            options = options | {"space": [_from_here(space)]}
            options.pop("range", None)
        limits = [] if space is not None else tell_limits(opened.meta, n_ended)
        lines += [f"# {sentence}" for sentence in limits]
        name = opened.meta.file_name if scenario is None else _from_here(scenario.path)
        lines += [f"scenario = {_text(name)}", *_settings(options)]
    return "\n".join(map(_on_one_line, lines)) + "\n"


def _from_here(path: Path) -> str:
    try:
        return Path(os.path.relpath(path)).as_posix()
    except ValueError:
        # There is no relative path to another drive.
        return str(path)


def _space_beside(scenario: Scenario, space: ParameterSpace) -> Path | None:
    """Find the file beside the scenario with the parameter space: options cannot express units and constraints."""
    for path in sorted(scenario.path.parent.glob("*.xosc"))[:_LOOKED_AT]:
        with suppress(InputError, OSError):
            if path.stat().st_size > _LARGEST:
                continue
            if LogicalScenario.read(scenario, path).space.to_json() == space.to_json():
                return path
    return None


def _settings(options: dict[str, list[str]]) -> Iterator[str]:
    for key, values in options.items():
        if key == "simulator" and ":" in values[0]:
            yield f"# Its options are not for a file: --simulator {values[0]}"
            values = [values[0].partition(":")[0]]
        if key == "driver":
            unregistered = [driver for driver in values if not _is_for_file(driver.partition("=")[2])]
            yield from (f"# A class of one's own has to be given again: --driver {driver}" for driver in unregistered)
            values = [driver for driver in values if driver not in unregistered]
        if key in _LISTS:
            if values:
                yield f"{key} = [{', '.join(map(_text, values))}]"
        elif not values:
            yield f"{key} = true"
        else:
            yield f"{key} = {_text(values[0]) if key in _TEXTS else values[0]}"


def _is_for_file(driver: str) -> bool:
    try:
        driver_of_file(driver)
    except InputError:
        return False
    return True


def _text(value: str) -> str:
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")


def _on_one_line(line: str) -> str:
    """Keep a comment on one line, whatever names it contains."""
    return " ".join(line.splitlines()) if line.startswith("#") else line
