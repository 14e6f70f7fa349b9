"""Concrete scenarios that contract checks run, chosen from a logical scenario."""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from lxml import etree
from scipy.stats import qmc

from cornercase._common.errors import SimulationError
from cornercase.exploration._paper_examples import examples_folder
from cornercase.recordings import Recording
from cornercase.scenario import ConcreteScenario, LogicalScenario
from cornercase.simulators import Simulator
from cornercase.simulators._create import create_simulator
from cornercase.simulators._results import check_simulator_accepts, run_scenarios
from cornercase.testing._small_scenarios import write_small_scenarios

N_CASES: Final = 4
"""Number of concrete scenarios of each logical scenario."""

N_UNDRIVEN_CASES: Final = 2
"""Number of concrete scenarios of each logical scenario, for slow simulators."""


@dataclass(frozen=True)
class Cases:
    """Concrete scenarios of one scenario file, to run in contract checks.

    Attributes
    ----------
    concretes : tuple of ConcreteScenario
        The scenarios, in the order in which they are run.
    entity : str
        Entity that a system under test drives.

    Examples
    --------
    >>> import cornercase as cc
    >>> from cornercase.testing import Cases
    >>> folder = "examples/x_intersection/x_intersection"
    >>> logical = cc.LogicalScenario.read(f"{folder}.xosc", f"{folder}.space.xosc")
    >>> cases = Cases.from_logical(logical, "Ego", count=2)
    >>> [recording.names[0] for recording in cases.run(duration=1.0)]
    ['Ego', 'Ego']
    """

    concretes: tuple[ConcreteScenario, ...]
    entity: str

    @classmethod
    def from_logical(cls, logical: LogicalScenario, entity: str, count: int = N_CASES) -> Cases:
        """Choose concrete scenarios that are spread evenly over the parameter space.

        Parameters
        ----------
        logical : LogicalScenario
            Without a parameter space, there is one concrete scenario, with the values in the file.
        entity : str
            Entity that a system under test drives.
        count : int, default 4
            Number of scenarios; fewer if the constraints of the space exclude more than 7 of 8 points.

        Returns
        -------
        Cases
        """
        logical.scenario_file.require_entity(entity, "driven entity")
        if not logical.space.dimension:
            return cls((logical.concrete_scenario({}),), entity)
        points = qmc.Sobol(logical.space.dimension, seed=0).random(8 * count)
        points = points[logical.space.is_admissible(points)][:count]
        return cls(tuple(map(logical.concrete_scenario, logical.space.values(points))), entity)

    def run(
        self,
        simulator: str | Simulator = "builtin",
        rows: Sequence[int] | None = None,
        *,
        workers: int = 1,
        **options: Any,
    ) -> list[Recording]:
        """Run all scenarios, or some of them.

        Parameters
        ----------
        simulator : str or Simulator, default "builtin"
            Simulator, or its name. Without `options`, a simulator object runs in this process and ignores `workers`.
        rows : sequence of int, optional
            Indices of the scenarios to run, in this order; by default all scenarios.
        workers : int, default 1
            Number of worker processes.
        **options
            Options of the simulator, such as ``duration=1.0``.

        Returns
        -------
        list of Recording
            Recording of each scenario, in the order of `rows`.

        Raises
        ------
        AssertionError
            A scenario failed.
        """
        recordings = list[Recording]()
        for outcome in self.outcomes(simulator, rows, workers=workers, **options):
            assert isinstance(outcome, Recording), f"A scenario failed: {outcome}."
            recordings.append(outcome)
        return recordings

    def outcomes(
        self,
        simulator: str | Simulator = "builtin",
        rows: Sequence[int] | None = None,
        *,
        workers: int = 1,
        **options: Any,
    ) -> list[Recording | SimulationError]:
        """Run all scenarios, or some of them; return an error for each scenario that fails.

        Parameters
        ----------
        simulator : str or Simulator, default "builtin"
            Simulator, or its name. Without `options`, a simulator object runs in this process and ignores `workers`.
        rows : sequence of int, optional
            Indices of the scenarios to run, in this order; by default all scenarios.
        workers : int, default 1
            Number of worker processes.
        **options
            Options of the simulator, such as ``duration=1.0``.

        Returns
        -------
        list of Recording or SimulationError
            Recording or error of each scenario, in the order of `rows`.
        """
        return list(self.iter_outcomes(simulator, rows, workers=workers, **options))

    def iter_outcomes(
        self,
        simulator: str | Simulator = "builtin",
        rows: Sequence[int] | None = None,
        *,
        workers: int = 1,
        **options: Any,
    ) -> Iterator[Recording | SimulationError]:
        """Run all scenarios, or some of them; yield an error for each scenario that fails.

        Parameters
        ----------
        simulator : str or Simulator, default "builtin"
            Simulator, or its name. Without `options`, a simulator object runs in this process and ignores `workers`.
        rows : sequence of int, optional
            Indices of the scenarios to run, in this order; by default all scenarios.
        workers : int, default 1
            Number of worker processes.
        **options
            Options of the simulator, such as ``duration=1.0``.

        Yields
        ------
        Recording or SimulationError
            Recording or error of each scenario, in the order of `rows`, as soon as the scenario has ended.
        """
        concretes = self.concretes if rows is None else [self.concretes[row] for row in rows]
        # An object runs itself, in this process.
        starting = (
            create_simulator(simulator, options, ego=self.entity, workers=workers)
            if options or isinstance(simulator, str)
            else simulator
        )
        with starting as started:
            check_simulator_accepts(started, [concretes[0].load_file()], concretes)
            # Limits that a driver exceeds are no breach of its contract.
            started.on_notice = _ignore_notice
            yield from run_scenarios(started, concretes)


def default_cases() -> list[Cases]:
    """Return scenarios that come with cornercase: a crossing pedestrian, and a leader that brakes."""
    folder = examples_folder()
    x_intersection = folder / "x_intersection" / "x_intersection.xosc"
    return [
        _choose_cases_from_file(x_intersection, [], x_intersection.with_suffix(".space.xosc")),
        _choose_cases_from_file(folder / "r157" / "deceleration.xosc", ["gap=20:60", "deceleration=2:6"]),
    ]


def write_cases_without_events(folder: Path) -> list[Cases]:
    """Return two scenarios without events, for simulators that do not run the storyboard; write files to a folder."""
    names = ("constant speed", "two that pass each other")
    return [Cases((concrete,), "Ego") for concrete in write_small_scenarios(folder, *names).values()]


def write_cases_without_drivers(folder: Path) -> list[Cases]:
    """Write the files of the default logical scenarios without drivers to a folder; return two concrete ones of each.

    The storyboard alone moves all entities. These scenarios are for simulators that are not deterministic. Such
    simulators are often slow, and drivers of these simulators would act differently in each run.
    """
    x_intersection = examples_folder() / "x_intersection" / "x_intersection.xosc"
    deceleration = examples_folder() / "r157" / "deceleration.xosc"
    crossing = LogicalScenario.read(
        _copy_without_elements(x_intersection, folder, "ObjectController"), x_intersection.with_suffix(".space.xosc")
    )
    braking = LogicalScenario.read(
        _copy_without_elements(deceleration, folder, "ObjectController"), ranges=["gap=20:60", "deceleration=2:6"]
    )
    return [Cases.from_logical(logical, "Ego", N_UNDRIVEN_CASES) for logical in (crossing, braking)]


def write_cases_without_limits(folder: Path) -> Cases:
    """Return scenarios of a cut-in whose vehicles have no speed and acceleration limits; write the file to a folder."""
    return _choose_cases_from_file(
        _copy_without_elements(examples_folder() / "r157" / "cut_in.xosc", folder, "Performance"), ["gap=10:40"]
    )


def _copy_without_elements(original: Path, folder: Path, tag: str) -> Path:
    """Copy a scenario file and its road to a folder, without XML elements `tag`; return the path of the file copy."""
    tree = etree.parse(original)
    for element in [*tree.iter(tag)]:
        parent = element.getparent()
        if parent is not None:
            parent.remove(element)
    copied = folder / original.name
    copied.write_bytes(etree.tostring(tree))
    for road in tree.iterfind("RoadNetwork/LogicFile"):
        shutil.copyfile(original.parent / road.get("filepath", ""), folder / road.get("filepath", ""))
    return copied


def _ignore_notice(sentence: str) -> None:
    """Ignore a notice of a simulator."""


def _choose_cases_from_file(path: Path, ranges: Sequence[str], space: Path | None = None) -> Cases:
    logical = LogicalScenario.read(path, space, ranges=list(ranges)) if ranges else LogicalScenario.read(path, space)
    return Cases.from_logical(logical, "Ego")
