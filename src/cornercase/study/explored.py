"""The scenario file that was explored into a study."""

from __future__ import annotations

from pathlib import Path

from cornercase._common.errors import InputError
from cornercase.scenario import Scenario, find_scenario, with_roads
from cornercase.study.importing import IMPORTED
from cornercase.study.store import Study


def explored_scenario(study: Study, given: Path | str | Scenario | None = None) -> Scenario | None:
    """Find the scenario file that was explored, and refuse another one.

    Parameters
    ----------
    study : Study
    given : path or Scenario, optional
        By default it is looked for beside the study and in the current folder, and known by its fingerprint; the path
        that the study holds is never opened.

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
    # The study may come from anywhere: its path of the scenario is a word, and no path here.
    found = given
    if found is None:
        found = find_scenario(meta.file_name, meta.fingerprint, (study.path.parent, Path()), meta.space)
    if found is None:
        raise InputError(
            f"{study.path}: its scenario file '{meta.file_name}' lies neither beside it nor in the current folder; name"
            " it with `scenario`."
        )
    scenario = with_roads(found if isinstance(found, Scenario) else Scenario.read(found), meta.space)
    if scenario.fingerprint() != meta.fingerprint:
        raise InputError(
            f"{scenario.path}: it, its road or its catalogs have changed since {study.path} was explored; restore"
            " them, name the file that was explored with `scenario`, or run `explore` again, into another study."
        )
    return scenario
