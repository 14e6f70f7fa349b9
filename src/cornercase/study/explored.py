"""Find the scenario file that a study explored."""

from __future__ import annotations

from pathlib import Path

from cornercase._common.errors import InputError
from cornercase.scenario import Scenario, find_scenario, scenario_of, with_roads
from cornercase.study._study import Study
from cornercase.study.importing import IMPORTED
from cornercase.study.stored_paths import file_named


def explored_scenario(
    study: Study, given: Path | str | Scenario | None = None, *, where_named: bool = False
) -> Scenario | None:
    """Find the scenario file that was explored, and refuse any other one.

    By default it is looked for beside the study and in the current folder, and recognized by its fingerprint.
    `search_stored_path` also looks at the path stored in the study; only use it if the command needs the file, since a
    study may come from anywhere. Returns None for imported recordings, and the first file for a suite.
    """
    meta = study.meta
    if meta.simulator == IMPORTED:
        return None
    # The study may come from anywhere: without the option, its stored path is not opened.
    stored_file = file_named(meta.scenario, study.path) if where_named and given is None and not meta.suite else None
    file = given
    if stored_file is not None:
        file = scenario_of(stored_file, meta.fingerprint, meta.space)
    if file is None:
        file = find_scenario(meta.file_name, meta.fingerprint, (study.path.parent, Path()), meta.space) or stored_file
    if file is None:
        stored = f", or at {meta.scenario}" if where_named and "/" in meta.scenario else ""
        raise InputError(
            f"{study.path}: its scenario file '{meta.file_name}' was not found beside it, in the current folder, up to"
            f" two folders below{stored}; name it with `scenario`."
        )
    result = with_roads(file if isinstance(file, Scenario) else Scenario.read(file), meta.space)
    if result.fingerprint() != meta.fingerprint:
        missing = result.missing_road()
        if missing:
            raise InputError(f"{result.path}: differs from what {study.path} was explored with: {missing}.")
        raise InputError(
            f"{result.path}: it, its road or its catalogs have changed since {study.path} was explored; restore"
            " them, name the file that was explored with `scenario`, or run `explore` again, into another study."
        )
    return result
