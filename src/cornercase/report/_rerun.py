"""Command and concrete scenario file with which one scenario of a study is run again."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from lxml import etree

from cornercase._common.errors import InputError
from cornercase._common.io.files import make_portable_file_name
from cornercase._common.text.sanitize import escape_control_characters
from cornercase.drivers._serialization import driver_command_option
from cornercase.reduction import read_reduction
from cornercase.reduction._write_files import build_scenario_file
from cornercase.report._repeat_command import describe_unnamed_drivers
from cornercase.scenario._file import ScenarioFile
from cornercase.scenario._types import INTEGER_TYPES, convert_to_type, format_value
from cornercase.simulators._run_options import SIMULATION_OPTIONS
from cornercase.study import ScenarioRecord, StudyFile, StudyMeta
from cornercase.study._import_recordings import IMPORTED_SIMULATOR
from cornercase.study._scenario_file import find_explored_scenario

_BUILTIN: Final = "builtin"
# Numbers of drivers are written with a decimal point, unlike numbers of the scenario.
_DRIVER_OPTION_TYPE: Final = "option"


def rerun_payload(
    study: StudyFile, scenario: Path | str | ScenarioFile | None = None, *, include_file: bool = True
) -> dict[str, Any]:
    """Return the JSON values with which the page shows how a scenario is run again.

    ``command`` holds the words of the command before and after the parameters, or None for the reason ``why``. ``file``
    holds the pieces of the scenario file between its parameter values, and ``slots``, which say what belongs between
    the pieces; or None for the reason ``file_why``. Without `include_file`, ``file`` is None, because a server provides
    the scenario file. ``key`` identifies the study, so that the browser can store notes of the user.
    """
    meta = study.meta
    why = _reason_without_command(meta)
    name = meta.file_name
    explored, file_why = _find_scenario(study, scenario)
    pieces = (
        _split_at_values(meta, explored, read_selection_reasons(study))
        if include_file and explored is not None
        else None
    )
    facts = {key: value for key, value in meta.to_json().items() if key not in ("budget", "repeatability")}
    return {
        "name": make_portable_file_name(meta.title),
        "key": hashlib.sha256(json.dumps(facts, sort_keys=True).encode()).hexdigest()[:16],
        "command": None
        if why
        else {
            "before": ["cornercase", "simulate", *([] if meta.suite else [_as_argument(name)])],
            "after": _simulate_options(meta),
            # Each scenario of a suite is a file of its own, in the order of ids.
            "files": [_as_argument(file) for file in meta.files] if meta.suite else [],
        },
        "why": why,
        # True if `reduce --ids` can write scenario files of this study. A suite already has a file for each scenario;
        # imported recordings have none.
        "has_scenario": meta.simulator != IMPORTED_SIMULATOR and not meta.suite,
        "file": pieces,
        "file_why": file_why or ("" if pieces or not include_file else "The scenario needs a file that was not found."),
    }


def _as_argument(file: str) -> str:
    """Return a file name as a command line argument; ``./`` before a leading hyphen says that it is no option."""
    return f"./{file}" if file.startswith("-") else file


def _find_scenario(study: StudyFile, given: Path | str | ScenarioFile | None) -> tuple[ScenarioFile | None, str]:
    """Return the scenario file that a study explored and an empty text, or None and the reason."""
    try:
        scenario = find_explored_scenario(study, given)
    except InputError:
        name = study.meta.file_name
        return None, f"The scenario file {name} was not found as it was explored, so that no concrete one can be made."
    return scenario, "" if scenario is not None else "There is no scenario file: the recordings were imported."


def read_selection_reasons(study: StudyFile) -> dict[int, str]:
    """Return why each scenario of the reduced set was selected, by id; empty if the study was not reduced."""
    reduced = read_reduction(study)
    return {} if reduced is None else {scenario.id: scenario.why for scenario in reduced.scenarios}


def render_concrete_scenario(
    meta: StudyMeta, scenario: ScenarioFile, row: ScenarioRecord, selection_reason: str | None
) -> bytes:
    """Return the concrete scenario file of a scenario (UTF-8 XML), with the same content that `reduce` writes."""
    description = _describe_scenario(meta, str(row.id), selection_reason)
    return build_scenario_file(meta, scenario, row.values, Path(meta.file_name), description).content


def _reason_without_command(meta: StudyMeta) -> str:
    if meta.simulator == IMPORTED_SIMULATOR:
        return "Its recording was imported: what made it is not known."
    if any(describe_unnamed_drivers(meta)):
        return "A driver that Python code made drove, and the study does not hold how."
    return ""


def _simulate_options(meta: StudyMeta) -> list[str]:
    options = [
        f"{option.flag}={meta.settings[name]}"
        for name, option in SIMULATION_OPTIONS.items()
        if option.stored == "simulator" and name in meta.settings
    ]
    if meta.simulator != _BUILTIN:
        options += [f"--simulator={meta.simulator}", f"--ego={meta.ego}"]
    if meta.seed and meta.may_draw_random_numbers:
        options.append(f"--seed={meta.seed}")
    return [
        *options,
        *(f"--driver={entity}={driver_command_option(driver)}" for entity, driver in meta.drivers.items()),
    ]


def _describe_scenario(meta: StudyMeta, scenario: str, why: str | None) -> str:
    text = f"Scenario {scenario} of the logical scenario {meta.title}"
    return f"{text}: {why}" if why is not None else text


def _split_at_values(
    meta: StudyMeta, scenario: ScenarioFile, selection_reasons: Mapping[int, str]
) -> dict[str, Any] | None:
    """Split a scenario file at its parameter values and its description, so that a page can insert other texts."""
    assigned = {
        name: [dict(members)[name] for members in parameter.value_sets] or parameter.choices
        for parameter in meta.space.parameters
        for name in parameter.assigned_names
    }
    mark = "$cornercase"
    source = etree.tostring(scenario.root).decode()
    while mark in source:
        mark += "-"
    marks = {name: f"{mark}:{k}:" for k, name in enumerate(assigned)}
    try:
        text = build_scenario_file(meta, scenario, marks, Path(meta.file_name), f"{mark}:n:").content.decode()
    except (InputError, UnicodeDecodeError):
        # A file that the scenario file needs is missing.
        return None
    first, *rest = text.split(f"{mark}:")
    slots = [piece.partition(":")[0] for piece in rest]
    pieces = [first, *(piece.partition(":")[2] for piece in rest)]
    types = {
        element.get("name"): element.get("parameterType")
        for element in scenario.root.iterfind("ParameterDeclarations/*")
    }
    types |= dict.fromkeys(scenario.parse_driver_option_names(assigned), _DRIVER_OPTION_TYPE)
    return {
        "pieces": pieces,
        # Index of a scenario parameter, as the varied parameters set them in turn; None for the description.
        "slots": [None if slot == "n" else int(slot) for slot in slots],
        "kinds": [types.get(name, "string") for name in assigned],
        "whole": sorted(INTEGER_TYPES),
        "choices": [
            [_escape_attribute(_format_choice(choice, types.get(name))) for choice in choices]
            for name, choices in assigned.items()
        ],
        # Text before and after the id of a scenario without a selection reason.
        "description": [
            _escape_attribute(escape_control_characters(text))
            for text in _describe_scenario(meta, "\0", None).split("\0")
        ],
        "kept": {
            str(scenario): _escape_attribute(escape_control_characters(_describe_scenario(meta, str(scenario), why)))
            for scenario, why in sorted(selection_reasons.items())
        },
    }


def _format_choice(choice: str, parameter_type: str | None) -> str:
    return (
        choice if choice.lstrip().startswith("$") else format_value(convert_to_type(choice, parameter_type or "string"))
    )


def _escape_attribute(text: str) -> str:
    """Escape text as an XML attribute value."""
    element = etree.Element("a", b=text)
    return etree.tostring(element, encoding="unicode").removeprefix('<a b="').removesuffix('"/>')
