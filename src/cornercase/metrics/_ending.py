"""What other rooms use of `cornercase.metrics.ending`; it is compiled, so they import it where they need it."""

from cornercase.metrics.ending._ego_features import measure_all_features as measure_all_features
from cornercase.metrics.ending._find_outcome import describe_outcome as describe_outcome
from cornercase.metrics.ending._find_outcome import find_outcome as find_outcome
from cornercase.metrics.ending._find_outcome import find_outcomes as find_outcomes
from cornercase.metrics.ending._poses import Poses as Poses
