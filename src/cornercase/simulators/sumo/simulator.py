"""Eclipse SUMO: SUMO drives the ego, the builtin storyboard moves all other entities."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec

import numpy as np

from cornercase._common.errors import InputError, SimulationError, suggestion
from cornercase._common.ledger import Notice
from cornercase._common.texts import without_folders
from cornercase._common.typing import FloatArray
from cornercase.drivers import DRIVERS, Driver, Situation, is_registered
from cornercase.recordings import Recording
from cornercase.scenario import ConcreteScenario, Scenario, Value
from cornercase.simulators.base import Availability, Simulator, checked_seed, checked_settings
from cornercase.simulators.builtin.batch import Batch
from cornercase.simulators.builtin.effect import notices
from cornercase.simulators.builtin.prepared import PreparedScenario, UnusableError
from cornercase.simulators.sumo.coupling import TYPES, SumoCoupling
from cornercase.simulators.sumo.network import sumo_network

_MISSING = "SUMO is not installed; pip install 'cornercase[sumo]'."


class SumoSimulator(Simulator):
    """Runs concrete scenarios in which SUMO's car-following and junction models drive.

    SUMO drives entities with the driver ``cautious``, ``normal`` or ``aggressive``, as a vehicle type of that name. The
    builtin storyboard moves all others as in the builtin simulator, and SUMO sees them: vehicles that follow their lane
    as traffic on its route, others where they are on the road. So whatever the builtin simulator runs can be run here,
    but a vehicle that SUMO drives follows its lane and ignores trajectories.

    Parameters
    ----------
    time_step : float, default 0.05
        In s.
    duration : float, default 60
        Maximum duration of a scenario in s.
    on_collision : {"continue", "stop"}, default "continue"
        As for the builtin simulator: overlapping boxes collide.
    drivers : mapping of str to str or Driver, optional
        By entity: a vehicle type of SUMO, or a driver of cornercase.
    seed : int, default 0
        Seed of SUMO. It has no effect with the built-in vehicle types, which are deterministic.
    network : str, optional
        A ``.net.xml`` file to use instead of the scenario's OpenDRIVE file, in the same coordinates.

    Raises
    ------
    InputError
        SUMO is not installed, or an option is out of range.
    """

    name = "sumo"
    repeats_itself = True
    values_by = "file"

    def __init__(
        self,
        *,
        time_step: float = 0.05,
        duration: float = 60.0,
        on_collision: str = "continue",
        drivers: Mapping[str, str | Driver] | None = None,
        seed: int = 0,
        network: str | None = None,
    ) -> None:
        settings = checked_settings(time_step, duration, on_collision, drivers)
        if find_spec("libsumo") is None:
            raise InputError(_MISSING)
        self._time_step, self._duration, self._on_collision = time_step, duration, on_collision
        self._drivers, self._seed, self._network = dict(drivers or {}), seed, network
        self._prepared: PreparedScenario | None = None
        self.settings: dict[str, object] = {
            **settings,
            "seed": checked_seed(seed, "SUMO"),
            "network": None if network is None else without_folders(network),
            "sumo": version("libsumo"),
        }

    @classmethod
    def availability(cls) -> Availability:
        """Return whether SUMO is installed."""
        try:
            installed_version = version("libsumo")
        except PackageNotFoundError:
            installed_version = ""
        return Availability(
            version=installed_version,
            missing="" if installed_version else _MISSING,
            abilities=(
                "pedestrians",
                "car-following",
                "right of way",
                "collisions go on or end the run",
                "deterministic",
            ),
        )

    @classmethod
    def notices(cls, scenario: Scenario, values: Mapping[str, Value] | None = None) -> tuple[Notice, ...]:
        """List content without effect, as for the builtin simulator, whose storyboard is used."""
        return notices(scenario, values)

    def run(self, concretes: Sequence[ConcreteScenario]) -> Iterator[Recording | SimulationError]:
        """Run scenarios, as `Simulator.run`."""
        prepared = self._prepared
        for concrete in concretes:
            scenario = concrete.scenario(None if prepared is None else prepared.scenario)
            if prepared is None or prepared.scenario is not scenario:
                prepared = self._prepared = PreparedScenario(scenario)
            for entity in self._drivers:
                scenario.require_entity(entity, "driven entity")
            types = self._types(scenario)
            try:
                yield self._run(prepared, concrete.values, types)
            except UnusableError as error:
                make_batch = partial(self._batch, prepared, {}, self._drivers, None)
                yield SimulationError(prepared.what_is_wrong(error, concrete.values, make_batch))

    def _run(
        self, prepared: PreparedScenario, values: Mapping[str, Value], types: Mapping[str, str]
    ) -> Recording | SimulationError:
        if problem := prepared.unusable([values]).get(0):
            return SimulationError(problem)
        roads = prepared.scenario.road_file(values)
        if roads is not None and not roads.is_file():
            self._batch(prepared, values, self._drivers, None)  # raises an error that names the parameter
        network = sumo_network(prepared.scenario, self._network, values)
        with SumoCoupling(network, types, self._time_step, self._seed) as coupling:
            batch = self._batch(prepared, values, {**self._drivers, **dict.fromkeys(types, _LeftToSumo())}, coupling)
            batch.run()
        self.notice(batch.remarks)
        return coupling.error or batch.results([0])[0]

    def _batch(
        self,
        prepared: PreparedScenario,
        values: Mapping[str, Value],
        drivers: Mapping[str, str | Driver],
        coupling: SumoCoupling | None,
    ) -> Batch:
        return Batch(
            prepared, [values], self._time_step, self._duration, self._on_collision == "stop", drivers, coupling
        )

    def require_means(self, scenario: Scenario) -> None:
        """Refuse a scenario with an unknown driver."""
        self._types(scenario)

    def _types(self, scenario: Scenario) -> dict[str, str]:
        """Vehicle types of the entities that SUMO drives."""
        all_drivers = {**scenario.drivers, **self._drivers}
        for name, driver in all_drivers.items():
            if isinstance(driver, str) and driver not in TYPES and not is_registered(driver):
                hint = suggestion(driver.partition(":")[0], (*TYPES, *DRIVERS.names()))
                raise InputError(f"{scenario.path}: '{name}' asks for the driver '{driver}'; {hint}")
        return {name: driver for name, driver in all_drivers.items() if isinstance(driver, str) and driver in TYPES}


class _LeftToSumo(Driver):
    """Driver that decides nothing, so that the storyboard leaves the entity to SUMO."""

    def acceleration(self, situation: Situation) -> FloatArray:
        """Return zero, shape (1,): the coupling sets the speed."""
        return np.zeros(1)
