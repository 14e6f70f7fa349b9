"""How one scenario of a study is run again: the command, and its file."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from lxml import etree

from cornercase._common.errors import InputError
from cornercase._common.files import portable_name
from cornercase._common.texts import plain_text
from cornercase.drivers import driver_command
from cornercase.reduction import read_reduction
from cornercase.report.repeating import SIMULATOR_OPTIONS, tell_unnamed_drivers
from cornercase.scenario import INTEGERS, Scenario, Value, fill_concrete, typed_value, value_text
from cornercase.study import IMPORTED, Row, Study, StudyMeta, explored_scenario

_BUILTIN: Final = "builtin"


def tell_rerun(study: Study, given: Path | str | Scenario | None = None, *, whole: bool = True) -> dict[str, Any]:
    """Give what the page needs to run a scenario again.

    Parameters
    ----------
    study : Study
        Open.
    given : path or Scenario, optional
        The one that was explored; by default it is looked for beside the study and in the current folder.
    whole : bool, default True
        Whether the page holds the scenario's file itself, and asks no server for it.

    Returns
    -------
    dict of str to object
        ``name`` of what was explored; ``key``: another one for each search; ``command``: words before and after those
        that set the parameters, or None, and ``why`` there is none; ``file``: the scenario in pieces, between which the
        values of its ``slots`` come, or None, and ``file_why`` nobody can have it.
    """
    meta = study.meta
    why = _why_no_command(meta)
    name = meta.file_name
    scenario, file_why = _find(study, given)
    pieces = _pieces(meta, scenario, why_kept(study)) if whole and scenario is not None else None
    facts = {key: value for key, value in meta.to_json().items() if key not in ("budget", "repeatability")}
    return {
        "name": portable_name(meta.title),
        "key": hashlib.sha256(json.dumps(facts, sort_keys=True).encode()).hexdigest()[:16],
        "command": None
        if why
        else {
            # A name that begins like an option is none.
            "before": ["cornercase", "simulate", f"./{name}" if name.startswith("-") else name],
            "after": _settings(meta),
        },
        "why": why,
        "file": pieces,
        "file_why": file_why or ("" if pieces or not whole else "The scenario needs a file that was not found."),
    }


def _find(study: Study, given: Path | str | Scenario | None) -> tuple[Scenario | None, str]:
    """Find the scenario that was explored, or say why there is none."""
    try:
        found = explored_scenario(study, given)
    except InputError:
        name = study.meta.file_name
        return None, f"The scenario file {name} was not found as it was explored, so that no concrete one can be made."
    return found, "" if found is not None else "There is no scenario file: the recordings were imported."


def why_kept(study: Study) -> dict[int, str]:
    """Say why scenarios are kept.

    Parameters
    ----------
    study : Study
        Open.

    Returns
    -------
    dict of int to str
        By id; empty before the study was reduced.
    """
    reduced = read_reduction(study)
    return {} if reduced is None else {one.id: one.why for one in reduced.kept}


def write_one(meta: StudyMeta, scenario: Scenario, row: Row, why: str | None) -> bytes:
    """Give the file of a concrete scenario, as `reduce` writes it.

    Parameters
    ----------
    meta : StudyMeta
        What the study is about.
    scenario : Scenario
        The one that was explored.
    row : Row
        The concrete scenario.
    why : str or None
        Why it is kept, where it is.

    Returns
    -------
    bytes
        XML in UTF-8.
    """
    return _fill(meta, scenario, row.values, _describe(meta, str(row.id), why))


def _why_no_command(meta: StudyMeta) -> str:
    if meta.simulator == IMPORTED:
        return "Its recording was imported: what made it is not known."
    if any(tell_unnamed_drivers(meta)):
        return "A driver that Python code made drove, and the study does not hold how."
    return ""


def _settings(meta: StudyMeta) -> list[str]:
    words = [f"{option}={meta.settings[name]}" for name, option in SIMULATOR_OPTIONS.items() if name in meta.settings]
    if meta.simulator != _BUILTIN:
        words += [f"--simulator={meta.simulator}", f"--ego={meta.ego}"]
    return [*words, *(f"--driver={entity}={driver_command(driver)}" for entity, driver in meta.drivers.items())]


def _describe(meta: StudyMeta, scenario: str, why: str | None) -> str:
    said = f"Scenario {scenario} of the logical scenario {meta.title}"
    return f"{said}: {why}" if why is not None else said


def _fill(meta: StudyMeta, scenario: Scenario, values: Mapping[str, Value], description: str) -> bytes:
    presets = {entity: driver for entity, driver in meta.drivers.items() if isinstance(driver, str)}
    return fill_concrete(scenario, values, Path(meta.file_name), presets, description).content


def _pieces(meta: StudyMeta, scenario: Scenario, kept: Mapping[int, str]) -> dict[str, Any] | None:
    """Cut the file of a scenario where its values and its description stand."""
    varied = meta.space.parameters
    mark = "$cornercase"
    source = etree.tostring(scenario.root).decode()
    while mark in source:
        mark += "-"
    marks = {one.name: f"{mark}:{k}:" for k, one in enumerate(varied)}
    try:
        text = _fill(meta, scenario, marks, f"{mark}:n:").decode()
    except (InputError, UnicodeDecodeError):
        # What it needs is not here.
        return None
    first, *others = text.split(f"{mark}:")
    slots = [one.partition(":")[0] for one in others]
    pieces = [first, *(one.partition(":")[2] for one in others)]
    kinds = {one.get("name"): one.get("parameterType") for one in scenario.root.iterfind("ParameterDeclarations/*")}
    choices = {
        one.name: [_in_attribute(_typed(choice, kinds.get(one.name))) for choice in one.choices] for one in varied
    }
    return {
        "pieces": pieces,
        # The number of a parameter; None for the description.
        "slots": [None if one == "n" else int(one) for one in slots],
        "kinds": [kinds.get(one.name, "string") for one in varied],
        "whole": sorted(INTEGERS),
        "choices": [choices[one.name] for one in varied],
        # Of a scenario that is not kept, what stands before and after its id.
        "description": [_in_attribute(plain_text(one)) for one in _describe(meta, "\0", None).split("\0")],
        "kept": {
            str(one): _in_attribute(plain_text(_describe(meta, str(one), why))) for one, why in sorted(kept.items())
        },
    }


def _typed(choice: str, kind: str | None) -> str:
    return choice if choice.lstrip().startswith("$") else value_text(typed_value(choice, kind or "string"))


def _in_attribute(text: str) -> str:
    """Write a text as it stands between the quotes of an attribute."""
    element = etree.Element("a", b=text)
    return etree.tostring(element, encoding="unicode").removeprefix('<a b="').removesuffix('"/>')
