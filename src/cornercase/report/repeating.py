"""The command that makes a study again."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from dataclasses import replace
from typing import Final

from cornercase.drivers import driver_command, driver_text
from cornercase.metrics import condition_of
from cornercase.scenario import Parameter
from cornercase.study import IMPORTED, StudyMeta

SIMULATOR_OPTIONS: Final = {"time_step": "--time-step", "duration": "--duration", "on_collision": "--on-collision"}
"""Settings of a simulator that are options of commands."""

_SPACE: Final = "SPACE.xosc"
_BOOLEANS: Final = ("false", "true")
_FLAGS: Final = ("--pareto", "--asynchronous")
_ESTIMATE: Final = "importance-sampling:"
_UNNAMED: Final = "DRIVER"


def name_command(meta: StudyMeta) -> str:
    """Name the command that makes a study again.

    Parameters
    ----------
    meta : StudyMeta
        What the study is about.

    Returns
    -------
    str
        One line for a shell, to be called in the folder of the scenario or of the imported one.
    """
    if meta.optimizer.startswith(_ESTIMATE):
        words = ["estimate", "STUDY.db", *_numbers(meta)]
    elif meta.simulator == IMPORTED:
        words = ["import", meta.file_name, *_measures(meta), *_table(meta)]
    elif meta.suite:
        words = ["test", meta.title, *_measured(meta), *_required(meta), *_simulator(meta)]
    else:
        words = ["explore", meta.file_name, *_ranges(meta), *_measures(meta), *_search(meta), *_simulator(meta)]
    return shlex.join(["cornercase", *words, "-o", "study.db"])


def explore_options(meta: StudyMeta) -> dict[str, list[str]] | None:
    """Give the options of `explore` that make a study again.

    Parameters
    ----------
    meta : StudyMeta
        What the study is about.

    Returns
    -------
    dict of str to list of str, or None
        Values by the name of the option, none of a flag. None where another command made the study.
    """
    if meta.optimizer.startswith(_ESTIMATE) or meta.simulator == IMPORTED or meta.suite:
        return None
    words = iter([*_ranges(meta), *_measures(meta), *_search(meta), *_simulator(meta)])
    found: dict[str, list[str]] = {}
    for option in words:
        values = found.setdefault(option.removeprefix("--"), [])
        if option not in _FLAGS:
            values.append(next(words))
    return found


def tell_limits(meta: StudyMeta, run: int) -> Iterator[str]:
    """Say what the command does not hold, as far as it may matter.

    Parameters
    ----------
    meta : StudyMeta
        What the study is about.
    run : int
        Number of scenarios that were run or failed.

    Yields
    ------
    str
        A sentence.
    """
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
    """Say which drivers no command can name, since Python code made them.

    Parameters
    ----------
    meta : StudyMeta
        What the study is about.

    Yields
    ------
    str
        A sentence.
    """
    for entity, driver in meta.drivers.items():
        if driver_command(driver) is None:
            yield (
                f"{_UNNAMED} stands for the driver of {entity}, an object that Python code made"
                f" ({driver_text(driver)}): the study does not hold how."
            )


def tell_again(meta: StudyMeta) -> str:
    """Say how the scenarios of a study are run again that failed.

    Parameters
    ----------
    meta : StudyMeta
        What the study is about.

    Returns
    -------
    str
        Sentences.
    """
    if meta.simulator == IMPORTED:
        return "Mend the recordings, and import them into another study."
    if meta.suite or meta.optimizer.startswith(_ESTIMATE):
        return "Mend the cause, and give the same command with another study."
    return (
        "Mend the cause. The command below with --retry-failed runs the failed scenarios again, as long as nothing of"
        " the scenario or of the simulator's settings has changed; if it has, name another study."
    )


def _is_range(parameter: Parameter) -> bool:
    """Whether an option of the command says it all."""
    plain = not parameter.choices or parameter.choices == _BOOLEANS
    return plain and parameter.distribution is None and parameter.low < parameter.high


def _ranges(meta: StudyMeta) -> Iterator[str]:
    if not all(map(_is_range, meta.space.parameters)):
        yield from ("--space", _SPACE)
        return
    for one in meta.space.parameters:
        step = "" if one.step is None or one.choices else f":{_plain(one.step)}"
        yield from ("--range", f"{one.name}={_plain(one.low)}:{_plain(one.high)}{step}")


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
        yield from ("--critical", _plain(meta.critical))


def _search(meta: StudyMeta) -> Iterator[str]:
    yield from ("--optimizer", meta.optimizer, *_numbers(meta))
    if meta.batch:
        yield from ("--batch", str(meta.batch))
    for name, weight in meta.weights.items():
        yield from ("--weight", f"{name}={_plain(weight)}")
    if meta.pareto:
        yield "--pareto"
    if meta.repeats > 1:
        yield from ("--repeats", str(meta.repeats))
    if meta.most_repeats is not None:
        yield from ("--max-repeats", str(meta.most_repeats))
    if meta.audit:
        yield from ("--audit", _plain(meta.audit))
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
            yield from (option, _plain(value) if isinstance(value, int | float) else str(value))
    for entity, driver in meta.drivers.items():
        command = driver_command(driver)
        yield from ("--driver", f"{entity}={_UNNAMED if command is None else command}")


def _table(meta: StudyMeta) -> Iterator[str]:
    # Only the name: where the folders of whoever made the study lie is nobody else's concern.
    table = re.split(r"[\\/]", str(meta.settings.get("table", "")))[-1]
    if table not in ("", "parameters.csv"):
        yield from ("--parameters", table)


def _plain(value: float) -> str:
    """Write a number with all digits that it needs."""
    return repr(int(value)) if float(value).is_integer() and abs(value) < 1e15 else repr(float(value))
