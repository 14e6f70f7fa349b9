"""What the builtin simulator does with each part of an OpenSCENARIO file."""

from __future__ import annotations

from typing import Final

from cornercase._common.ledger import Ledger, local_name
from cornercase.scenario import Scenario

LEDGER: Final = Ledger.read("cornercase.simulators.builtin", "openscenario.csv")
"""Elements and attributes of OpenSCENARIO XML 1.3, and those of earlier versions that are read still."""


def refuse_unusable(scenario: Scenario) -> None:
    """Refuse what the builtin simulator cannot run, in the scenario file and the catalog entries that were read.

    Parameters
    ----------
    scenario : Scenario

    Raises
    ------
    InputError
        Names the first element or attribute, its line, and what to do instead.
    """
    for file, element in scenario.read_parts():
        if local_name(element) != "OpenDRIVE":
            LEDGER.refuse(element, file)
