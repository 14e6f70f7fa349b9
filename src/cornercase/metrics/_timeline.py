"""Functions and classes of `cornercase.metrics.timeline` for other subpackages.

Import this module only inside the functions that need it: the import is slow, since it loads compiled code.
"""

from cornercase.metrics.timeline._earlier_braking import EARLIER as EARLIER
from cornercase.metrics.timeline._earlier_braking import EgoReaction as EgoReaction
from cornercase.metrics.timeline._earlier_braking import find_ego_reaction as find_ego_reaction
from cornercase.metrics.timeline._find_events import EncounterEvents as EncounterEvents
from cornercase.metrics.timeline._find_events import find_events as find_events
