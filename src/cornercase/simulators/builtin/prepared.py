"""What all batches of a scenario file share."""

from __future__ import annotations

from pathlib import Path

from cornercase.roads import RoadNetwork
from cornercase.scenario import Scenario


class PreparedScenario:
    """A scenario file with what its batches need, which is made once.

    Parameters
    ----------
    scenario : Scenario

    Attributes
    ----------
    scenario : Scenario
    splitting : set of str
        Parameters found to shape the storyboard: scenarios of one batch have the same values of them.
    """

    def __init__(self, scenario: Scenario) -> None:
        self.scenario = scenario
        self.splitting: set[str] = set()
        self._networks: dict[Path, RoadNetwork] = {}

    def network(self, reference: str) -> RoadNetwork:
        """Roads of the file that the scenario refers to so.

        Raises
        ------
        InputError
            The file cannot be used.
        """
        path = self.scenario.beside(reference, "road file")
        if path not in self._networks:
            self._networks[path] = RoadNetwork.of_xml(self.scenario.xml(path), path)
        return self._networks[path]
