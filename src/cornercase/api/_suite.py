"""Class `Suite` of the public API, which runs concrete scenarios and judges the runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Self

from cornercase._common.errors import hide_input_error_traceback
from cornercase._common.text.notebook_html import render_html_table
from cornercase._common.validation import check_path
from cornercase.api._simulator_settings import extract_exploration_settings
from cornercase.drivers._resolve import DriverLike, check_drivers
from cornercase.exploration import Runs
from cornercase.exploration._problem import suggest_arguments
from cornercase.exploration._runs import single_run_settings
from cornercase.metrics import Expression, Metric
from cornercase.simulators import Simulator
from cornercase.suite import Requirement, SuiteResult, run_suite
from cornercase.suite._read_suite import read_suite
from cornercase.suite._suite_contents import SuiteContents

if TYPE_CHECKING:
    import pandas as pd


class Suite:
    """Suite of concrete scenarios that versions of a system are tested with; make a suite with `open`.

    Parameters
    ----------
    path : path
        Folder of a reduced set (scenarios that `Study.reduce` selected) or its ``manifest.json``, any other folder of
        concrete scenarios, or one scenario file.
    ego : str, optional
        Name of the entity under test; by default the ego of the manifest.
    other : str or sequence of str, optional
        Entities that the ego is measured against; by default as in the manifest. If there are several entities, the
        most critical score counts. ``"*"`` stands for all other entities in the files.

    Attributes
    ----------
    path : Path
        The folder, manifest or scenario file.

    Raises
    ------
    InputError
        There is nothing to run, or a file cannot be used, is missing or has changed since the manifest was written.

    Examples
    --------
    >>> import cornercase as cc
    >>> result = cc.Suite.open("reduced").run(require=["no collision"])  # doctest: +SKIP
    >>> result.junit("out.xml")  # doctest: +SKIP
    PosixPath('out.xml')
    """

    def __init__(self, path: Path | str, *, ego: str | None = None, other: str | Sequence[str] | None = None) -> None:
        self.path = check_path("path", path)
        self._contents: SuiteContents = read_suite(self.path)
        self._ego, self._other = ego, other

    @classmethod
    @hide_input_error_traceback()
    @suggest_arguments
    def open(cls, path: Path | str, *, ego: str | None = None, other: str | Sequence[str] | None = None) -> Self:
        """Open a suite.

        Parameters
        ----------
        path : path
            Folder of a reduced set (scenarios that `Study.reduce` selected) or its ``manifest.json``, any other folder
            of concrete scenarios, or one scenario file.
        ego : str, optional
            Name of the entity under test; by default the ego of the manifest.
        other : str or sequence of str, optional
            Entities that the ego is measured against; by default as in the manifest. ``"*"`` stands for all other
            entities.

        Returns
        -------
        Suite

        Raises
        ------
        InputError
            There is nothing to run, or a file cannot be used, is missing or has changed since the manifest was written.
        """
        return cls(path, ego=ego, other=other)

    @hide_input_error_traceback()
    @suggest_arguments
    def run(
        self,
        study: Path | str | None = None,
        *,
        require: Sequence[str | Expression | Requirement] = (),
        requirements: Path | str | None = None,
        require_from_file: bool = False,
        metrics: Metric | str | Sequence[Metric | str] = (),
        simulator: Simulator | str | None = None,
        drivers: Mapping[str, DriverLike] | None = None,
        runs: Runs | None = None,
        against: Path | str | None = None,
        mutants: int | None = None,
        seed: int = 0,
        progress: bool = False,
    ) -> SuiteResult:
        """Run the scenarios, judge the runs by requirements, and compare the recordings with earlier recordings.

        Each run is stored as soon as it has ended. The same call again continues after an interruption. A call with
        other requirements judges the stored runs and runs nothing again, unless these name a metric of the ego alone
        that was not measured.

        Parameters
        ----------
        study : path, optional
            Study to create or continue; by default ``FOLDER.run.db`` beside the folder of the suite, or
            ``suite.run.db`` in the current folder if this is the folder of the suite. Name another study for each other
            driver or simulator.
        require : sequence of str, Expression or Requirement
            Requirements on each scenario, as `cornercase.suite.Requirement.parse` reads them.
        requirements : path, optional
            TOML or YAML file with further requirements.
        require_from_file : bool, default False
            Scenario files can contain criteria for CARLA's ScenarioRunner; use these criteria as requirements, too. A
            notice names the criteria that cannot be decided from a recording.
        metrics : Metric or str, or sequence of these
            Criticality metrics to store; give a metric of your own as an object. By default the metrics of the
            manifest; without a manifest the metrics in the requirements, or else ``clearance``.
        simulator : Simulator or str, optional
            By default the simulator of the manifest; without a manifest the builtin simulator.
        drivers : mapping of str to str, SystemUnderTest, Driver or Behaviour, optional
            Drivers by entity: the name of a preset, ``package.module:Class``, or an object. A name may be followed by
            a colon and options. By default the drivers in the files.
        runs : Runs, optional
            Where scenarios are run, and what happens if a simulator dies or hangs. Each scenario is run once.
        against : path, optional
            Study with earlier recordings: the study that was reduced, or an earlier run of the suite. By default the
            study that was reduced, if its file is in the folder of the manifest or in the parent folder.
        mutants : int, optional
            Number of mutants (faulty variants) of the ego's driver that the scenarios are also run with. The result
            says how many mutants violate a requirement: see `cornercase.suite.run_suite`.
        seed : int, default 0
            The same seed gives the same mutants.
        progress : bool, default False
            Show progress.

        Returns
        -------
        SuiteResult

        Raises
        ------
        InputError
            An argument or file cannot be used, a file of the manifest is missing or has changed, no scenario can be
            run, or the study belongs to another suite or other settings.

        Warns
        -----
        NoticeWarning
            Something in the files has no effect in the simulator.
        """
        fields = {} if simulator is None else extract_exploration_settings(simulator)
        fields["drivers"] = {**fields.get("drivers", {}), **check_drivers(drivers)}
        return run_suite(
            self.path,
            self._default_study() if study is None else study,
            require=require,
            requirements=requirements,
            require_from_file=require_from_file,
            ego=self._ego,
            other=self._other,
            metrics=metrics,
            **fields,
            **single_run_settings(runs, "a suite"),
            against=against,
            mutants=mutants,
            seed=seed,
            progress=progress,
        )

    def _default_study(self) -> Path:
        folder = self._contents.folder
        if not folder.name:
            return folder / "suite.run.db"
        # The parent of the path `..` would be the current folder.
        parent = folder / ".." if folder.name == ".." else folder.parent
        return parent / f"{folder.resolve().name}.run.db"

    def table(self) -> pd.DataFrame:
        """Make a table of the scenarios.

        Returns
        -------
        DataFrame
            One row per scenario. The index is the id, from 1, that the scenario gets in the study of a run. Columns:
            ``file``, ``kind`` (the cluster that the scenario represents), ``role``, ``why`` (the reason for its
            selection), and ``error`` (why the scenario cannot be run). Unknown values are empty.
        """
        import pandas as pd

        columns = {"file": "file_name", "kind": "cluster_name", "role": "role", "why": "selection_reason"}
        return pd.DataFrame(
            [
                {name: getattr(scenario, attribute) for name, attribute in columns.items()} | {"error": scenario.error}
                for scenario in self._contents.scenarios
            ],
            index=pd.RangeIndex(1, len(self._contents.scenarios) + 1, name="id"),
        )

    def __repr__(self) -> str:
        return f"<Suite {str(self.path)!r}: {len(self._contents.scenarios)} scenarios>"

    def _repr_html_(self) -> str:
        """Return a table of the scenarios as HTML, for notebooks."""
        return render_html_table(repr(self), self.table(), n_rows=len(self._contents.scenarios))
