"""Run one concrete scenario."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from cornercase._common.errors import InputError
from cornercase._common.io.support_table import warn_notices
from cornercase._common.process.signals import collect_interrupts
from cornercase._common.text.element_locations import prefix_file
from cornercase._common.validation import check_int, check_parameter_values
from cornercase.drivers._resolve import DriverLike, resolve_driver
from cornercase.recordings import Recording
from cornercase.scenario import ConcreteScenario, LogicalScenario, Value
from cornercase.scenario._file import ScenarioFile
from cornercase.simulators._base import Simulator
from cornercase.simulators._common_options import split_common_options
from cornercase.simulators._create import create_simulator
from cornercase.simulators._driver_parameters import check_driver_parameters
from cornercase.simulators._results import check_simulator_accepts, list_ignored_content, run_scenarios
from cornercase.simulators._run_notices import RunNotices


def simulate(
    scenario: Path | str | ScenarioFile,
    values: Mapping[str, Value] | None = None,
    *,
    time_step: float = 0.05,
    duration: float = 60.0,
    on_collision: str = "continue",
    drivers: Mapping[str, DriverLike] | None = None,
    simulator: str | Simulator = "builtin",
    ego: str = "Ego",
    timeout: float | None = None,
    seed: int = 0,
) -> Recording:
    """Run one concrete scenario.

    Parameters
    ----------
    scenario : path or ScenarioFile
        OpenSCENARIO file.
    values : mapping of str to float or str, optional
        Parameter values; others are taken from the file.
    time_step : float, default 0.05
        Time step in s.
    duration : float, default 60
        Maximum duration in s.
    on_collision : {"continue", "stop"}, default "continue"
        Whether entities pass through each other, or the run ends. The file's own stop trigger holds either way.
    drivers : mapping of str to str, SystemUnderTest or Driver, optional
        Driver of each entity: a name as on the command line, or a driver object. Overrides the file's controllers.
    simulator : str or Simulator, default "builtin"
        An object such as ``Esmini(seed=3)``, or a name with options after a colon: ``"esmini:seed=3"``.
    ego : str, default "Ego"
        Entity under test, for a simulator that needs to know it.
    timeout : float, optional
        Time in s after which the run is cancelled.
    seed : int, default 0
        Seed of the random numbers of sensors and systems under test.

    Returns
    -------
    Recording

    Raises
    ------
    InputError
        The scenario cannot be run, an option is out of range, or a simulator, driver or parameter does not exist.

    Warns
    -----
    NoticeWarning
        Something in the files has no effect.

    See Also
    --------
    simulate_many : Runs many scenarios.

    Examples
    --------
    >>> import cornercase.simulators as simulators
    >>> scenario = "examples/x_intersection/x_intersection.xosc"
    >>> simulators.simulate(scenario, {"ego_start": 40.0}, duration=2.0).names
    ('Ego', 'Truck', 'C', 'Pedestrian')
    """
    given: object = scenario
    if isinstance(given, ConcreteScenario | LogicalScenario):
        values_hint = "scenario.values" if isinstance(given, ConcreteScenario) else "{'NAME': value}"
        raise InputError(
            f"`scenario`: is a {type(given).__name__}; give its file and the values, as in"
            f" simulate(scenario.path, {values_hint})."
        )
    file = scenario if isinstance(scenario, ScenarioFile) else ScenarioFile.read(scenario)
    checked_values, seed = check_parameter_values("values", values), check_int("seed", seed, 0)
    file.require_declared(list(checked_values))
    options: dict[str, Any] = {
        "time_step": time_step,
        "duration": duration,
        "on_collision": on_collision,
        "drivers": drivers or {},
    }
    simulator, options = split_common_options(simulator, options)
    options["drivers"] = {entity: resolve_driver(driver) for entity, driver in options["drivers"].items()}
    check_driver_parameters(simulator, file, options["drivers"], [checked_values])
    with collect_interrupts(), create_simulator(simulator, options, ego=ego, timeout=timeout) as started:
        check_simulator_accepts(started, [file])
        (result,) = run_scenarios(started, [ConcreteScenario(file.path, checked_values, file, seed)])
    if isinstance(result, Exception):
        raise InputError(prefix_file(file.path, f"{result}."))
    warn_notices(list_ignored_content(started, file, checked_values))
    notices = RunNotices(started)
    notices.add_run(result, lambda: file)
    notices.issue_warnings()
    return result
