"""Search for sensors that draw random numbers, so that two runs of a scenario with different seeds differ."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from cornercase._common.io.support_table import issue_notice_warning
from cornercase._common.plugin_errors import is_built_in
from cornercase.drivers import SENSORS
from cornercase.drivers._registry import SEPARATOR, split_spec
from cornercase.scenario._file import ScenarioFile
from cornercase.simulators._base import Simulator


def find_entities_with_random_sensors(
    simulator: Simulator, scenarios: Iterable[ScenarioFile], varied: Iterable[str] = ()
) -> tuple[str, ...]:
    """Return the entities with random sensors.

    `varied` has the parameters that a search varies. Such a parameter, for example ``"Ego.noise"``, can make a sensor
    random.
    """
    given = simulator.settings.get("drivers")
    drivers: dict[str, set[object]] = {}
    for scenario in scenarios:
        for entity, name in scenario.drivers.items():
            drivers.setdefault(entity, set()).add(name)
    for entity, description in given.items() if isinstance(given, Mapping) else ():
        drivers[entity] = {_equipment_text(description)}
    dimensions = {name for name in varied if "." in name}
    return tuple(
        entity
        for entity, descriptions in drivers.items()
        if any(_is_random(sensor, entity, dimensions) for text in descriptions for sensor in split_spec(str(text))[1])
    )


def warn_if_runs_are_random(entities: Iterable[str], advice: str) -> None:
    """Warn if entities have random sensors, so that a single run of a scenario says little."""
    if names := ", ".join(entities):
        issue_notice_warning(f"sensors of {names} are random, and each score is that of a single run; {advice}")


def _equipment_text(description: object) -> str:
    """Return a serialized driver as a text such as ``driver + radar``: its sensors and vehicle model are named.

    The word ``driver`` stands for the driver itself. A driver that is serialized as a text is returned as it is.
    """
    if isinstance(description, Mapping) and isinstance(equipment := description.get("equipment"), list | tuple):
        return SEPARATOR.join(["driver", *map(str, equipment)])
    return description if isinstance(description, str) else ""


def _is_random(text: str, entity: str, dimensions: Iterable[str]) -> bool:
    name = text.partition(":")[0]
    if name not in SENSORS:
        return False
    cls = SENSORS.get_class(name)
    # Options of other packages' classes, which a file may name, could do anything.
    sensor = SENSORS.create(text) if is_built_in(cls) else cls
    varied = {dimension.rpartition(".")[2] for dimension in dimensions if dimension.startswith(f"{entity}.")}
    return bool(sensor.is_random) or not varied.isdisjoint(cls.random_options)
