"""Class `Study` of the public API, which searches, clusters, reduces and reports scenarios."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Self

from cornercase._common.errors import InputError, hide_input_error_traceback
from cornercase._common.io.files import check_writable_file
from cornercase._common.io.support_table import issue_each_notice_once
from cornercase._common.memory import DEFAULT_MEMORY
from cornercase._common.progress import can_show_bar
from cornercase._common.text.notebook_html import render_html, render_html_table
from cornercase._common.typing import FloatArray
from cornercase._common.unknown_names import ATTRIBUTE_SYNONYMS, unknown_attribute_error
from cornercase._common.validation import check_int, check_path
from cornercase.api._simulator_settings import extract_exploration_settings
from cornercase.api._written_page import Page
from cornercase.exploration import Estimation, ExplorationResult, Problem, Runs
from cornercase.exploration._best_scores import is_on_pareto_front
from cornercase.exploration._config import ExplorationConfig, config_from_study, simulator_from_study
from cornercase.exploration._explore import explore_config, simulator_from_config
from cornercase.exploration._explore_options import read_stored_search_options
from cornercase.exploration._problem import (
    config_from_problem,
    problem_from_study,
    rename_arguments_in_errors,
    suggest_arguments,
)
from cornercase.exploration._runs import run_settings, single_run_settings
from cornercase.metrics._own_metrics import as_metric_tuple
from cornercase.optimizers._stored_optimizer import known_optimizer
from cornercase.study import StudyFile, StudyMeta
from cornercase.study._study_file import open_study

if TYPE_CHECKING:
    import pandas as pd
    from distributed import Client

    from cornercase import stop as stop_rules
    from cornercase.clustering import Analysis, ClusteringMethod
    from cornercase.evidence import Sensitivity
    from cornercase.optimizers import Optimizer
    from cornercase.recordings import Recording
    from cornercase.reduction import ArchetypeMethod, KillMatrix, ReducedSet
    from cornercase.report import CriticalEstimates, Summary
    from cornercase.simulators import Simulator


class Study(PathLike[str]):
    """Search of a logical scenario, with all runs and results in one file; make a study with `create` or `open`.

    Each method opens the file only while the method runs. So nothing has to be closed, and several processes can use
    one study. Functions that take the path of a study also take a `Study`.

    Parameters
    ----------
    path : path
        SQLite file.
    problem : Problem, optional
        Search problem; by default the problem stored in the file.
    simulator : Simulator or str, optional
        Simulator that runs the scenarios; by default the simulator stored in the file.
    seed : int, optional
        The same seed gives the same result; by default the seed stored in the file.
    scenario : path, optional
        OpenSCENARIO file that was explored; by default the file is searched as `open` describes.

    Attributes
    ----------
    path : Path
        SQLite file.

    See Also
    --------
    cornercase.study.StudyFile : Reads everything that is in the file.

    Examples
    --------
    >>> import cornercase as cc
    >>> folder = "examples/x_intersection/x_intersection"
    >>> scenario = cc.LogicalScenario.read(f"{folder}.xosc", f"{folder}.space.xosc")
    >>> problem = cc.Problem(scenario, ego="Ego", other="Pedestrian", metrics=["wttc"], threshold=0.2)
    >>> study = cc.Study.create("study.db", problem, cc.simulators.Builtin(), seed=1)
    >>> study.explore(cc.optimizers.Sobol(), budget=4)
    <ExplorationResult: 4 scenarios done in study.db; the budget of 4 scenarios is used up>
    >>> study.recording(study.table().index[0])
    <Recording of Ego (car), Truck (truck), C (car), Pedestrian (pedestrian), 16.45 s in 330 instants, no collision>
    """

    def __init__(
        self,
        path: Path | str,
        problem: Problem | None = None,
        simulator: Simulator | str | None = None,
        *,
        seed: int | None = None,
        scenario: Path | str | None = None,
    ) -> None:
        self.path = check_path("path", path)
        self._problem, self._seed = problem, None if seed is None else check_int("seed", seed, 0)
        self._simulator, self._simulator_settings = (
            simulator,
            {} if simulator is None else extract_exploration_settings(simulator),
        )
        self._scenario = None if scenario is None else check_path("scenario", scenario)
        self._issued_notices: set[str] = set()

    @classmethod
    @suggest_arguments
    def create(
        cls, path: Path | str, problem: Problem, simulator: Simulator | str = "builtin", *, seed: int = 0
    ) -> Self:
        """Create a study in a new file.

        All arguments are checked now. The file is written later, by `explore`.

        Parameters
        ----------
        path : path
            File to create.
        problem : Problem
            Search problem.
        simulator : Simulator or str, default "builtin"
            Simulator of `cornercase.simulators`, or its name with options after a colon. A simulator object also
            contains the drivers of the entities.
        seed : int, default 0
            The same seed gives the same result.

        Returns
        -------
        Study

        Raises
        ------
        InputError
            The file exists already or cannot be written, or an argument cannot be used.

        See Also
        --------
        open_or_create : Opens the study if the file exists, so that a script can be run again.
        """
        study = cls._from_problem(path, problem, simulator, seed)
        if study.path.exists():
            raise InputError(
                f"{study.path}: exists already; continue it with `Study.open_or_create`, or name another file."
            )
        check_writable_file("path", study.path)
        return study

    @classmethod
    @suggest_arguments
    def open(
        cls, path: Path | str, simulator: Simulator | str | None = None, *, scenario: Path | str | None = None
    ) -> Self:
        """Open an existing study.

        Problem, simulator and seed are read from the file. The attribute `simulator` has the parts of the simulator
        that the file stores: name, time step, longest duration, effect of collisions, numeric options, and the drivers
        of cornercase with their options.

        Code that the file names is never run. To run further scenarios, give `simulator` again if a driver or the
        simulator is Python code of your own, or if an option of the simulator is a text, such as a path or an address.
        If a metric is Python code of your own, use `open_or_create` instead. Results can be read without such code.

        Parameters
        ----------
        path : path
            File of the study.
        simulator : Simulator or str, optional
            Simulator that runs further scenarios, with all its options and drivers; by default the simulator of the
            study.
        scenario : path, optional
            OpenSCENARIO file that was explored. By default the file is searched at the path stored in the study, at the
            path where this machine explored it, in the folder of the study, and in the current folder. In both folders
            the search goes down to two levels of subfolders. The first file whose fingerprint matches the study is
            taken.

        Returns
        -------
        Study

        Raises
        ------
        InputError
            There is no such file, it is not a study, or it is damaged.
        """
        study = cls(path, None, simulator, scenario=scenario)
        if not study.path.exists():
            raise InputError(f"{study.path}: there is no such study; make one with `Study.create`.")
        with study._read():
            return study

    @classmethod
    @suggest_arguments
    def open_or_create(
        cls, path: Path | str, problem: Problem, simulator: Simulator | str = "builtin", *, seed: int = 0
    ) -> Self:
        """Open the study if the file exists, and create it otherwise, so that a notebook can be run again.

        Parameters
        ----------
        path : path
            File of the study.
        problem : Problem
            Search problem.
        simulator : Simulator or str, default "builtin"
            Simulator of `cornercase.simulators`, or its name with options after a colon. A simulator object also
            contains the drivers of the entities.
        seed : int, default 0
            The same seed gives the same result.

        Returns
        -------
        Study

        Raises
        ------
        InputError
            The existing study belongs to another problem, simulator or seed, or an argument cannot be used.
        """
        study = cls._from_problem(path, problem, simulator, seed)
        if not study.path.exists():
            check_writable_file("path", study.path)
            return study
        with study._read() as file, rename_arguments_in_errors():
            config = study._make_config(file.meta)
            with simulator_from_config(config) as configured:
                settings = configured.settings
            meta = config.make_study_meta(config.make_objective(), settings, file.meta.elsewhere, study=study.path)
            file.meta.require_resumable(meta, study.path)
        return study

    @classmethod
    def _from_problem(cls, path: Path | str, problem: Problem, simulator: Simulator | str, seed: int) -> Self:
        if not isinstance(problem, Problem):
            raise InputError(f"`problem`: give a Problem, not a {type(problem).__name__}.")
        study = cls(path, problem, simulator, seed=seed)
        with rename_arguments_in_errors():
            config = study._make_config(None)
            config.require_entities()
            # It only describes the simulator, and checks options and drivers.
            simulator_from_config(config).close()
        return study

    def __fspath__(self) -> str:
        return str(self.path)

    if not TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any:
            if name in ATTRIBUTE_SYNONYMS:
                raise unknown_attribute_error("'Study' object", name)
            # Also raises the error of a property.
            return object.__getattribute__(self, name)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        """Do nothing: no file is open between two method calls."""

    @property
    def problem(self) -> Problem:
        """Search problem of the study; for an opened study, this reads the scenario file.

        Raises `InputError` if the study has no search problem, as after an import of recordings or in the run of a
        suite.
        """
        if self._problem is not None:
            return self._problem
        with self._read() as file, rename_arguments_in_errors():
            return problem_from_study(file, self._scenario)

    @property
    def seed(self) -> int:
        """Seed of the search."""
        if self._seed is None:
            with self._read() as file:
                self._seed = file.meta.seed
        return self._seed

    @property
    def simulator(self) -> Simulator | str:
        """Simulator that runs the scenarios, as it was given; for an opened study, made from the settings in the file.

        The simulator can also be used for another study. Raises `InputError` if the file does not hold all of the
        simulator, because a driver or the simulator is Python code of your own, or an option of the simulator is a
        text. Then give the simulator to `open`.
        """
        if self._simulator is not None:
            return self._simulator
        with rename_arguments_in_errors(), self._read() as file:
            return simulator_from_study(file.meta, self.path)

    @property
    def optimizer(self) -> str | None:
        """Optimizer that proposed the scenarios, as text; None if no scenario was run yet.

        For imported recordings and for runs of a suite, the text is ``"none"``.
        """
        if not self.path.exists():
            return None
        with self._read() as file:
            return file.meta.optimizer

    def __len__(self) -> int:
        if not self.path.exists():
            return 0
        with self._read() as file:
            return len(file.rows())

    def __bool__(self) -> bool:
        return True

    @suggest_arguments
    def explore(
        self,
        optimizer: Optimizer | str | None = None,
        *,
        budget: int | None = None,
        stop: stop_rules.StopRule | str | Sequence[stop_rules.StopRule | str] = (),
        runs: Runs | None = None,
        batch: int | None = None,
        asynchronous: bool | None = None,
        audit: float | None = None,
        warm_start: Study | Path | str | None = None,
        retry_failed: bool = False,
        progress: bool | None = None,
    ) -> ExplorationResult:
        """Search for critical concrete scenarios.

        Each scenario is stored as soon as it has ended. The same call again resumes an interrupted search. With a
        larger `budget`, a finished search goes on.

        Parameters
        ----------
        optimizer : Optimizer or str, optional
            Optimizer of `cornercase.optimizers`, or its name with options after a colon: ``"level-set:filling=0.1"``.
            By default ``Auto()``, or ``Bayes()`` if no threshold or condition says what is critical. If the study was
            searched before, `optimizer`, `budget`, `batch`, `asynchronous`, `audit`, and the numbers of repeats in
            `runs` default to those of the earlier search.
        budget : int, optional
            Number of scenarios in total, including those that were run before; 200 by default.
        stop : StopRule or str, or sequence of these
            Rules of `cornercase.stop` that end the search before the budget is used up: when the critical set is known
            well enough (``stop.missed(0.05)``), after a time, or when there is no improvement. A sequence combines
            rules, as in ``[stop.missed(0.1), stop.seconds(60)]``. Rules about the critical set end the search only when
            all of them hold; each other rule ends the search by itself. For a rule of your own, call `explore` in a
            loop with a growing `budget`, and end the loop yourself.
        runs : Runs, optional
            How scenarios are run.
        batch : int, optional
            Number of scenarios per round; 10 by default.
        asynchronous : bool, optional
            Propose the next scenario as soon as one has ended, instead of in rounds.
        audit : float, optional
            Fraction of the scenarios, up to 0.5, that are drawn at random and hidden from the optimizer, as a check of
            the search.
        warm_start : Study or path, optional
            Earlier study with the same parameters, but another driver, simulator or time step; the search begins with
            the scores of the earlier study. The ranges may differ: earlier scenarios outside of the new ranges are left
            out. Metrics that the earlier study lacks, or has measured against other entities, are measured from its
            recordings. A condition that says what is critical must be the same in both studies. At least 10 scores are
            needed, and they must not all be equal. ``LevelSet()``, ``Committee()`` and ``Auto()`` learn from an earlier
            study.
        retry_failed : bool, default False
            Run the failed scenarios of the study again before the search goes on.
        progress : bool, optional
            Show a progress bar; by default in notebooks and terminals.

        Returns
        -------
        ExplorationResult

        Raises
        ------
        InputError
            An argument cannot be used, or the study belongs to another exploration. The study is left unchanged.
        KeyboardInterrupt
            The search was interrupted; scenarios that have ended are stored.

        Warns
        -----
        NoticeWarning
            Something in the scenario's files has no effect in the simulator.
        """
        settings = {
            "optimizer": optimizer,
            "budget": budget,
            "stop_when": stop,
            "batch": batch,
            "asynchronous": asynchronous,
            "audit": audit,
            "warm_start": None if warm_start is None else check_path("warm_start", warm_start),
            **run_settings(runs),
        }
        with rename_arguments_in_errors():
            meta = None
            if self.path.exists():
                with self._read() as file:
                    meta = file.meta
            config = self._make_config(meta, **{key: value for key, value in settings.items() if value is not None})
            with issue_each_notice_once(self._issued_notices):
                result = explore_config(
                    config,
                    self.path,
                    can_show_bar() if progress is None else progress,
                    retry_failed=retry_failed,
                )
        if result.interrupted:
            # What follows in a script or notebook is not done with half a search.
            raise KeyboardInterrupt(f"Interrupted after {result.n_finished} scenarios. The same call again resumes.")
        return result

    @suggest_arguments
    def cluster(
        self,
        by: str | Sequence[str] | None = None,
        *,
        gamma: float | Literal["auto"] = "auto",
        eps: float | Literal["auto"] = "auto",
        min_samples: int | Literal["auto"] = "auto",
        method: ClusteringMethod | None = None,
        window: float | None = None,
        keep_clusters: bool = False,
        threshold: float | None = None,
        workers: int = 1,
        cluster: str | Client | None = None,
        memory: str | float = DEFAULT_MEMORY,
        progress: bool = False,
    ) -> dict[str, Analysis]:
        """Cluster the scenarios by behaviour and by criticality, and store the result.

        Scenarios are compared by several *aspects*, one at a time: how the ego moved, in which direction the ego saw
        the other entity, how critical each instant was. For each aspect, Dynamic Time Warping gives distances between
        scenarios, and the clusters are found from these distances.

        Parameters
        ----------
        by : str or sequence of str, optional
            Aspects: names in `cornercase.clustering.ASPECTS`, and names of metrics of the study. By default
            ``"ego-trajectory"``, ``"bearing"`` (the direction in which the ego sees the other), ``"interaction"`` (both
            motions), and all metrics of the study.
        gamma, eps : float or "auto", default "auto"
            Width of the kernel, and radius of a neighbourhood in kernel space; both without unit.
        min_samples : int or "auto", default "auto"
            Smallest number of scenarios in a dense neighbourhood.
        method : {"dbscan", "hdbscan"}, optional
            Algorithm that finds the clusters; by default DBSCAN.
        window : float, optional
            Largest time difference in s of two instants that Dynamic Time Warping matches. If one recording is longer
            than the other, the difference of their lengths is added. By default there is no limit.
        keep_clusters : bool, default False
            Keep the existing clusters, and assign scenarios that were run since to these clusters.
        threshold : float, optional
            Score from which a scenario is critical; clusters are compared with the critical scenarios. By default the
            threshold of the study.
        workers : int, default 1
            Number of processes of a local Dask cluster.
        cluster : str or distributed.Client, optional
            Dask cluster that computes the distances: ``"local"`` for `workers` local processes, the address of a
            scheduler, the file that a scheduler wrote, or a client.
        memory : str or float, default "4 GB"
            Memory limit of the process, in bytes or as text.
        progress : bool, default False
            Show a progress bar.

        Returns
        -------
        dict of str to Analysis
            Clusters of each aspect.

        Raises
        ------
        InputError
            Fewer than two scenarios were run, the study cannot be compared by an aspect, a setting is out of range or
            would change clusters that are kept, or the series exceed the memory limit.

        See Also
        --------
        cornercase.clustering.analyze : Says how scenarios are compared.
        """
        from cornercase.clustering import analyze

        with rename_arguments_in_errors():
            return analyze(
                self._file,
                by,
                gamma=gamma,
                eps=eps,
                min_samples=min_samples,
                method=method,
                window=window,
                keep_clusters=keep_clusters,
                critical=threshold,
                workers=workers,
                cluster=cluster,
                memory=memory,
                progress=progress,
            )

    @suggest_arguments
    def reduce(
        self,
        folder: Path | str,
        *,
        size: int | None = None,
        share: float | None = None,
        cover: float | None = None,
        archetypes: int | Literal["auto"] | None = None,
        archetypes_by: ArchetypeMethod = "auto",
        by: str | None = None,
        within: float | None = None,
        threshold: float | None = None,
        kill_matrix: KillMatrix | None = None,
        memory: str | float = DEFAULT_MEMORY,
        progress: bool = False,
    ) -> ReducedSet:
        """Select the few scenarios that matter, and write them as OpenSCENARIO files that run on their own.

        The study has to be clustered before. Scenarios that were run since then are not represented.

        Parameters
        ----------
        folder : path
            Folder to write, with a manifest. An earlier reduced set in the folder is replaced.
        size : int, optional
            Number of scenarios to select. Without `size`, `share`, `cover` and `archetypes`, a tenth of the scenarios
            is selected.
        share : float, optional
            Fraction of the scenarios to select, above 0 and up to 1.
        cover : float, optional
            Select the prototypes, then always the scenario that is least similar to all selected ones, until the
            distance of each scenario to the nearest selected scenario is at most this fraction of the largest distance.
        archetypes : int or "auto", optional
            Select from each cluster only the prototype (most central scenario) and at most this number of archetypes
            (extreme scenarios), as in the paper that cornercase follows.
        archetypes_by : {"auto", "hull", "pcha", "parts", "kernel"}, default "auto"
            Method that finds archetypes; see `cornercase.reduction.reduce`.
        by : str, optional
            Aspect (what scenarios are compared by) whose clusters are represented; by default the aspect whose clusters
            say most about how scenarios end. ``"bands:METRIC"`` represents bands of high, medium and low criticality by
            a metric instead.
        within : float, optional
            Distance up to which scenarios count as similar, as fraction of the median distance within clusters; 0.5 by
            default.
        threshold : float, optional
            Score from which a scenario is critical, for selection and evaluation; by default the threshold of the
            study.
        kill_matrix : KillMatrix, optional
            Matrix from `cornercase.suite.analyze_mutants`, which says which scenarios kill which mutants (faulty
            variants of the driver). Scenarios that together kill as many mutants as possible are selected first.
        memory : str or float, default "4 GB"
            Memory limit of the process, in bytes or as text.
        progress : bool, default False
            Show a progress bar for steps that take more than two seconds.

        Returns
        -------
        ReducedSet
            The selected scenarios, why each was selected, and how well they cover the others.

        Raises
        ------
        InputError
            The study was not clustered, an argument is out of range, the scenario file is missing or differs from the
            explored file, or the folder cannot be written.

        Warns
        -----
        NoticeWarning
            Fewer scenarios than requested were selected, since all others are similar to a selected scenario. Or
            scenarios that were run after `cluster` are left out; call `cluster` again, with ``keep_clusters=True`` to
            keep the clusters.

        See Also
        --------
        cornercase.reduction.reduce : Says how scenarios are selected.
        """
        from cornercase.reduction import reduce

        similarity = {} if within is None else {"within": within}
        with rename_arguments_in_errors():
            return reduce(
                self._file,
                folder,
                by=by,
                size=size,
                share=share,
                cover=cover,
                archetypes=archetypes,
                archetypes_by=archetypes_by,
                critical=threshold,
                kill_matrix=kill_matrix,
                scenario=self._scenario_path(),
                memory=memory,
                progress=progress,
                **similarity,
            )

    @suggest_arguments
    def report(
        self,
        path: Path | str,
        *,
        figures: Path | str | bool = False,
        threshold: float | None = None,
        memory: str | float = DEFAULT_MEMORY,
        progress: bool = False,
    ) -> Page:
        """Write the report as one HTML page without external references.

        Parameters
        ----------
        path : path
            Page to write; ends with ``.html``.
        figures : bool or path, default False
            Also write the figures as PNG and SVG into this folder; True for a folder beside the page.
        threshold : float, optional
            Score from which a scenario is critical; by default the threshold of the study.
        memory : str or float, default "4 GB"
            Memory limit of the process, as ``"500 MB"`` or in bytes.
        progress : bool, default False
            Show a progress bar for steps that take more than two seconds.

        Returns
        -------
        Page
            The written page; a notebook shows it.

        Raises
        ------
        InputError
            No scenario has ended, `path` is the study itself, a file cannot be written, or the report exceeds the
            memory limit.
        """
        from cornercase.report import write_report

        with rename_arguments_in_errors():
            return Page(
                write_report(
                    self._file,
                    path,
                    figures=figures,
                    scenario=self._scenario_path(),
                    critical=threshold,
                    memory=memory,
                    progress=progress,
                )
            )

    @suggest_arguments
    def watch(
        self,
        *,
        port: int = 0,
        host: str = "127.0.0.1",
        browser: bool = False,
        show: Callable[[str], object] = print,
    ) -> None:
        """Serve the report as a live page that grows with the study, until Ctrl-C.

        Parameters
        ----------
        port : int, default 0
            Port of the page; 0 for a free one.
        host : str, default "127.0.0.1"
            Address of the network interface. With another interface than the default, other machines can connect if
            they know the token in the address of the page.
        browser : bool, default False
            Open the page in the browser.
        show : callable, default print
            Called with a sentence that contains the address of the page.

        Raises
        ------
        InputError
            The extra ``live`` is not installed, the address cannot be served, the file is not a study, or no scenario
            was run yet.
        """
        from cornercase.report import watch

        watch(self._file, port=port, host=host, scenario=self._scenario_path(), browser=browser, show=show)

    @suggest_arguments
    def replay(
        self,
        scenario: int,
        path: Path | str,
        *,
        next_to: int | None = None,
        fps: float | None = None,
        speed: float = 1.0,
        threshold: float | None = None,
        progress: bool = False,
    ) -> Page:
        """Write the replay of a scenario: the motion of all entities on the road, and how critical it is.

        Parameters
        ----------
        scenario : int
            Id of the scenario, as in the index of `table`.
        path : path
            ``.html`` for a page to play, scrub and zoom in any browser; ``.gif`` or ``.mp4`` for a film.
        next_to : int, optional
            Id of a second scenario, shown at the same time beside the first.
        fps : float, optional
            Frames per second of a film: for MP4 at most 60, by default 25; for GIF at most 50, by default 10.
        speed : float, default 1
            Speed of a film: 0.5 shows 1 s of the recording in 2 s.
        threshold : float, optional
            Score from which a scenario is critical; by default the threshold of the study.
        progress : bool, default False
            Show a progress bar.

        Returns
        -------
        Page
            The written file; a notebook shows a page.

        Raises
        ------
        InputError
            A scenario does not exist, failed or was not run yet; the file ending is unknown; `fps` or `speed` is given
            for a page; ffmpeg is missing for an ``.mp4``; or the file cannot be written.
        """
        from cornercase.report import replay

        with rename_arguments_in_errors():
            return Page(
                replay(
                    self._file,
                    scenario,
                    path,
                    beside=next_to,
                    fps=fps,
                    speed=speed,
                    scenario=self._scenario_path(),
                    critical=threshold,
                    progress=progress,
                )
            )

    @suggest_arguments
    def estimate(
        self,
        path: Path | str,
        *,
        budget: int = 2000,
        threshold: float | None = None,
        encounter: float = 10.0,
        seed: int = 0,
        runs: Runs | None = None,
        progress: bool = False,
    ) -> Estimation:
        """Estimate the probability of critical scenarios and collisions under the distributions of the parameters.

        New scenarios are run and stored in a study of their own. The same call again resumes an interrupted estimate.

        Parameters
        ----------
        path : path
            Study of the estimate, to create or resume. The study that was explored is only read.
        budget : int, default 2000
            Number of scenarios in total, 100 or more. At most 40 % of the budget of the first call are used to learn
            where critical scenarios are frequent.
        threshold : float, optional
            Score from which a scenario is critical; by default the threshold of the study.
        encounter : float, default 10.0
            Largest gap in m between the bounding boxes of ego and other entity that counts as an encounter.
        seed : int, default 0
            The same seed gives the same result.
        runs : Runs, optional
            How scenarios are run; each scenario is run once.
        progress : bool, default False
            Show a progress bar.

        Returns
        -------
        Estimation
            Probabilities of critical scenarios, collisions and encounters, with intervals. `Estimation` says which
            scenarios each probability comes from.

        Raises
        ------
        InputError
            An argument cannot be used, the study has no threshold or cannot be used for an estimate, or `path` holds
            another study.

        See Also
        --------
        cornercase.exploration.estimate : Says how scenarios are drawn.
        """
        from cornercase.exploration import estimate

        with rename_arguments_in_errors():
            return estimate(
                self._file,
                path,
                budget=budget,
                critical=threshold,
                encounter=encounter,
                seed=seed,
                scenario=self._scenario_path(),
                simulator=self._simulator_settings.get("simulator"),
                drivers=self._simulator_settings.get("drivers"),
                metrics=() if self._problem is None else as_metric_tuple(self._problem.metrics),
                **single_run_settings(runs, "an estimate"),
                progress=progress,
            )

    def table(self) -> pd.DataFrame:
        """Make a table of all scenarios.

        Returns
        -------
        DataFrame
            One row per scenario, indexed by its id: ``round``, ``state``, the parameters, the score by each metric (in
            the unit ``cornercase.metrics.METRICS.create(name).unit``), ``objective`` (the sum that was minimized, if
            the problem has `weights`), ``critical`` (True if the scenario is critical; only if the study has a
            threshold or condition), ``collision`` (the entity that the ego collides with first), ``impact speed`` in
            m/s, and ``error`` if the scenario failed. After clustering, ``cluster by …`` (-1 for noise) and ``outcome``
            follow, and ``note`` if there are notes. `cornercase.study.StudyFile.table` lists all other columns; its
            table lacks ``critical``, as do the tables that `export` writes.

        Examples
        --------
        The critical scenarios, and how many of them are collisions::

            table = study.table()
            table[table["critical"].fillna(False)]["collision"].notna().sum()
        """
        with self._read() as file, file.snapshot():
            return _table_with_critical(file)

    @suggest_arguments
    def most_critical(self, n: int = 10, metric: str | None = None) -> pd.DataFrame:
        """Make a table of the most critical scenarios.

        Many scenarios may have the same score, such as a time to collision of 0 s. Among scenarios with the same score,
        scenarios in which the ego collides come first, the highest speed at contact before lower speeds.

        Parameters
        ----------
        n : int, default 10
            Largest number of rows.
        metric : str, optional
            By default the objective of the search: the first metric of the study, or the weighted sum. If a Pareto
            front was searched, the first metric; see `pareto_front`.

        Returns
        -------
        DataFrame
            Rows of `table`, the most critical scenario first.

        Raises
        ------
        InputError
            No scenario was run, or the study has no such metric.
        """
        count = check_int("n", n, 1)
        with self._read() as file, file.snapshot():
            return _table_with_critical(file).loc[file.most_critical(metric)[:count]]

    def pareto_front(self) -> pd.DataFrame:
        """Make a table of the scenarios on the Pareto front.

        A scenario is on the front if no other scenario is at least as critical by every metric, and more critical by at
        least one metric.

        Returns
        -------
        DataFrame
            Rows of `table`, the most critical scenario by the first metric first.

        Raises
        ------
        InputError
            No scenario was run, or no Pareto front was searched.
        """
        with self._read() as file, file.snapshot():
            if not file.meta.pareto:
                raise InputError(
                    f"{self.path}: no Pareto front was searched; use `most_critical`, or search a"
                    " Problem(…, pareto=True)."
                )
            is_on_front = is_on_pareto_front(file.objective.minimized_scores(file))
            front = {row.id for row, on in zip(file.finished_rows(), is_on_front, strict=True) if on}
            return _table_with_critical(file).loc[[scenario for scenario in file.most_critical() if scenario in front]]

    @suggest_arguments
    def recording(self, scenario: int) -> Recording:
        """Read the recording of a scenario.

        Parameters
        ----------
        scenario : int
            Id of the scenario, as in the index of `table`.

        Returns
        -------
        Recording

        Raises
        ------
        InputError
            The scenario has not run, or its id is not an integer.
        """
        with self._read() as file:
            return file.recording(scenario)

    @suggest_arguments
    def course(self, scenario: int, metric: str | None = None) -> FloatArray:
        """Read the course of a metric over time in a scenario.

        Parameters
        ----------
        scenario : int
            Id of the scenario, as in the index of `table`.
        metric : str, optional
            By default the first metric of the study.

        Returns
        -------
        ndarray of float64, shape (T,)
            Values in the metric's unit at the T times of `recording`: NaN while the metric is not defined, ``inf``
            while the event that the metric predicts, such as a contact, never comes. The values are not clipped to the
            metric's cap (its least critical value), unlike scores and courses that are compared. With several other
            entities, the course is measured against the entity for which the scenario is most critical.

        Raises
        ------
        InputError
            The scenario has not run, or the study has no such metric.
        """
        with self._read() as file:
            return file.course(scenario, file.meta.metrics[0] if metric is None else metric)

    @suggest_arguments
    def critical_set(self, *, threshold: float | None = None) -> CriticalEstimates:
        """Estimate which fraction of the parameter space is critical, and how much of the critical part was missed.

        Parameters
        ----------
        threshold : float, optional
            Score from which a scenario is critical; by default the threshold of the study.

        Returns
        -------
        CriticalEstimates
            The estimates, with intervals or the reasons why there are no intervals.

        Raises
        ------
        InputError
            No scenario was run, there is no threshold, or a Pareto front was searched.
        """
        from cornercase.report._estimates import estimate_critical

        with self._read() as searched:
            if searched.meta.pareto:
                raise InputError(
                    f"{self.path}: a Pareto front was searched, which has no critical set; use `pareto_front`, or"
                    " search a Problem with one metric or with `weights`."
                )
        with (
            rename_arguments_in_errors(),
            open_study(self._file, readonly=True, critical=threshold) as file,
            file.snapshot(),
        ):
            estimates = estimate_critical(file)
            if estimates is None:
                raise InputError(_describe_unknown_critical(file))
        return estimates

    @suggest_arguments
    def sensitivity(self) -> Sensitivity:
        """Estimate how much of the variance of the objective's score each parameter explains.

        Returns
        -------
        Sensitivity

        Raises
        ------
        InputError
            Fewer than 10 scenarios were run, all scores are equal, or a Pareto front was searched.
        """
        from cornercase.report._estimates import estimate_study_sensitivity

        with self._read() as file, file.snapshot():
            if file.meta.pareto:
                raise InputError(
                    f"{self.path}: a Pareto front was searched; sensitivities need a study with one score (without"
                    " `pareto`)."
                )
            try:
                return estimate_study_sensitivity(file)
            except InputError:
                raise
            except ValueError as error:
                raise InputError(
                    f"{self.path}: sensitivities need 10 scenarios or more with different scores."
                ) from error

    @suggest_arguments
    def summary(self, *, threshold: float | None = None) -> Summary:
        """Summarize what was run and what was found, with all stored clusters and the reduced set.

        ``print(study.summary())`` prints the same sentences as ``cornercase show``.

        Parameters
        ----------
        threshold : float, optional
            Score from which a scenario is critical; by default the threshold of the study.

        Returns
        -------
        Summary

        Raises
        ------
        InputError
            The study cannot be read, or `threshold` is given but the study does not define criticality by one score.
        """
        from cornercase.report import summarize

        with rename_arguments_in_errors():
            return summarize(self._file, critical=threshold)

    @suggest_arguments
    def export(self, folder: Path | str, *, parquet: bool = False) -> None:
        """Write the study as CSV: a table of scenarios, and the recording and metric courses of each scenario.

        Parameters
        ----------
        folder : path
            Folder for ``scenarios.csv``, and for ``recordings/ID.csv`` and ``courses/ID.csv`` of each scenario.
            ``parameters.csv`` lists the file name and the parameters of each recording, so that
            `cornercase.import_recordings` can read the folder.
        parquet : bool, default False
            Also write ``scenarios.parquet``, ``recordings.parquet`` and ``courses.parquet`` of all scenarios.

        Raises
        ------
        InputError
            The folder cannot be written, or the package that writes Parquet is not installed.
        """
        with self._read() as file:
            file.export(folder, parquet)

    @property
    def _file(self) -> Path:
        """Path of the study file; raises `InputError` if no scenario was run yet."""
        if self._problem is not None and not self.path.exists():
            raise InputError(f"{self.path}: no scenario was run yet; run some with `explore`.")
        return self.path

    @hide_input_error_traceback()
    def _read(self) -> StudyFile:
        """Open the file for reading."""
        return StudyFile.open(self._file)

    def _make_config(self, meta: StudyMeta | None, **settings: Any) -> ExplorationConfig:
        """Return the configuration of an exploration; settings that are not given come from `meta`, if not None."""
        if self._problem is None:
            return replace(self._config_to_continue(), **settings)
        if meta is not None:
            settings = {**read_stored_search_options(meta), "optimizer": known_optimizer(meta.optimizer)} | settings
        return config_from_problem(self._problem, seed=self.seed, **self._simulator_settings, **settings)

    def _config_to_continue(self) -> ExplorationConfig:
        """Return the configuration that the file stores; a simulator given to `open` replaces the stored simulator."""
        fields = dict(self._simulator_settings)
        with self._read() as file:
            config = config_from_study(
                file,
                self.path,
                self._scenario,
                fields.get("simulator"),
                fields.pop("drivers", {}),
            )
        return replace(config, **fields)

    def _scenario_path(self) -> Path | None:
        return self._scenario if self._problem is None else self._problem.scenario.path

    def __repr__(self) -> str:
        if self._problem is not None and not self.path.exists():
            simulator = self._simulator if isinstance(self._simulator, str) else repr(self._simulator)
            return f"<Study {str(self.path)!r}: {self._problem!r} in {simulator}; no scenario was run yet>"
        try:
            with self._read() as file:
                return repr(file)
        except InputError as error:
            # Debuggers and notebooks show an object whatever became of its file.
            return f"<Study {str(self.path)!r}: {error}>"

    def _repr_html_(self) -> str:
        """Return a description of the study and its most critical scenarios as HTML, for notebooks."""
        if not self.path.exists():
            return render_html(repr(self))
        with self._read() as file, file.snapshot():
            table = _table_with_critical(file)
            # If the package of a metric is missing, the first scenarios are shown.
            with suppress(InputError):
                ids = file.most_critical()
                table = table.loc[[*ids, *table.index.difference(ids)]]
        return render_html_table(repr(self), table)


def _table_with_critical(study: StudyFile) -> pd.DataFrame:
    """Return the table of all scenarios, with the column ``critical`` if the study has a threshold or condition."""
    import pandas as pd

    table = study.table()
    # The package of a metric may be missing.
    with suppress(InputError):
        # A parameter may have this name.
        if study.criterion is not None and "critical" not in table.columns:
            critical = pd.Series(pd.NA, index=table.index, dtype="boolean")
            critical.loc[[row.id for row in study.finished_rows()]] = study.critical_mask()
            table.insert(table.columns.tolist().index("collision"), "critical", critical)
    return table


def _describe_unknown_critical(study: StudyFile) -> str:
    """Return a sentence that says why nothing can be estimated about the critical part of the parameter space."""
    if not study.finished_rows():
        return f"{study.path}: no scenario has a result, so nothing is known about the critical ones."
    objective = study.objective
    what = "the weighted sum" if objective.weights else f"the metric {objective.label}"
    unit = f", in {objective.unit}" if objective.unit else ""
    return (
        f"{study.path}: it is not known from which score on a scenario is critical, since {what} has no threshold of"
        f" its own; give `threshold`{unit}."
    )
