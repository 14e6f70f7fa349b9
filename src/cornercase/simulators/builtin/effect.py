"""Notices about parts of a scenario that have no effect in the builtin simulator, or are not read as written."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace

from cornercase._common.errors import InputError
from cornercase._common.ledger import UNKNOWN, Notice, adapted, local_name, merged, ranked
from cornercase.roads import name_without_effect
from cornercase.scenario import NEWEST, Scenario, Value, VariesError, later_version, profile_notices, profiles_notice
from cornercase.simulators.builtin.batch import Batch
from cornercase.simulators.builtin.openscenario import LEDGER
from cornercase.simulators.builtin.prepared import PreparedScenario


def notices(scenario: Scenario, values: Mapping[str, Value] | None = None) -> tuple[Notice, ...]:
    """Read a scenario as for a run, and return its notices; parts that depend on parameters are read with `values`.

    If the scenario cannot be run, parts that were not read are not reported.
    """
    try:
        Batch(PreparedScenario.of(scenario), [dict(values or {})], 0.05, 1.0, False, {})
    except (InputError, VariesError):
        return notices_after_reading(scenario, read=False)
    return notices_after_reading(scenario)


def notices_after_reading(scenario: Scenario, read: bool = True) -> tuple[Notice, ...]:
    """Notices about a scenario's files, once it was read (`is_complete`: to its end)."""
    notices: list[Notice] = [*scenario.axes_notices(), *profile_notices(scenario.root, scenario.path)]
    scenario.catalog_files()  # Reads catalogs only if the scenario refers to them.
    networks = PreparedScenario.of(scenario).networks
    for file, element in scenario.read_parts():
        notices += adapted(element, file)
        if local_name(element) == "Profiles":
            notices.append(profiles_notice(element, file))
        elif local_name(element) == "OpenDRIVE":
            notices += name_without_effect(element, file, networks.get(file), read)
        else:
            notices += _of_version(later_version(element), LEDGER.notices(element, file, read))
    return ranked(merged(notices))


def _of_version(minor: int | None, notices: Iterable[Notice]) -> Iterator[Notice]:
    for notice in notices:
        if minor is None:
            yield notice
        elif notice.why == UNKNOWN:
            yield replace(notice, why=f"{UNKNOWN}; OpenSCENARIO XML 1.{minor} may have it, 1.{NEWEST} has not")
        elif notice.what != ("revMinor of <FileHeader>",):
            yield notice
