"""Make requirements from the criteria of CARLA's ScenarioRunner in scenario files."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from cornercase._common.errors import InputError
from cornercase._common.io.support_table import issue_notice_warning
from cornercase.scenario._runner_criteria import RunnerCriterion, read_runner_criteria
from cornercase.suite._requirement import Requirement, parse_requirement_from, requirement_prefix
from cornercase.suite._suite_contents import SuiteContents, SuiteScenario

# Criteria that a recording can answer; others need lanes, signals or routes of CARLA's map.
_REQUIREMENT_TEMPLATES: Final[dict[str, Callable[[float | None], str | None]]] = {
    "CollisionTest": lambda _: "no collision",
    "DrivenDistanceTest": lambda least: None if least is None else f"drive {least:.15g}",
    "MaxVelocityTest": lambda most: None if most is None else f"ego.speed <= {most:.15g} m/s",
}


def requirements_from_files(suite: SuiteContents) -> list[Requirement]:
    """Make requirements from the criteria in the files of a suite, and warn about those that no recording decides."""
    files_of: dict[str, list[str]] = {}
    ignored: dict[str, None] = {}
    for scenario in suite.runnable_scenarios:
        for criterion in _read_criteria(scenario):
            template = _REQUIREMENT_TEMPLATES.get(criterion.name)
            meaning = None if template is None else template(criterion.threshold)
            if meaning is None:
                ignored[criterion.name] = None
            elif scenario.file_name not in files_of.setdefault(meaning, []):
                files_of[meaning].append(scenario.file_name)
    reason = "a recording cannot answer them, or they lack a bound"
    if not files_of:
        note = f" (not used: {', '.join(ignored)}; {reason})" if ignored else ""
        raise InputError(
            f"`require_from_file`: {suite.folder} has none of ScenarioRunner's criteria that can be used as"
            f" requirements, which are {', '.join(_REQUIREMENT_TEMPLATES)}{note}; give requirements with `require`."
        )
    if ignored:
        issue_notice_warning(
            f"not used as requirements from {_describe_sources(suite)}: {', '.join(ignored)}; {reason}"
        )
    texts = []
    for meaning, files in files_of.items():
        if len(files) == len(suite.runnable_scenarios):
            texts.append(meaning)
        else:
            texts += [f"{requirement_prefix(file)}{meaning}" for file in files]
    source = f"`require_from_file`: a criterion in {suite.folder} requires "
    return [parse_requirement_from(source, text) for text in texts]


def _describe_sources(suite: SuiteContents) -> str:
    """Return the name of the file or folder that the criteria come from."""
    if len(suite.runnable_scenarios) == 1:
        return suite.runnable_scenarios[0].file_name
    return f"the scenarios of {suite.folder.resolve().name}"


def _read_criteria(scenario: SuiteScenario) -> tuple[RunnerCriterion, ...]:
    return read_runner_criteria(scenario.scenario.root, scenario.scenario.scope([{}]))
