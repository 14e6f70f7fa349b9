"""What the builtin simulator does with each part of an OpenSCENARIO file."""

from __future__ import annotations

from typing import Final

from cornercase._common.ledger import Ledger, local_name
from cornercase.simulators.builtin.prepared import PreparedScenario

LEDGER: Final = Ledger.read("cornercase.simulators.builtin", "openscenario.csv")
"""Elements and attributes of OpenSCENARIO XML 1.3, and those of earlier versions that are read still."""


def refuse_unusable(prepared: PreparedScenario) -> None:
    """Refuse what the builtin simulator cannot run, in the scenario file and the catalog entries that were read.

    Parameters
    ----------
    prepared : PreparedScenario
        What was looked at before is not looked at again.

    Raises
    ------
    InputError
        Names the first element or attribute, its line, and what to do instead.
    """
    for file, element in prepared.scenario.read_parts():
        # Elements are held by their file, so that each stays the same object.
        if id(element) not in prepared.looked_at and local_name(element) != "OpenDRIVE":
            LEDGER.refuse(element, file)
            prepared.looked_at.add(id(element))
