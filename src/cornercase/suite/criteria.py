"""Requirements from the criteria for ScenarioRunner in scenario files."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from cornercase._common.errors import InputError
from cornercase._common.ledger import warn
from cornercase.scenario import Criterion, Scope, criteria_in
from cornercase.suite.contents import SuiteContents, SuiteScenario
from cornercase.suite.requirement import Requirement, prefix_for

# Criteria that a recording can answer; others need lanes, signals or routes of CARLA's map.
_MEANINGS: Final[dict[str, Callable[[float | None], str | None]]] = {
    "CollisionTest": lambda _: "no collision",
    "DrivenDistanceTest": lambda least: None if least is None else f"drive {least:.15g}",
    "MaxVelocityTest": lambda most: None if most is None else f"ego.speed <= {most:.15g} m/s",
}


def required_by_files(suite: SuiteContents) -> list[Requirement]:
    """Make requirements from the criteria in a suite's files; one that not all files have applies to those files.

    Raises `InputError` if there is none; warns about criteria that a recording cannot answer.
    """
    files_of: dict[str, list[str]] = {}
    ignored: dict[str, None] = {}
    for scenario in suite.usable:
        for criterion in _criteria(scenario):
            template = _MEANINGS.get(criterion.name)
            meaning = None if template is None else template(criterion.value)
            if meaning is None:
                ignored[criterion.name] = None
            elif scenario.file not in files_of.setdefault(meaning, []):
                files_of[meaning].append(scenario.file)
    reason = "a recording cannot answer them, or they lack a bound"
    if not files_of:
        note = f" (not used: {', '.join(ignored)}; {reason})" if ignored else ""
        raise InputError(
            f"`require_from_file`: {suite.folder} has none of ScenarioRunner's criteria that can be used as"
            f" requirements, which are {', '.join(_MEANINGS)}{note}; specify requirements yourself."
        )
    if ignored:
        warn(f"not used as requirements from {_sources(suite)}: {', '.join(ignored)}; {reason}")
    texts = []
    for meaning, files in files_of.items():
        if len(files) == len(suite.usable):
            texts.append(meaning)
        else:
            texts += [f"{prefix_for(file)}{meaning}" for file in files]
    return [_parsed(text, suite) for text in texts]


def _sources(suite: SuiteContents) -> str:
    """Name the file or folder of the criteria."""
    if len(suite.usable) == 1:
        return suite.usable[0].file
    return f"the scenarios of {suite.folder.resolve().name}"


def _parsed(text: str, suite: SuiteContents) -> Requirement:
    try:
        return Requirement.parse(text)
    except InputError as error:
        reason = str(error).removeprefix("`require` ")
        raise InputError(f"`require_from_file`: a criterion in {suite.folder} requires {reason}") from error


def _criteria(one: SuiteScenario) -> tuple[Criterion, ...]:
    root = one.scenario.root
    return criteria_in(root, Scope.of_file(str(one.scenario.path), root, [{}], one.scenario.catalog_entry))
