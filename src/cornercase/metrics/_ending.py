"""Functions and classes of `cornercase.metrics.ending` for other subpackages.

Import this module inside the functions that need it, not at the top of a file, since it loads compiled code.
"""

from cornercase.metrics.ending._ego_features import measure_features_per_outcome as measure_features_per_outcome
from cornercase.metrics.ending._find_outcome import describe_outcome as describe_outcome
from cornercase.metrics.ending._find_outcome import find_outcome as find_outcome
from cornercase.metrics.ending._find_outcome import find_outcomes as find_outcomes
from cornercase.metrics.ending._poses import Poses as Poses
