"""What ScenarioRunner knows of its world."""


class CarlaDataProvider:
    """Knows the world."""

    world = None

    @staticmethod
    def get_world():
        return CarlaDataProvider.world
