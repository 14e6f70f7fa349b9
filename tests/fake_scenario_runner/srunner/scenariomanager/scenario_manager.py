"""What runs a storyboard."""


class ScenarioManager:
    """Runs what it is given."""

    drive = print

    def run_scenario(self):
        self.drive()
