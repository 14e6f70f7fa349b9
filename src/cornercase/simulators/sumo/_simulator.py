"""Eclipse SUMO as a simulator: SUMO drives some entities, and the builtin storyboard moves all other entities."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property, partial
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec

import numpy as np

from cornercase._common.errors import InputError, SimulationError, suggest_name
from cornercase._common.io.support_table import Notice
from cornercase._common.optional_packages import describe_install
from cornercase._common.text.sanitize import remove_folders
from cornercase._common.typing import FloatArray
from cornercase.drivers import DRIVERS, Driver, Situation
from cornercase.drivers._registry import is_registered_driver, split_spec
from cornercase.drivers._resolve import DriverLike, check_drivers
from cornercase.recordings import Recording
from cornercase.scenario import ConcreteScenario, Value
from cornercase.scenario._file import ScenarioFile
from cornercase.simulators._base import Availability, Simulator, check_seed, check_settings
from cornercase.simulators._driver_parameters import find_parameters_of_drivers
from cornercase.simulators.builtin._batch import Batch
from cornercase.simulators.builtin._ignored_content import read_and_collect_notices
from cornercase.simulators.builtin._prepared_file import PreparedScenario, UnusableValuesError
from cornercase.simulators.sumo._coupling import VEHICLE_TYPES, SumoCoupling
from cornercase.simulators.sumo._network import find_or_convert_network


class Sumo(Simulator):
    """Simulator that runs concrete scenarios in which SUMO's car-following and junction models drive vehicles.

    SUMO drives entities with the driver ``cautious``, ``normal`` or ``aggressive``: each is a vehicle type of SUMO. All
    other entities move as in the builtin simulator, and SUMO sees those on lanes: a vehicle that follows its lane as
    traffic on a route, any other entity at its position on the road. So all scenarios of the builtin simulator can run
    in SUMO, but a vehicle that SUMO drives follows its lane and ignores trajectories.

    Parameters
    ----------
    time_step : float, default 0.05
        Time step in s.
    duration : float, default 60
        Maximum duration of a scenario in s.
    on_collision : {"continue", "stop"}, default "continue"
        Whether the first collision ends the run. As in the builtin simulator, entities collide if their boxes overlap.
    drivers : mapping of str to str, SystemUnderTest or Driver, optional
        Driver by entity: ``"cautious"``, ``"normal"`` or ``"aggressive"`` for a vehicle type of SUMO, or any other
        driver of cornercase.
    seed : int, default 0
        Seed of SUMO. It has no effect with the built-in vehicle types, which are deterministic.
    network : str, optional
        A ``.net.xml`` file to use instead of the scenario's OpenDRIVE file, in the same coordinates.

    Raises
    ------
    InputError
        An option is out of range. `run` raises it if SUMO is not installed.

    Examples
    --------
    >>> import cornercase as cc
    >>> simulator = cc.simulators.Sumo(drivers={"Ego": "normal"})
    >>> study = cc.Study.create("study.db", problem, simulator)  # doctest: +SKIP
    """

    name = "sumo"
    deterministic = True
    takes_driver_parameters = True
    parameter_passing = "file"

    def __init__(
        self,
        *,
        time_step: float = 0.05,
        duration: float = 60.0,
        on_collision: str = "continue",
        drivers: Mapping[str, DriverLike] | None = None,
        seed: int = 0,
        network: str | None = None,
    ) -> None:
        self._common_settings = check_settings(time_step, duration, on_collision, drivers)
        self._time_step, self._duration, self._on_collision = time_step, duration, on_collision
        self._drivers, self._seed, self._network = check_drivers(drivers), check_seed(seed, "SUMO"), network
        self._last_scenario: ScenarioFile | None = None

    @cached_property
    def settings(self) -> dict[str, object]:  # type: ignore[override]
        """Settings that recordings depend on; `InputError` if SUMO is not installed."""
        _require_installed()
        return {
            **self._common_settings,
            "seed": self._seed,
            "network": None if self._network is None else remove_folders(self._network),
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
            problem="" if installed_version else _describe_missing(),
            features=(
                "pedestrians", "car-following", "right of way", "collisions go on or end the run", "deterministic",
            ),
        )  # fmt: skip

    @classmethod
    def notices(cls, scenario: ScenarioFile, values: Mapping[str, Value] | None = None) -> tuple[Notice, ...]:
        """Return notices about content of a scenario file that has no effect: the same as in the builtin simulator."""
        return read_and_collect_notices(scenario, values)

    @classmethod
    def own_agents(cls) -> Mapping[str, Mapping[str, object]]:
        """Return the simulator options that let each car-following model of SUMO drive the ego, by model."""
        return {f"SUMO's model '{name}'": {"drivers": {"Ego": name}} for name in VEHICLE_TYPES}

    def run(self, concretes: Sequence[ConcreteScenario]) -> Iterator[Recording | SimulationError]:
        """Run scenarios; also raises `InputError` if SUMO is not installed."""
        _require_installed()
        for concrete in concretes:
            scenario = self._last_scenario = concrete.load_file(self._last_scenario)
            prepared = PreparedScenario.from_scenario(scenario)
            for entity in self._drivers:
                scenario.require_entity(entity, "driven entity")
            types = self._find_vehicle_types(scenario)
            self._refuse_parameters_of_absent_drivers(scenario, types, concrete.values)
            try:
                yield self._run_scenario(prepared, concrete, types)
            except UnusableValuesError as error:
                make_batch = partial(self._make_batch, prepared, ConcreteScenario(scenario.path), self._drivers, None)
                yield SimulationError(prepared.describe_value_error(error, concrete.values, make_batch))

    def _run_scenario(
        self, prepared: PreparedScenario, concrete: ConcreteScenario, types: Mapping[str, str]
    ) -> Recording | SimulationError:
        if problem := prepared.find_invalid_values([concrete.values]).get(0):
            return SimulationError(problem)
        roads = prepared.scenario.road_path_for(concrete.values)
        if roads is not None and not roads.is_file():
            self._make_batch(prepared, concrete, self._drivers, None)  # raises an error that names the parameter
        network = find_or_convert_network(prepared.scenario, self._network, concrete.values)
        with SumoCoupling(network, types, self._time_step, self._seed) as coupling:
            batch = self._make_batch(
                prepared, concrete, {**self._drivers, **dict.fromkeys(types, _PlaceholderDriver())}, coupling
            )
            batch.run()
        self.notify(batch.remarks)
        return coupling.error or batch.results([0])[0]

    def _make_batch(
        self,
        prepared: PreparedScenario,
        concrete: ConcreteScenario,
        drivers: Mapping[str, str | Driver],
        coupling: SumoCoupling | None,
    ) -> Batch:
        return Batch(
            prepared,
            [concrete.values],
            [concrete.seed],
            self._time_step,
            self._duration,
            self._on_collision == "stop",
            drivers,
            coupling,
        )

    def check_supported(self, scenario: ScenarioFile) -> None:
        """Refuse unknown drivers, and sensors or vehicle models of an entity that SUMO itself drives."""
        self._find_vehicle_types(scenario)

    def check_runnable(self, concretes: Sequence[ConcreteScenario]) -> None:
        """Refuse values for parameters of a driver of cornercase if SUMO itself drives the entity."""
        for concrete in concretes:
            scenario = concrete.load_file()
            self._refuse_parameters_of_absent_drivers(scenario, self._find_vehicle_types(scenario), concrete.values)

    def _refuse_parameters_of_absent_drivers(
        self, scenario: ScenarioFile, types: Mapping[str, str], values: Mapping[str, Value]
    ) -> None:
        for entity, _, names in find_parameters_of_drivers(scenario, self._drivers, values):
            if entity in types:
                raise InputError(
                    f"{scenario.path}: {next(iter(names.values()))} is a parameter of a driver of cornercase, but SUMO"
                    f" itself drives {entity} as '{types[entity]}'; leave out the parameter, or give {entity} another"
                    " driver."
                )

    def _find_vehicle_types(self, scenario: ScenarioFile) -> dict[str, str]:
        """Return the vehicle type of each entity that SUMO drives; refuse unknown drivers."""
        all_drivers = {**scenario.drivers, **self._drivers}
        for name, driver in all_drivers.items():
            if not isinstance(driver, str):
                continue
            model, equipment = split_spec(driver)
            if equipment and model in VEHICLE_TYPES:
                raise InputError(
                    f"{scenario.path}: '{name}' asks for the driver '{driver}', but here '{model}' is SUMO's"
                    f" own model, which uses no sensors and no vehicle model; leave out '{equipment[0]}', or give"
                    " another driver."
                )
            if driver not in VEHICLE_TYPES and not is_registered_driver(driver):
                hint = suggest_name(driver.partition(":")[0], {*VEHICLE_TYPES, *DRIVERS.names()})
                raise InputError(f"{scenario.path}: '{name}' asks for the driver '{driver}'; {hint}")
        return {
            name: driver for name, driver in all_drivers.items() if isinstance(driver, str) and driver in VEHICLE_TYPES
        }


class _PlaceholderDriver(Driver):
    """Placeholder driver for an entity that SUMO drives: it decides nothing, but takes control from the storyboard."""

    def acceleration(self, situation: Situation) -> FloatArray:
        """Return zero, shape (1,): the coupling sets the speed."""
        return np.zeros(1)


def _require_installed() -> None:
    if find_spec("libsumo") is None:
        raise InputError(_describe_missing())


def _describe_missing() -> str:
    return f"SUMO is not installed; {describe_install('sumo')}."
