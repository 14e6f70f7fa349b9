"""Parts of a scenario without effect in the builtin simulator, or not read as they stand there."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace

from cornercase._common.errors import InputError
from cornercase._common.ledger import UNKNOWN, Notice, adapted, local_name, merged, ranked
from cornercase.roads import name_without_effect
from cornercase.scenario import (
    NEWEST,
    Scenario,
    Value,
    VariesError,
    later_version,
    profile_notices,
    profiles_notice,
)
from cornercase.simulators.builtin.batch import Batch
from cornercase.simulators.builtin.openscenario import LEDGER
from cornercase.simulators.builtin.prepared import PreparedScenario


def notices(scenario: Scenario, values: Mapping[str, Value] | None = None) -> tuple[Notice, ...]:
    """Read a scenario as for a run, and name what of its files changes nothing.

    Parameters
    ----------
    scenario : Scenario
    values : mapping of str to float or str, optional
        Of its parameters, on which may depend what is read.

    Returns
    -------
    tuple of Notice
        Where the scenario cannot be run, without what nobody read.
    """
    try:
        Batch(PreparedScenario.of(scenario), [dict(values or {})], 0.05, 1.0, False, {})
    except (InputError, VariesError):
        return notices_after_reading(scenario, read=False)
    return notices_after_reading(scenario)


def notices_after_reading(scenario: Scenario, read: bool = True) -> tuple[Notice, ...]:
    """Name what of the files of a scenario changed nothing, once it was read.

    Parameters
    ----------
    scenario : Scenario
    read : bool, default True
        Whether it was read to its end.

    Returns
    -------
    tuple of Notice
    """
    found: list[Notice] = [*scenario.axes_notices(), *profile_notices(scenario.root, scenario.path)]
    scenario.catalog_files()  # They are looked for only where the scenario refers to one of them.
    networks = PreparedScenario.of(scenario).networks
    for file, element in scenario.read_parts():
        found += adapted(element, file)
        if local_name(element) == "Profiles":
            found.append(profiles_notice(element, file))
        elif local_name(element) == "OpenDRIVE":
            found += name_without_effect(element, file, networks.get(file), read)
        else:
            found += _of_version(later_version(element), LEDGER.notices(element, file, read))
    return ranked(merged(found))


def _of_version(minor: int | None, notices: Iterable[Notice]) -> Iterator[Notice]:
    """Notices of a file, those of what is not known as of what a later version may have."""
    for notice in notices:
        if minor is None:
            yield notice
        elif notice.why == UNKNOWN:
            yield replace(notice, why=f"{UNKNOWN}; OpenSCENARIO XML 1.{minor} may have it, 1.{NEWEST} has not")
        elif notice.what != ("revMinor of <FileHeader>",):
            yield notice
