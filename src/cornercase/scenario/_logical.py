"""Logical and concrete scenarios."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Final, Self

import numpy as np

from cornercase._common.errors import InputError
from cornercase._common.unknown_names import suggest_arguments
from cornercase._common.validation import check_bool, check_float, check_parameter_values, check_path, check_str
from cornercase.scenario._constraints import read_declarations
from cornercase.scenario._file import ScenarioFile
from cornercase.scenario._parameter import Value
from cornercase.scenario._range_syntax import create_range, format_ranges
from cornercase.scenario._scope import Scope
from cornercase.scenario._space import ParameterSpace
from cornercase.scenario._types import convert_to_type, find_type_errors
from cornercase.scenario._variables import list_variables
from cornercase.scenario._varied_road_files import add_varied_roads
from cornercase.scenario._xml import XmlFileCache

_OWN_SIMULATOR_HINT: Final = (
    "; your own simulator only needs a file that declares parameters and entities (docs/howto/own-simulator.md)"
)


@dataclass(frozen=True)
class ConcreteScenario:
    """One traffic situation, ready to run.

    Attributes
    ----------
    path : Path
        OpenSCENARIO file.
    values : mapping of str to float or str
        Values of the parameters that are set, and of driver options, such as ``"Ego.reaction"``. All other parameters
        have the defaults of the file.
    file : ScenarioFile, optional
        The parsed file; by default it is read when the scenario runs.
    seed : int, default 0
        Seed of the random numbers in this run. The seed and the parameter values together determine the random
        numbers of sensors and systems under test.

    Examples
    --------
    >>> import cornercase as cc
    >>> scenario = cc.LogicalScenario.read(
    ...     "examples/x_intersection/x_intersection.xosc", ranges=["ego_start=20:80"]
    ... )
    >>> concrete = scenario.concrete_scenario({"ego_start": 45.0})
    >>> next(iter(cc.simulators.Builtin().run([concrete])))
    <Recording of Ego (car), Truck (truck), C (car), Pedestrian (pedestrian), 15.7 s in 315 instants, no collision>
    """

    path: Path
    values: Mapping[str, Value] = field(default_factory=dict)
    file: ScenarioFile | None = field(default=None, repr=False, compare=False)
    seed: int = 0

    def load_file(self, reusable: ScenarioFile | None = None) -> ScenarioFile:
        """Return the parsed scenario file, reading it if necessary.

        Parameters
        ----------
        reusable : ScenarioFile, optional
            A file that was parsed before. It is returned if it has the same path and content, so that nothing is parsed
            again.

        Returns
        -------
        ScenarioFile

        Raises
        ------
        InputError
            The file cannot be used.
        """
        own = ScenarioFile.read(self.path) if self.file is None else self.file
        return reusable if reusable is not None and reusable.has_same_content(own) else own

    def with_all_values(self) -> ConcreteScenario:
        """Return the scenario with the values of all parameters that its file declares, converted to their types.

        Returns
        -------
        ConcreteScenario
            The scenario itself if `file` is None.

        Raises
        ------
        InputError
            A value does not have its declared type, or cannot be evaluated.

        Examples
        --------
        >>> from cornercase import LogicalScenario
        >>> logical = LogicalScenario.read("examples/r157/deceleration.xosc", ranges=["gap=20:40"])
        >>> logical.concrete_scenario({"gap": 30.0}).with_all_values().values
        {'ego_kmh': 90.0, 'gap': 30.0, 'deceleration': 0.5}
        """
        return self if self.file is None else replace(self, values=_evaluate_all_parameters(self.file, self.values))

    def without_driver_parameters(self, entity: str) -> ConcreteScenario:
        """Return the scenario without the driver options of an entity, so that the entity can have another driver.

        Parameters
        ----------
        entity : str

        Returns
        -------
        ConcreteScenario

        Raises
        ------
        InputError
            The file cannot be used.
        """
        if not any("." in name for name in self.values):
            return self
        own = self.load_file().parse_driver_option_names(self.values)
        values = {name: value for name, value in self.values.items() if own.get(name, ("",))[0] != entity}
        return replace(self, values=values)


@dataclass(frozen=True)
class LogicalScenario:
    """A traffic situation with parameter ranges.

    Attributes
    ----------
    path : Path
        OpenSCENARIO file.
    space : ParameterSpace
        Varied parameters and their ranges.
    fingerprint : str
        SHA-256 of the scenario file, its catalogs, its file of openPASS profiles, and all road files that the scenario
        or the space names.
    file : ScenarioFile, optional
        The parsed file.

    Examples
    --------
    >>> import cornercase as cc
    >>> scenario = cc.LogicalScenario.read(
    ...     "examples/x_intersection/x_intersection.xosc", ranges=["ego_start=20:80"]
    ... )
    >>> scenario
    <LogicalScenario 'examples/x_intersection/x_intersection.xosc': ego_start 20 to 80>
    >>> scenario.concrete_scenario({"ego_start": 45.0}).values
    {'ego_start': 45.0}
    """

    path: Path
    space: ParameterSpace
    fingerprint: str
    file: ScenarioFile | None = field(default=None, repr=False, compare=False)

    def __repr__(self) -> str:
        varied = ", ".join(map(str, self.space.parameters)) or "nothing is varied"
        return f"<LogicalScenario {str(self.path)!r}: {varied}>"

    @cached_property
    def scenario_file(self) -> ScenarioFile:
        """The parsed scenario file."""
        return ScenarioFile.read(self.path) if self.file is None else self.file

    @classmethod
    @suggest_arguments
    def read(
        cls,
        scenario: Path | str | ScenarioFile | None,
        space: Path | str | None = None,
        ranges: Sequence[str] | Mapping[str, Sequence[float]] = (),
        continuous: bool = False,
    ) -> LogicalScenario:
        """Read a logical scenario.

        Parameters
        ----------
        scenario : path or ScenarioFile, optional
            OpenSCENARIO file; by default the file that `space` names.
        space : path, optional
            ParameterValueDistribution file. Without `space` and `ranges`, nothing is varied until `vary` is called.
        ranges : sequence of str or mapping
            ``["NAME=LOW:HIGH[:STEP]"]`` or ``{"NAME": (LOW, HIGH)}``. NAME is a declared parameter, or an option of an
            entity's driver, as in ``Ego.reaction=0.1:0.6``. A range is added to the space; if the space already varies
            NAME, the range replaces its values.
        continuous : bool, default False
            Treat ranges with steps as continuous.

        Returns
        -------
        LogicalScenario

        Raises
        ------
        InputError
            A file cannot be used, or a varied parameter is neither declared in the scenario nor an option of an
            entity's driver.

        Examples
        --------
        >>> from cornercase import LogicalScenario
        >>> folder = "examples/x_intersection/x_intersection"
        >>> logical = LogicalScenario.read(f"{folder}.xosc", f"{folder}.space.xosc")
        >>> [parameter.name for parameter in logical.space.parameters]
        ['ego_start', 'pedestrian_wait', 'p1_speed']
        """
        ranges = format_ranges(ranges)
        files = XmlFileCache()
        varied = ParameterSpace(()) if space is None else ParameterSpace.from_file(check_path("space", space), files)
        if scenario is None:
            if space is None:
                hint = _OWN_SIMULATOR_HINT if ranges else ""
                raise InputError(
                    f"There is no scenario; name an OpenSCENARIO file, or a `space` file that names one{hint}."
                )
            scenario = ParameterSpace.read_scenario_path(space, files)
        varied = varied.with_ranges(ranges)
        file = scenario if isinstance(scenario, ScenarioFile) else ScenarioFile.read(scenario)
        file.add_files(files)
        return cls._from_space(file, varied.as_continuous() if check_bool("continuous", continuous) else varied)

    @classmethod
    def _from_space(cls, file: ScenarioFile, space: ParameterSpace) -> Self:
        """Create a logical scenario from a file and a space.

        Each varied parameter must be declared in the file, or be an option of an entity's driver. The declared types
        and constraints are added to the space. The road files that the parameters can select are added to the file.
        """
        file.require_declared(list(space.assigned_names))
        declarations = read_declarations(file.root, str(file.path))
        space = space.with_types(declarations, str(file.path)).with_constraints(declarations, str(file.path))
        file = add_varied_roads(file, space)
        return cls(file.path, space, file.fingerprint(), file)

    @suggest_arguments
    def vary(self, name: str, low: float, high: float, *, step: float | None = None) -> Self:
        """Return the scenario with one parameter varied in a range; all other parameters stay as they are.

        Parameters
        ----------
        name : str
            A parameter that the scenario file declares, or an option of an entity's driver, as in ``"Ego.reaction"``.
            The parameter is added to the space; if the space has the parameter, its range is replaced.
        low, high : float
            Bounds of the range, in the parameter's unit. Equal bounds fix the parameter: each scenario has this value.
        step : float, optional
            Distance between successive values. By default all values between the bounds are possible that the declared
            type of the parameter allows, such as all integers.

        Returns
        -------
        LogicalScenario

        Raises
        ------
        InputError
            `name` is neither a declared parameter nor an option of an entity's driver, or the range is invalid.

        See Also
        --------
        cornercase.scenario.vary : Varies numbers of the file that are not declared as parameters.

        Examples
        --------
        >>> from cornercase import LogicalScenario
        >>> logical = LogicalScenario.read("examples/r157/deceleration.xosc")
        >>> logical.vary("gap", 20, 40).vary("deceleration", 1, 6, step=0.5)
        <LogicalScenario 'examples/r157/deceleration.xosc': gap 20 to 40, deceleration 1 to 6 by 0.5>
        >>> logical.vary("gap", 20, 40).vary("deceleration", 4, 4)
        <LogicalScenario 'examples/r157/deceleration.xosc': gap 20 to 40, deceleration 4>
        """
        low, high = check_float("low", low), check_float("high", high)
        location = f"`low` {low:g}, `high` {high:g}"
        if step is not None:
            step = check_float("step", step, above=0.0)
            location += f", `step` {step:g}"
        if "." in check_str("name", name) and any(
            variable.name == name and not variable.is_declared for variable in list_variables(self.scenario_file)
        ):
            raise InputError(
                f"`name` {name}: is a number of the file, but not a parameter; make it a parameter with"
                f" `cornercase.scenario.vary({str(self.path)!r}, ['{name}={low:g}:{high:g}'], 'varied.xosc')`."
            )
        varied = create_range(name, low, high, step, location, may_be_fixed=True)
        return self._from_space(self.scenario_file, self.space.with_parameters([varied]))

    def concrete_scenario(self, values: Mapping[str, Value], seed: int = 0) -> ConcreteScenario:
        """Return the concrete scenario with the given parameter values.

        Parameters
        ----------
        values : mapping of str to float or str
            Values by name of a declared parameter, or of an option of an entity's driver, as ``"Ego.reaction"``. All
            other parameters have the defaults of the file.
        seed : int, default 0
            Seed of the random numbers in this run.

        Returns
        -------
        ConcreteScenario

        Raises
        ------
        InputError
            A name is neither a declared parameter nor an option of an entity's driver, or a value does not have the
            declared type.
        """
        given = check_parameter_values("values", values)
        self.scenario_file.require_declared(list(given))
        declarations = read_declarations(self.scenario_file.root, str(self.path))
        for problem in find_type_errors(declarations, [given]).values():
            raise InputError(f"`values`: {problem}.")
        return ConcreteScenario(self.path, given, self.file, seed)


def _evaluate_all_parameters(scenario: ScenarioFile, assigned: Mapping[str, Value]) -> dict[str, Value]:
    """Return the assigned or default value of each declared parameter, converted to its declared type.

    Also return the assigned values of names that the file does not declare, such as options of drivers, unconverted.
    """
    declarations = {
        declaration.name: declaration for declaration in read_declarations(scenario.root, str(scenario.path))
    }
    changed = {
        name: value for name, value in assigned.items() if name in declarations and value != declarations[name].value
    }
    scope = Scope.from_declarations(str(scenario.path), list(declarations.values()), [changed])
    values = {
        name: _convert_scalar(scope.parameter_values[name], declaration.type_name)
        for name, declaration in declarations.items()
    }
    return values | {name: value for name, value in assigned.items() if name not in declarations}


def _convert_scalar(value: Any, type_name: str) -> Value:
    scalar = value.flat[0].item() if isinstance(value, np.ndarray) else value
    try:
        return convert_to_type(scalar, type_name)
    except ValueError:
        # The declaration may be for other tools only.
        return str(scalar)
