from .verdict import State as State
from .verdict import Verdict as Verdict
from .verdict import worst_state as worst_state
