"""Careful and competent driver of UN Regulation No. 157: constants and functions for other packages."""

from typing import Final

from cornercase.drivers.references.r157._models import FULL_BRAKING as FULL_BRAKING
from cornercase.drivers.references.r157._models import JERK as JERK
from cornercase.drivers.references.r157._models import REFERENCES
from cornercase.drivers.references.r157._models import (
    min_avoidable_time_to_collision as min_avoidable_time_to_collision,
)

RISK_PERCEPTION: Final = 0.4
"""Time in s in which the driver recognises a danger; Annex 4, Appendix 3."""

DELAY: Final = REFERENCES["cc-human"].delay
"""Time in s from recognising a danger to braking."""
