"""Support table of the builtin simulator for OpenSCENARIO files."""

from __future__ import annotations

from typing import Final

from cornercase._common.ledger import Ledger, local_name
from cornercase.simulators.builtin.prepared import PreparedScenario

LEDGER: Final = Ledger.read("cornercase.simulators.builtin", "openscenario.csv")
"""Elements and attributes of OpenSCENARIO XML 1.3, and those of earlier versions that are still read."""


def refuse_unusable(prepared: PreparedScenario) -> None:
    """Raise `InputError` for the first unsupported element or attribute in the files that were read so far.

    Elements that were checked before are skipped.
    """
    for file, element in prepared.scenario.read_parts():
        # The file holds its elements, so their ids stay valid.
        if id(element) not in prepared.looked_at and local_name(element) != "OpenDRIVE":
            LEDGER.refuse(element, file)
            prepared.looked_at.add(id(element))
