"""What controllers know of a trajectory."""


class BasicControl:
    """The base of all controllers, as far as one looks at it."""

    def __init__(self, actor):
        self._actor = actor
        self._waypoints = []
        self._times = []
