"""Support table of OpenDRIVE: how each element and attribute is handled."""

from __future__ import annotations

from typing import Final

from cornercase._common.io.support_table import SupportTable

SUPPORT_TABLE: Final = SupportTable.from_csv("cornercase.roads", "opendrive.csv")
"""Elements and attributes of OpenDRIVE 1.4 to 1.9."""
