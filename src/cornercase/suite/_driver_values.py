"""Find the values of driver parameters, such as ``Ego.reaction``, for each scenario of a suite."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from cornercase._common.errors import InputError
from cornercase._common.io.support_table import issue_notice_warning
from cornercase.drivers import Driver
from cornercase.drivers._parameters import check_parameters
from cornercase.drivers._resolve import check_drivers, driver_by_name
from cornercase.simulators import Simulator
from cornercase.simulators._driver_parameters import check_driver_parameters
from cornercase.suite._suite_contents import SuiteContents, SuiteScenario


def assign_driver_values(
    suite: SuiteContents, simulator: str | Simulator, drivers: Mapping[str, str | Driver]
) -> SuiteContents:
    """Return the suite with `driver_values` set: the values in each scenario for parameters of this run's drivers.

    If the scenario file itself names a driver, the values for this driver are in the file, and are only set here if
    `drivers` replaces the driver. A notice names values for parameters that a driver of this run does not have. Raises
    `InputError` if the simulator cannot pass parameters to drivers.
    """
    made = {
        entity: driver_by_name(driver) if isinstance(driver, str) else driver
        for entity, driver in check_drivers(drivers).items()
    }
    notices: dict[str, None] = {}
    scenarios = []
    for scenario in suite.scenarios:
        if not scenario.error:
            scenario = replace(scenario, driver_values=_select_values(scenario, made, notices))
            check_driver_parameters(simulator, scenario.scenario, drivers, [scenario.driver_values])
        scenarios.append(scenario)
    for notice in notices:
        issue_notice_warning(notice)
    return replace(suite, scenarios=tuple(scenarios))


def _select_values(
    scenario: SuiteScenario, drivers: Mapping[str, Driver], notices: dict[str, None]
) -> dict[str, float | str]:
    selected = {}
    for full_name, (entity, name) in scenario.scenario.parse_driver_option_names(scenario.values).items():
        if entity not in drivers:
            continue
        try:
            check_parameters(entity, drivers[entity], [name])
        except InputError as error:
            notices[f"without effect in this run: {str(error).partition(';')[0]}"] = None
        else:
            selected[full_name] = scenario.values[full_name]
    return selected
