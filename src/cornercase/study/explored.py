"""The scenario file that was explored into a study."""

from __future__ import annotations

from pathlib import Path

from cornercase._common.errors import InputError
from cornercase.scenario import Scenario, find_scenario, scenario_of, with_roads
from cornercase.study.importing import IMPORTED
from cornercase.study.store import Study
from cornercase.study.stored_paths import file_named


def explored_scenario(
    study: Study, given: Path | str | Scenario | None = None, *, where_named: bool = False
) -> Scenario | None:
    """Find the scenario file that was explored, and refuse another one.

    Parameters
    ----------
    study : Study
    given : path or Scenario, optional
        By default it is looked for beside the study and in the current folder, and known by its fingerprint.
    where_named : bool, default False
        Whether it is looked for at the path that the study holds, too, as `file_named` understands it: where somebody
        asks for what needs the file, and not where a study is only looked at.

    Returns
    -------
    Scenario or None
        None of a study of imported recordings; of a suite its first file.

    Raises
    ------
    InputError
        It is not found, or not the one that was explored.
    """
    meta = study.meta
    if meta.simulator == IMPORTED:
        return None
    # The study may come from anywhere: its path of the scenario is a word where it is only looked at.
    named = file_named(meta.scenario, study.path) if where_named and given is None and not meta.suite else None
    found = given
    if named is not None:
        found = scenario_of(named, meta.fingerprint, meta.space)
    if found is None:
        found = find_scenario(meta.file_name, meta.fingerprint, (study.path.parent, Path()), meta.space) or named
    if found is None:
        nor = f" nor at {meta.scenario}" if where_named and "/" in meta.scenario else ""
        raise InputError(
            f"{study.path}: its scenario file '{meta.file_name}' lies neither beside it nor in the current folder,"
            f" nor up to two folders below{nor}; name it with `scenario`."
        )
    scenario = with_roads(found if isinstance(found, Scenario) else Scenario.read(found), meta.space)
    if scenario.fingerprint() != meta.fingerprint:
        missing = scenario.missing_road()
        if missing:
            raise InputError(f"{scenario.path}: is not as {study.path} was explored with it: {missing}.")
        raise InputError(
            f"{scenario.path}: it, its road or its catalogs have changed since {study.path} was explored; restore"
            " them, name the file that was explored with `scenario`, or run `explore` again, into another study."
        )
    return scenario
