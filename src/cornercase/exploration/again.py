"""The exploration that a study is of, to run scenarios of it again."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from cornercase._common.arguments import by_name
from cornercase._common.errors import InputError
from cornercase.drivers import Driver, driver_changes, driver_command, driver_of_file, driver_text
from cornercase.exploration.configuration import Configuration
from cornercase.metrics import condition_of
from cornercase.scenario import LogicalScenario, Scenario
from cornercase.simulators import Simulator
from cornercase.study import Study, StudyMeta, explored_scenario


def configuration_of(
    study: Study,
    file: Path,
    scenario: Path | str | Scenario | None,
    simulator: str | None,
    drivers: Mapping[str, str | Driver],
) -> Configuration:
    """Make the configuration that a study was explored with.

    Parameters
    ----------
    study : Study
    file : Path
        The study, for messages.
    scenario : path or Scenario or None
        File that was explored; None to look for it.
    simulator : str or None
        None for that of the study, without options.
    drivers : mapping of str to str or Driver
        Drivers of one's own, by entity.

    Returns
    -------
    Configuration

    Raises
    ------
    InputError
        The scenario file is not found, or a driver is not here.
    """
    meta, settings = study.meta, study.meta.settings
    source = explored_scenario(study, scenario, where_named=True)
    if source is None:
        raise InputError(f"{file}: holds imported recordings, so no further scenario can be run.")
    known: dict[str, str | Driver] = dict(by_name("drivers", drivers))
    for entity, driver in settings.get("drivers", {}).items():
        # What a study names is no reason to import a module.
        if isinstance(driver, str) and _is_for_file(driver):
            known.setdefault(entity, driver)
        elif entity not in known:
            command = driver_command(driver)
            again = "give it again" if command is None else f"give it again with `drivers` {entity}={command}"
            raise InputError(
                f"{file}: {driver_text(driver)} drove {entity}, and a study is no reason to run code; {again}."
            )
    given: dict[str, Any] = {
        name: settings[name] for name in ("time_step", "duration", "on_collision") if name in settings
    }
    condition = condition_of(meta.metrics)
    return Configuration(
        logical=LogicalScenario(source.path, meta.space, meta.fingerprint, source),
        ego=meta.ego,
        other=meta.other,
        metrics=tuple(name for name in meta.metrics if not condition_of([name])),
        optimizer=meta.optimizer,
        critical=None if condition else meta.critical,
        critical_if=condition or None,
        weights=meta.weights,
        pareto=meta.pareto,
        budget=meta.budget,
        batch=meta.batch,
        asynchronous=meta.asynchronous,
        seed=meta.seed,
        repeats=meta.repeats,
        most_repeats=meta.most_repeats,
        audit=meta.audit,
        simulator=meta.simulator.partition(":")[0] if simulator is None else simulator,
        drivers=known,
        **given,
    )


def _is_for_file(driver: str) -> bool:
    """Whether a driver may be made because a file names it."""
    try:
        driver_of_file(driver)
    except InputError:
        return False
    return True


def require_same_runs(study: Path, meta: StudyMeta, simulator: Simulator) -> None:
    """Refuse a simulator that would not run scenarios as those of the study were run.

    Parameters
    ----------
    study : Path
        For messages.
    meta : StudyMeta
    simulator : Simulator

    Raises
    ------
    InputError
        Its settings are others.
    """
    mine: dict[str, Any] = dict(simulator.settings)
    other = [name for name in sorted({*mine, *meta.settings}) if mine.get(name) != meta.settings.get(name)]
    if other:
        changes = driver_changes(meta.settings.get("drivers"), mine.get("drivers"))
        drivers = "".join(f"; {there} drove {entity}, not {here}" for entity, there, here, _ in changes)
        raise InputError(
            f"{study}: was explored with another {', '.join(other)}{drivers}; give `simulator` and `drivers` as for"
            " `explore`."
        )
