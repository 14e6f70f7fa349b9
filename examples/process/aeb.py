"""An emergency brake in Python; it needs cornercase_client.py beside it, and msgpack."""

from cornercase_client import Control, Function, serve


class Aeb(Function):
    """Brakes if the leader is closer than the ego comes in the time to brake."""

    def __init__(self, time_to_brake=1.5):
        self.time_to_brake = time_to_brake

    def step(self, view, dt):
        """Decide one step of one scenario."""
        leader = view.leader
        if leader is not None and leader.gap < self.time_to_brake * leader.closing:
            return Control(acceleration=-8.0)
        return 0.0


serve(Aeb)
