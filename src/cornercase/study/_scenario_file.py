"""Find the scenario file that a study explored."""

from __future__ import annotations

from pathlib import Path

from cornercase._common.errors import InputError
from cornercase.scenario._file import ScenarioFile
from cornercase.scenario._locate import find_scenario_file, read_if_fingerprint_matches
from cornercase.scenario._road_choices import add_varied_roads
from cornercase.study._import_recordings import IMPORTED_SIMULATOR
from cornercase.study._remembered_paths import find_remembered_scenario
from cornercase.study._stored_paths import resolve_stored_path
from cornercase.study._study_file import StudyFile


def find_explored_scenario(
    study: StudyFile,
    scenario: Path | str | ScenarioFile | None = None,
    *,
    search_stored_path: bool = False,
    search_remembered_path: bool = True,
) -> ScenarioFile | None:
    """Find the scenario file that a study explored; `InputError` for any other file.

    Without `scenario`, the file is searched beside the study, in the current folder, and where this machine has
    explored it, and recognized by its fingerprint. `search_stored_path` also searches at the path stored in the study.
    Use it only if the command needs the file, since a study may come from anyone. The path that this machine remembers
    may reveal folders; do not search there if the result shows the path. The result is None for imported
    recordings, and the first file of a suite.
    """
    meta = study.meta
    if meta.simulator == IMPORTED_SIMULATOR:
        return None
    # The study may come from anywhere: without the option, its stored path is not opened.
    stored_file = (
        resolve_stored_path(meta.scenario, study.path)
        if search_stored_path and scenario is None and not meta.suite
        else None
    )
    file = scenario
    if stored_file is not None:
        file = read_if_fingerprint_matches(stored_file, meta.fingerprint, meta.space)
    if file is None:
        file = find_scenario_file(meta.file_name, meta.fingerprint, (study.path.parent, Path()), meta.space)
        # A file of that name that has changed is refused below, also where the remembered one has not.
        remembered = find_remembered_scenario(meta.fingerprint) if search_remembered_path else None
        if file is None and remembered is not None:
            file = read_if_fingerprint_matches(remembered, meta.fingerprint, meta.space)
        file = file or stored_file
    if file is None:
        stored = f", or at {meta.scenario}" if search_stored_path and "/" in meta.scenario else ""
        raise InputError(
            f"{study.path}: the scenario file '{meta.file_name}' was not found beside the study, in the current"
            " folder, up to"
            f" two folders below{stored}; name it with `scenario`."
        )
    result = add_varied_roads(file if isinstance(file, ScenarioFile) else ScenarioFile.read(file), meta.space)
    if result.fingerprint() != meta.fingerprint:
        missing = result.describe_missing_road()
        if missing:
            raise InputError(
                f"{result.path}: differs from the scenario that {study.path} was explored with: {missing}."
            )
        raise InputError(
            f"{result.path}: the file, its road or its catalogs have changed since {study.path} was explored; restore"
            " them, name the file that was explored with `scenario`, or run `explore` again, into another study."
        )
    return result
