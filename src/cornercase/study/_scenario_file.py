"""Find the scenario file that a study explored."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

from cornercase._common.errors import InputError
from cornercase.scenario._file import ScenarioFile
from cornercase.scenario._scenario_search import find_scenario_file, read_if_fingerprint_matches
from cornercase.scenario._varied_road_files import add_varied_roads
from cornercase.study._import_recordings import IMPORTED_SIMULATOR
from cornercase.study._remembered_paths import find_remembered_path
from cornercase.study._stored_paths import resolve_stored_path
from cornercase.study._study_file import StudyFile


def find_explored_scenario(
    study: StudyFile,
    scenario: Path | str | ScenarioFile | None = None,
    *,
    search_stored_path: bool = False,
    search_remembered_path: bool = True,
) -> ScenarioFile | None:
    """Find the scenario file that a study explored; `InputError` if the file has changed or is not found.

    Return None if the recordings of the study were imported. For a suite, which has several scenario files, return the
    first. If `scenario` is given, only this file is checked. Otherwise the file is searched at the path where this
    machine explored it, then beside the study and in the current folder, up to two folders below each; the first file
    with the fingerprint of the study is returned.

    With `search_stored_path`, the path that the study stores is searched first, except for a suite. Use this option
    only if the command cannot do without the file: a study from somebody else may store any path. With
    `search_remembered_path`, the path where this machine explored the file is searched. Turn this option off if the
    result shows the path, because the path may reveal folders.
    """
    meta = study.meta
    if meta.simulator == IMPORTED_SIMULATOR:
        return None
    if scenario is not None:
        given = scenario if isinstance(scenario, ScenarioFile) else ScenarioFile.read(scenario)
        return _require_explored(study, add_varied_roads(given, meta.space))
    # The study may come from anywhere: without the option, its stored path is not opened.
    is_stored_path_searched = search_stored_path and not meta.suite
    stored = resolve_stored_path(meta.scenario, study.path) if is_stored_path_searched else None
    remembered = find_remembered_path(meta.fingerprint) if search_remembered_path else None
    changed = []
    for path in (stored, remembered):
        if path is not None:
            if (explored := read_if_fingerprint_matches(path, meta.fingerprint, meta.space)) is not None:
                return explored
            with suppress(OSError):
                changed += [path] if path.is_file() else []
    explored, others = find_scenario_file(meta.file_name, meta.fingerprint, (study.path.parent, Path()), meta.space)
    if explored is not None:
        return explored
    changed += others
    if not changed:
        at = f", or at {meta.scenario}" if is_stored_path_searched and "/" in meta.scenario else ""
        raise InputError(
            f"{study.path}: the scenario file '{meta.file_name}' was not found beside the study, in the current"
            " folder, up to"
            f" two folders below them{at}; name it with `scenario`."
        )
    files = list(dict.fromkeys(str(path.resolve()) for path in changed))
    try:
        first = add_varied_roads(ScenarioFile.read(changed[0]), meta.space)
    except (InputError, OSError) as error:
        raise InputError(f"{str(error).rstrip('.')}; use `scenario` to name the file that was explored.") from error
    return _require_explored(study, first, len(files) - 1)


def _require_explored(study: StudyFile, scenario: ScenarioFile, n_others: int = 0) -> ScenarioFile:
    """Return the scenario if the study explored it; `InputError` otherwise.

    `n_others` is the number of further files with the same name that do not fit the study either; the message gives
    this number.
    """
    if scenario.fingerprint() == study.meta.fingerprint:
        return scenario
    missing = scenario.describe_missing_road()
    if missing:
        raise InputError(f"{scenario.path}: differs from the scenario that {study.path} was explored with: {missing}.")
    others = f" (further files of this name that differ: {n_others})" if n_others else ""
    raise InputError(
        f"{scenario.path}: the file, its road or its catalogs have changed since {study.path} was explored{others};"
        " restore them, use `scenario` to name the file that was explored, or run `explore` again, into another study."
    )
