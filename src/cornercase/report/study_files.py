"""The file that makes a study again, in place of many options."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Final

from cornercase._common.errors import InputError
from cornercase.drivers import driver_of_file
from cornercase.report.repeating import explore_options, tell_limits
from cornercase.scenario import LogicalScenario, ParameterSpace, Scenario
from cornercase.study import Study, explored_scenario, open_study

# Files that may say what varies, and bytes of one.
_LOOKED_AT: Final = 100
_LARGEST: Final = 1_000_000
_LISTS: Final = ("other", "metric", "range", "weight", "driver")
_TEXTS: Final = ("ego", "space", "warm-start", "critical-if", "optimizer", "simulator", "on-collision", *_LISTS)


def tell_study_file(study: Study | Path | str) -> str:
    """Say in a study file how a study is made again.

    Parameters
    ----------
    study : Study or path
        Of a search; it is only read.

    Returns
    -------
    str
        TOML, as ``cornercase explore --config`` takes it; what such a file cannot say stands in comments. The scenario
        is named as it is found from the current folder.

    Raises
    ------
    InputError
        The study was not made by `explore`.
    """
    with open_study(study, readonly=True) as opened:
        options = explore_options(opened.meta)
        if options is None:
            raise InputError(f"{opened.path}: was not made by `explore`, so no study file can repeat it.")
        lines = [f"# Makes {opened.path.name} again: cornercase explore --config FILE.toml -o STUDY.db"]
        ended = sum(row.state != "pending" for row in opened.rows())
        scenario, space = None, None
        with suppress(InputError):
            scenario = explored_scenario(opened)
        if scenario is not None and (space := _space_beside(scenario, opened.space)) is not None:
            options = options | {"space": [_from_here(space)]}
            options.pop("range", None)
        limits = [] if space is not None else tell_limits(opened.meta, ended)
        lines += [f"# {sentence}" for sentence in limits]
        name = opened.meta.file_name if scenario is None else _from_here(scenario.path)
        lines += [f"scenario = {_text(name)}", *_settings(options)]
    return "\n".join(map(_plain, lines)) + "\n"


def _from_here(path: Path) -> str:
    try:
        return Path(os.path.relpath(path)).as_posix()
    except ValueError:
        # Of another drive there is no way from here.
        return str(path)


def _space_beside(scenario: Scenario, space: ParameterSpace) -> Path | None:
    """Find the file that says what varies: units and constraints are no options."""
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
            own = [one for one in values if not _is_for_file(one.partition("=")[2])]
            yield from (f"# A class of one's own has to be given again: --driver {one}" for one in own)
            values = [one for one in values if one not in own]
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


def _plain(line: str) -> str:
    """Keep a comment on its line, whatever things are called."""
    return " ".join(line.splitlines()) if line.startswith("#") else line
