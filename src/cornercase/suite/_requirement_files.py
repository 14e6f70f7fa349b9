"""Read requirements from a TOML or YAML file, and from the criteria of ScenarioRunner in scenario files."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

from cornercase._common.errors import InputError, suggest_name
from cornercase._common.io.files import parse_toml, read_utf8
from cornercase._common.io.support_table import issue_notice_warning
from cornercase.scenario._scenario_runner_criteria import read_scenario_runner_criteria
from cornercase.suite._requirement import Requirement, parse_requirement_from, requirement_prefix
from cornercase.suite._suite_contents import SuiteContents

_LIST_KEY: Final = "require"
# Tables of further lists, and the names their patterns are for.
_PATTERN_TABLES: Final = {"for": "file names", "kind": "names of kinds"}
_MAX_FILE_BYTES: Final = 1_000_000
# Criteria that a recording can answer; others need lanes, signals or routes of CARLA's map.
_REQUIREMENT_TEMPLATES: Final[dict[str, Callable[[float | None], str | None]]] = {
    "CollisionTest": lambda _: "no collision",
    "DrivenDistanceTest": lambda least: None if least is None else f"drive {least:.15g}",
    "MaxVelocityTest": lambda most: None if most is None else f"ego.speed <= {most:.15g} m/s",
}


def read_requirements(path: Path) -> list[Requirement]:
    """Read requirements from a TOML file, or from a YAML file if the name ends in ``.yaml`` or ``.yml``.

    The list ``require`` applies to all files. The tables ``for`` and ``kind`` hold further lists; their keys are
    patterns of file names (``for``) or cluster names (``kind``). Raises `InputError` if the file cannot be used.
    """
    content = _load_file(path)
    if not isinstance(content, dict):
        raise InputError(f"{path}: holds no list called '{_LIST_KEY}'; write {_LIST_KEY} = [\"no collision\"].")
    for name in content:
        if name not in (_LIST_KEY, *_PATTERN_TABLES):
            advice = suggest_name(str(name), (_LIST_KEY, *_PATTERN_TABLES))
            raise InputError(f"{path}: has '{str(name)[:60]}', which is unknown; {advice}")
    lines = _require_text_list(path, _LIST_KEY, content.get(_LIST_KEY, []))
    for name, subject in _PATTERN_TABLES.items():
        patterns = content.get(name, {})
        if not isinstance(patterns, dict):
            raise InputError(
                f"{path}: '{name}' is not a table with a list of requirements for each pattern of {subject}."
            )
        for pattern, requirements in patterns.items():
            if not isinstance(pattern, str) or not pattern.strip():
                raise InputError(f"{path}: '{str(pattern)[:60]}' in '{name}' is not a pattern of {subject}.")
            prefix = requirement_prefix(pattern, is_for_clusters=name == "kind")
            lines += [f"{prefix}{line}" for line in _require_text_list(path, pattern, requirements)]
    if not lines:
        raise InputError(f'{path}: holds no requirement; write {_LIST_KEY} = ["no collision"].')
    return [parse_requirement_from(f"{path}: ", line) for line in lines]


def _require_text_list(path: Path, name: str, value: object) -> list[str]:
    if not isinstance(value, list) or not all(isinstance(item, str) and item.strip() for item in value):
        raise InputError(f"{path}: '{name[:60]}' is not a list of texts, such as [\"no collision\"].")
    return value


def _load_file(path: Path) -> Any:
    text = read_utf8(path, _MAX_FILE_BYTES)
    if path.suffix.lower() not in (".yaml", ".yml"):
        return parse_toml(path, text)
    try:
        import yaml
    except ImportError as error:
        raise InputError(
            f"{path}: YAML needs PyYAML; install it with pip install pyyaml, or write the file as TOML."
        ) from error
    try:
        return yaml.safe_load(text)
    except (yaml.YAMLError, RecursionError, ValueError) as error:
        raise InputError(f"{path}: is not valid YAML ({' '.join(str(error).split())[:200]}).") from error


def requirements_from_runner_criteria(suite: SuiteContents) -> list[Requirement]:
    """Make requirements from ScenarioRunner's criteria in the files of a suite; a notice names unusable criteria."""
    files_of: dict[str, list[str]] = {}
    ignored: dict[str, None] = {}
    for scenario in suite.runnable_scenarios:
        for criterion in read_scenario_runner_criteria(scenario.scenario.root, scenario.scenario.scope([{}])):
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
            f" requirements; usable are {', '.join(_REQUIREMENT_TEMPLATES)}{note}; give requirements with `require`."
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
