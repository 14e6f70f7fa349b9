from ._criticality_bands import Bands as Bands
from ._interval_estimate import Estimate as Estimate
from ._probability import Probability as Probability
from ._sensitivity import Sensitivity as Sensitivity
from ._set_difference import CriticalSetDifference as CriticalSetDifference
