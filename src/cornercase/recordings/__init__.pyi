from ._osi_trace import write_osi as write_osi
from ._read import read_recording as read_recording
from ._recording import Collision as Collision
from ._recording import Recording as Recording
