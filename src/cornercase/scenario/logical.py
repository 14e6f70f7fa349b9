"""Logical and concrete scenarios."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Final

from cornercase._common.arguments import flag, path, texts
from cornercase._common.errors import InputError
from cornercase.scenario.constraints import read_declarations
from cornercase.scenario.named_values import named_values
from cornercase.scenario.openscenario import Scenario
from cornercase.scenario.parameter import Value
from cornercase.scenario.space import ParameterSpace
from cornercase.scenario.varied_roads import with_roads
from cornercase.scenario.xml import XmlFiles

_ENOUGH: Final = (
    "; for a simulator of your own, a file is enough that declares parameters and entities"
    " (docs/howto/own-simulator.md)"
)


@dataclass(frozen=True)
class ConcreteScenario:
    """One traffic situation, ready to run.

    Attributes
    ----------
    path : Path
        OpenSCENARIO file.
    values : mapping of str to float or str
        Parameters that differ from the file's own.
    source : Scenario, optional
        The file as it was read; without it, it is read when it runs.
    """

    path: Path
    values: Mapping[str, Value] = field(default_factory=dict)
    source: Scenario | None = field(default=None, repr=False, compare=False)

    def scenario(self, known: Scenario | None = None) -> Scenario:
        """Give the scenario file: as it was read, or read now where it was not.

        Parameters
        ----------
        known : Scenario, optional
            Given instead where it is the same file with the same content, so that nothing of it is read again.

        Returns
        -------
        Scenario

        Raises
        ------
        InputError
            The file cannot be used.
        """
        given = Scenario.read(self.path) if self.source is None else self.source
        return known if known is not None and known.is_same(given) else given

    def by_name(self) -> ConcreteScenario:
        """Give the same scenario with the values of all parameters that its file declares.

        Returns
        -------
        ConcreteScenario
            Each value has the type that the file declares. It stays as it is where the file was not read.

        Raises
        ------
        InputError
            A value is not of its type, or cannot be evaluated.

        Examples
        --------
        >>> from cornercase.scenario import ConcreteScenario, Scenario
        >>> scenario = Scenario.read("examples/r157/deceleration.xosc")
        >>> ConcreteScenario(scenario.path, {"gap": 30.0}, scenario).by_name().values
        {'ego_kmh': 90.0, 'gap': 30.0, 'deceleration': 0.5}
        """
        return self if self.source is None else replace(self, values=named_values(self.source, self.values))


@dataclass(frozen=True)
class LogicalScenario:
    """A traffic situation with parameter ranges.

    Attributes
    ----------
    path : Path
        OpenSCENARIO file.
    space : ParameterSpace
        What is varied, and in which bounds.
    fingerprint : str
        SHA-256 over the scenario file, its catalogs, and its road file; of all road files that the space names.
    source : Scenario, optional
        The file as it was read.
    """

    path: Path
    space: ParameterSpace
    fingerprint: str
    source: Scenario | None = field(default=None, repr=False, compare=False)

    def __repr__(self) -> str:
        return f"<LogicalScenario {str(self.path)!r}: {', '.join(map(str, self.space.parameters))}>"

    @cached_property
    def scenario(self) -> Scenario:
        """The scenario file, as it was read."""
        return Scenario.read(self.path) if self.source is None else self.source

    @classmethod
    def read(
        cls,
        scenario: Path | str | Scenario | None,
        space: Path | str | None = None,
        ranges: Sequence[str] = (),
        continuous: bool = False,
    ) -> LogicalScenario:
        """Read a logical scenario.

        Parameters
        ----------
        scenario : path or Scenario, optional
            OpenSCENARIO file; without one it is the file that `space` names.
        space : path, optional
            ParameterValueDistribution file.
        ranges : sequence of str
            ``NAME=LOW:HIGH[:STEP]``; they add to the space or replace what it says.
        continuous : bool, default False
            Search ranges with steps as continuous intervals.

        Returns
        -------
        LogicalScenario

        Raises
        ------
        InputError
            A file cannot be used, nothing is varied, or a varied parameter is not declared in the scenario.

        Examples
        --------
        >>> from cornercase import LogicalScenario
        >>> folder = "examples/x_intersection/x_intersection"
        >>> logical = LogicalScenario.read(f"{folder}.xosc", f"{folder}.space.xosc")
        >>> [parameter.name for parameter in logical.space.parameters]
        ['ego_start', 'pedestrian_wait', 'p1_speed']
        """
        ranges = texts("ranges", ranges)
        files = XmlFiles()
        varied = None if space is None else ParameterSpace.from_file(path("space", space), files)
        if scenario is None:
            if space is None:
                more = _ENOUGH if ranges else ""
                raise InputError(
                    f"There is no scenario; name an OpenSCENARIO file, or a `space` file that names one{more}."
                )
            scenario = ParameterSpace.scenario_file(space, files)
        if ranges:
            varied = varied.with_ranges(ranges) if varied is not None else ParameterSpace.from_ranges(ranges)
        file = scenario if isinstance(scenario, Scenario) else Scenario.read(scenario)
        file.add_files(files)
        if varied is None:
            raise InputError(f"{file.path}: nothing is varied; give a `space` file, or `ranges` such as NAME=LOW:HIGH.")
        file.require_parameters(list(varied.assigns))
        varied = varied.continuous() if flag("continuous", continuous) else varied
        declarations = read_declarations(file.root, str(file.path))
        varied = varied.typed(declarations, str(file.path)).constrained(declarations, str(file.path))
        file = with_roads(file, varied)
        return cls(file.path, varied, file.fingerprint(), file)

    def concrete(self, values: Mapping[str, Value]) -> ConcreteScenario:
        """Return the concrete scenario of given values.

        Parameters
        ----------
        values : mapping of str to float or str
            By parameter; what is not given is as in the file.

        Returns
        -------
        ConcreteScenario
        """
        return ConcreteScenario(self.path, dict(values), self.source)
