from ._read import read_recording as read_recording
from ._recording import Collision as Collision
from ._recording import Recording as Recording
