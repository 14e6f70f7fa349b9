"""One concrete scenario in the builtin simulator."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from cornercase._common.arguments import numbers_or_texts
from cornercase._common.errors import InputError
from cornercase._common.ledger import warn_of
from cornercase.drivers import Driver, named_driver
from cornercase.recordings import Recording
from cornercase.scenario import ConcreteScenario, Scenario, Value
from cornercase.simulators.builtin.effect import notices_after_reading
from cornercase.simulators.builtin.simulator import BuiltinSimulator


def simulate(
    scenario: Path | str | Scenario,
    values: Mapping[str, Value] | None = None,
    *,
    time_step: float = 0.05,
    duration: float = 60.0,
    on_collision: str = "continue",
    drivers: Mapping[str, str | Driver] | None = None,
) -> Recording:
    """Run one concrete scenario.

    Parameters
    ----------
    scenario : path or Scenario
        OpenSCENARIO file.
    values : mapping of str to float or str, optional
        Values of its parameters; the others have those of the file.
    time_step : float, default 0.05
        s.
    duration : float, default 60
        s after which it ends at the latest.
    on_collision : {"continue", "stop"}, default "continue"
        Whether entities pass through each other, or the run ends. The file's own stop trigger holds either way.
    drivers : mapping of str to str or Driver, optional
        Who drives which entity: a name as on the command line, or a driver. Beats the file's controller properties.

    Returns
    -------
    Recording

    Raises
    ------
    InputError
        The scenario cannot be run, an option is out of range, or a driver or parameter does not exist.

    Warns
    -----
    NoticeWarning
        Something in the files has no effect.

    See Also
    --------
    BuiltinSimulator : Runs many at once.

    Examples
    --------
    >>> import cornercase.simulators as simulators
    >>> scenario = "examples/x_intersection/x_intersection.xosc"
    >>> simulators.simulate(scenario, {"ego_start": 40.0}, duration=2.0).names
    ('Ego', 'Truck', 'C', 'Pedestrian')
    """
    file = scenario if isinstance(scenario, Scenario) else Scenario.read(scenario)
    given = numbers_or_texts("values", values)
    file.require_parameters(list(given))
    simulator = BuiltinSimulator(
        time_step=time_step,
        duration=duration,
        on_collision=on_collision,
        drivers={
            entity: named_driver(driver) if isinstance(driver, str) else driver
            for entity, driver in (drivers or {}).items()
        },
    )
    (result,) = simulator.run([ConcreteScenario(file.path, given, file)])
    if isinstance(result, Exception):
        raise InputError(f"{file.path}: {result}.")
    warn_of(notices_after_reading(file))
    return result
