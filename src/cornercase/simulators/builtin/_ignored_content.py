"""Notices about the parts of a scenario that have no effect in the builtin simulator, or are not read as written."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace

from cornercase._common.errors import InputError
from cornercase._common.io.support_table import (
    UNKNOWN_REASON,
    Notice,
    list_adaptation_notices,
    merge_notices,
    sort_notices,
    tag_without_namespace,
)
from cornercase.roads._unsupported import list_unsupported
from cornercase.scenario import Value
from cornercase.scenario._batch_split import BatchSplitError
from cornercase.scenario._file import ScenarioFile
from cornercase.scenario._openpass import profile_controller_notices, profiles_file_notice
from cornercase.scenario._other_formats import NEWEST_MINOR_VERSION, later_minor_version
from cornercase.simulators.builtin._batch import Batch
from cornercase.simulators.builtin._prepared_file import OPENSCENARIO_SUPPORT, PreparedScenario


def read_and_collect_notices(scenario: ScenarioFile, values: Mapping[str, Value] | None = None) -> tuple[Notice, ...]:
    """Read a scenario as for a run, and return its notices.

    If the scenario cannot be run, there are no notices on parts that were not read.
    """
    try:
        Batch(PreparedScenario.from_scenario(scenario), [dict(values or {})], [0], 0.05, 1.0, False, {})
    except (InputError, BatchSplitError):
        return collect_notices(scenario, is_complete=False)
    return collect_notices(scenario)


def collect_notices(scenario: ScenarioFile, is_complete: bool = True) -> tuple[Notice, ...]:
    """Return notices about the files of a scenario after reading; `is_complete` says if all content was read."""
    notices: list[Notice] = [
        *scenario.left_handed_axes_notices(),
        *profile_controller_notices(scenario.root, scenario.path),
    ]
    scenario.catalog_files()  # Reads catalogs only if the scenario refers to them.
    networks = PreparedScenario.from_scenario(scenario).networks
    for file, element in scenario.used_elements():
        notices += list_adaptation_notices(element, file)
        if tag_without_namespace(element) == "Profiles":
            notices.append(profiles_file_notice(element, file))
        elif tag_without_namespace(element) == "OpenDRIVE":
            notices += list_unsupported(element, file, networks.get(file), is_complete)
        else:
            notices += _explain_by_version(
                later_minor_version(element), OPENSCENARIO_SUPPORT.list_unsupported_notices(element, file, is_complete)
            )
    return sort_notices(merge_notices(notices))


def _explain_by_version(minor_version: int | None, notices: Iterable[Notice]) -> Iterator[Notice]:
    for notice in notices:
        if minor_version is None:
            yield notice
        elif notice.reason == UNKNOWN_REASON:
            yield replace(
                notice,
                reason=f"{UNKNOWN_REASON}; OpenSCENARIO XML 1.{minor_version} may have it,"
                f" 1.{NEWEST_MINOR_VERSION} has not",
            )
        elif notice.parts != ("revMinor of <FileHeader>",):
            yield notice
