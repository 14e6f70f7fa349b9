"""Description of what a simulator ignores or changes in a scenario, as far as it is known without a run."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from cornercase.drivers._resolve import DriverLike, check_drivers, resolve_driver
from cornercase.scenario._file import ScenarioFile
from cornercase.simulators._common_options import select_declared_options
from cornercase.simulators._registry import SIMULATORS
from cornercase.simulators._results import check_simulator_accepts, list_ignored_content


def describe_ignored_or_replaced(
    simulator: str, scenario: Path | str, *, drivers: Mapping[str, DriverLike] | None = None, ego: str = "Ego"
) -> list[str]:
    """Return sentences on what a simulator ignores or replaces in a scenario, and on what its driver models override.

    The sentences have no full stop. Raises `InputError` if the simulator refuses the scenario. Nothing is started.
    """
    file, declared = ScenarioFile.read(scenario), SIMULATORS.get_class(simulator)
    given = {entity: resolve_driver(driver) for entity, driver in check_drivers(drivers).items()}
    options = select_declared_options(simulator, declared, {"drivers": given})
    created = SIMULATORS.create(simulator, **options, **({"ego": ego} if "ego" in declared.requires else {}))
    sentences = list[str]()
    created.on_notice = sentences.append
    check_simulator_accepts(created, [file])
    return [*sentences, *(notice.sentence for notice in list_ignored_content(created, file))]
