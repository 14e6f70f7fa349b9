"""The base class of agents in files."""


class AutonomousAgent:
    """Sets itself up."""

    def __init__(self, path_to_conf_file):
        self.setup(path_to_conf_file)

    def setup(self, path_to_conf_file):
        pass
