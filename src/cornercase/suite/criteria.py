"""Requirements from the criteria that scenarios ask ScenarioRunner for."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from cornercase._common.errors import InputError
from cornercase._common.ledger import warn
from cornercase.scenario import Criterion, Scope, criteria_in
from cornercase.suite.contents import SuiteContents, SuiteScenario
from cornercase.suite.requirement import Requirement, prefix_for

# Those that say of a recording what they say of a run in CARLA; others ask for lanes, signals and routes of its map.
_MEANINGS: Final[dict[str, Callable[[float | None], str | None]]] = {
    "CollisionTest": lambda _: "no collision",
    "DrivenDistanceTest": lambda least: None if least is None else f"drive {least:.15g}",
    "MaxVelocityTest": lambda most: None if most is None else f"ego.speed <= {most:.15g} m/s",
}


def required_by_files(suite: SuiteContents) -> list[Requirement]:
    """Make requirements of the criteria of a suite's files.

    Parameters
    ----------
    suite : SuiteContents

    Returns
    -------
    list of Requirement
        One that all files have is one of all; others are of the file that has them.

    Raises
    ------
    InputError
        There is none, or the bound of a criterion is no number.

    Warns
    -----
    NoticeWarning
        Criteria are not taken.
    """
    found: dict[str, list[str]] = {}
    left: dict[str, None] = {}
    for one in suite.usable:
        for criterion in _criteria(one):
            means = _MEANINGS.get(criterion.name)
            meaning = None if means is None else means(criterion.value)
            if meaning is None:
                left[criterion.name] = None
            elif one.file not in found.setdefault(meaning, []):
                found[meaning].append(one.file)
    why = "what they ask is not in a recording, or they lack a bound"
    if not found:
        others = f" (not taken: {', '.join(left)}; {why})" if left else ""
        raise InputError(
            f"`require_from_file`: {suite.folder} holds none of ScenarioRunner's criteria that can be taken as"
            f" requirements, which are {', '.join(_MEANINGS)}{others}; give requirements yourself."
        )
    if left:
        warn(f"not taken as requirements from {_sources(suite)}: {', '.join(left)}; {why}")
    texts = []
    for meaning, files in found.items():
        if len(files) == len(suite.usable):
            texts.append(meaning)
        else:
            texts += [f"{prefix_for(file)}{meaning}" for file in files]
    return [_parsed(text, suite) for text in texts]


def _sources(suite: SuiteContents) -> str:
    """Name what the criteria stand in."""
    if len(suite.usable) == 1:
        return suite.usable[0].file
    return f"the scenarios of {suite.folder.resolve().name}"


def _parsed(text: str, suite: SuiteContents) -> Requirement:
    try:
        return Requirement.parse(text)
    except InputError as error:
        why = str(error).removeprefix("`require` ")
        raise InputError(f"`require_from_file`: a criterion in {suite.folder} asks for {why}") from error


def _criteria(one: SuiteScenario) -> tuple[Criterion, ...]:
    root = one.scenario.root
    return criteria_in(root, Scope.of_file(str(one.scenario.path), root, [{}], one.scenario.catalog_entry))
