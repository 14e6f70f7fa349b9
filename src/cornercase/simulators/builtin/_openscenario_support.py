"""Support table of the builtin simulator for OpenSCENARIO files."""

from __future__ import annotations

from typing import Final

from cornercase._common.io.support_table import SupportTable, tag_without_namespace
from cornercase.simulators.builtin._prepared_file import PreparedScenario

OPENSCENARIO_SUPPORT: Final = SupportTable.from_csv("cornercase.simulators.builtin", "openscenario.csv")
"""Elements and attributes of OpenSCENARIO XML 1.3, and those of earlier versions that are still read."""


def check_elements_supported(prepared: PreparedScenario) -> None:
    """Raise `InputError` for the first unsupported element or attribute in the files that were read so far.

    Elements that were checked in an earlier call are skipped.
    """
    for file, element in prepared.scenario.used_elements():
        # The file holds its elements, so their ids stay valid.
        if id(element) not in prepared.checked_elements and tag_without_namespace(element) != "OpenDRIVE":
            OPENSCENARIO_SUPPORT.check_supported(element, file)
            prepared.checked_elements.add(id(element))
