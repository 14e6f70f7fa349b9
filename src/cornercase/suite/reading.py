"""A suite from a folder or a manifest."""

from __future__ import annotations

import warnings
from collections.abc import Container, Mapping, Sequence
from pathlib import Path
from typing import Final

from cornercase._common.arguments import path as path_argument
from cornercase._common.errors import InputError, NoticeWarning
from cornercase._common.texts import plain_text
from cornercase.reduction import MANIFEST
from cornercase.scenario import (
    Declaration,
    Parameter,
    ParameterSpace,
    Scenario,
    Value,
    read_declarations,
    typed_value,
)
from cornercase.simulators import failure_words
from cornercase.suite.contents import SuiteContents, SuiteScenario
from cornercase.suite.manifest import read_manifest

_FILE: Final = "file"


def read_suite(place: Path | str) -> SuiteContents:
    """Read a suite.

    Parameters
    ----------
    place : path
        A manifest that `cornercase.reduce` wrote, a folder with one, or any folder of concrete scenarios, whose
        ``.xosc`` files are all run, or one such file. Distributions of parameters and catalogs in such a folder are no
        scenarios.

    Returns
    -------
    SuiteContents

    Raises
    ------
    InputError
        There is nothing to run, a file cannot be used, or one of a manifest is gone or has changed.

    Warns
    -----
    NoticeWarning
        Files in the folder are no scenarios.
    """
    path = path_argument("suite", place)
    if path.is_dir():
        manifest = path / MANIFEST
        return read_manifest(manifest) if manifest.is_file() else _of_files(path, sorted(path.glob("*.xosc")))
    if not path.exists():
        raise InputError(
            f"{path}: does not exist; name a folder of scenarios, or the manifest.json that `reduce` wrote."
        )
    return _of_files(path, [path]) if path.suffix.lower() == ".xosc" else read_manifest(path)


def _of_files(folder: Path, files: Sequence[Path]) -> SuiteContents:
    for file in files:
        # Databases and other files hold names as text in UTF-8.
        if (odd := plain_text(file.name).replace("\n", "\\n").encode(errors="replace").decode()) != file.name:
            raise InputError(f"{folder}: the name of its file '{odd}' is not plain text; rename the file.")
    read, wrong = list[Scenario](), dict[Path, InputError]()
    others = []
    for file in files:
        try:
            if _is_of_something_else(Scenario(file)):
                others.append(file.name)
                continue
            read.append(Scenario.read(file))
        except InputError as error:
            wrong[file] = error
            read.append(Scenario(file))
    if others:
        warnings.warn(f"not run, because they are not scenarios: {', '.join(others)}", NoticeWarning, stacklevel=3)
    if not read:
        raise InputError(f"{folder}: holds no scenario; name a folder with .xosc files, or with a manifest.json.")
    if len(wrong) == len(read):
        raise next(iter(wrong.values()))
    values, space = _varied(read, wrong)
    words = {path: failure_words(path, error) for path, error in wrong.items()}
    return SuiteContents(
        place=folder,
        scenarios=tuple(
            SuiteScenario(one.path.name, one, its, wrong=words.get(one.path, ""))
            for one, its in zip(read, values, strict=True)
        ),
        space=space,
    )


def _is_of_something_else(scenario: Scenario) -> bool:
    root = scenario.root
    return root.find("ParameterValueDistribution") is not None or root.find("Catalog") is not None


def _varied(scenarios: Sequence[Scenario], wrong: Container[Path]) -> tuple[list[dict[str, Value]], ParameterSpace]:
    """Parameters that all declare and that differ; where these do not tell all apart, which file it is besides."""
    declared = [
        {} if each.path in wrong else {one.name: one for one in read_declarations(each.root, str(each.path))}
        for each in scenarios
    ]
    names = [
        name
        for name, one in declared[0].items()
        if all(name in each and each[name].kind == one.kind for each in declared)
    ]
    found = {name: [_value(each[name]) for each in declared] for name in names}
    found = {name: values for name, values in found.items() if len(set(values)) > 1}
    parameters = [_parameter(name, values) for name, values in found.items()]
    if len(set(zip(*found.values(), strict=True))) < len(scenarios):
        files = [one.path.name for one in scenarios]
        name = _FILE if _FILE not in found else "scenario file"
        found[name] = list(files)
        parameters.append(Parameter(name, 0.0, len(files) - 1.0, None, tuple(files)))
    rows: list[dict[str, Value]] = [{name: values[k] for name, values in found.items()} for k in range(len(scenarios))]
    # Whole numbers and truth values are told by their declarations.
    known: Mapping[str, Declaration] = declared[0]
    return rows, ParameterSpace(parameters).typed(
        [known[name] for name in found if name in known], str(scenarios[0].path)
    )


def _value(declaration: Declaration) -> Value:
    try:
        return typed_value(declaration.value, declaration.kind)
    except ValueError:
        # An expression, for one.
        return declaration.value


def _parameter(name: str, values: Sequence[Value]) -> Parameter:
    if all(isinstance(one, int | float) for one in values):
        numbers = [float(one) for one in values]
        return Parameter(name, min(numbers), max(numbers))
    choices = tuple(sorted({str(one) for one in values}))
    return Parameter(name, 0.0, len(choices) - 1.0, None, choices)
