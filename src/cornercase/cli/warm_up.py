"""Command `warm-up`: compile all Numba functions in advance."""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import typer

from cornercase.cli.options import app, err, out
from cornercase.metrics._own_metrics import as_metric_tuple

if TYPE_CHECKING:
    from cornercase._common.typing import FloatArray
    from cornercase.drivers import SystemUnderTest
    from cornercase.recordings import Recording

# Neither the number nor the duration of scenarios affects what is compiled.
_N_SCENARIOS, _DURATION = 12, 3.0
# Too many scenarios for all pairwise distances.
_LARGE_SET: Final = 2100
# Modules that contain one of these texts define kernels.
_KERNEL_IMPORTS: Final = ("numba.kernel import", "numba.kernel.")
_LATE_PROGRAM: Final = "from cornercase.cli.warm_up import compile_late_kernels; compile_late_kernels()"


@app.command(name="warm-up")
def warm_up() -> None:
    """Compile in advance what other commands would compile at first use.

    Compiled code is stored in the folder NUMBA_CACHE_DIR if it is set, otherwise beside the package, or in the user's
    cache folder if the package cannot be written to. Run this command when you build a container image, so that
    containers start at full speed. Exit code 1: compiled code cannot be stored.

    \b
    Example:
      cornercase warm-up
    """
    from cornercase._common.numba.kernel import count_ready_kernels, listen_to_compilation, reason_not_cached
    from cornercase._common.progress import ProgressBar

    start, compiled = time.monotonic(), list[str]()
    _import_kernels()
    bar = ProgressBar(count_ready_kernels()[1], "compiling", "kernels")

    def on_kernel_compiled(name: str) -> None:
        compiled.append(name)
        ready, total = count_ready_kernels()
        bar.update(ready, name, total)

    try:
        with (
            tempfile.TemporaryDirectory() as folder,
            listen_to_compilation(on_kernel_compiled),
            warnings.catch_warnings(),
        ):
            # Notices about the examples do not matter here.
            warnings.simplefilter("ignore")
            for package, run in _iter_runs_by_package(Path(folder)):
                bar.update(count_ready_kernels()[0], package)
                run()
        bar.update(count_ready_kernels()[1], "", count_ready_kernels()[1])
    finally:
        bar.stop()
    seconds = f"{time.monotonic() - start:.0f} s"
    if not compiled:
        out.print(f"Everything is already compiled (checked in {seconds}).")
    elif unkept := reason_not_cached():
        err.print(f"{len(set(compiled))} kernels compiled in {seconds}, but not stored: {unkept}.")
        raise typer.Exit(1)
    else:
        out.print(f"{len(set(compiled))} kernels compiled and stored in {seconds}.")


@contextmanager
def compile_in_parallel(program: str = _LATE_PROGRAM) -> Iterator[None]:
    """Within the block, let a second process compile what is needed later; it starts at the first compilation.

    Both processes share the cache of compiled code. With a single CPU, no second process is started.
    """
    from cornercase._common.numba.interpret import compile_loops_at_once
    from cornercase._common.numba.kernel import call_on_first_compilation
    from cornercase._common.platform import count_available_cpus

    processes: list[subprocess.Popen[bytes]] = []

    def start_process() -> None:
        # -P: the current folder may be untrusted.
        command, nothing = [sys.executable, "-P", "-c", program], subprocess.DEVNULL
        # Its stdin closes when this process ends for any reason.
        processes.append(subprocess.Popen(command, stdin=subprocess.PIPE, stdout=nothing, stderr=nothing))

    if count_available_cpus() < 2:
        with compile_loops_at_once():
            yield
        return
    try:
        with compile_loops_at_once(), call_on_first_compilation(start_process):
            yield
    finally:
        # An incompletely written cache file counts as missing.
        for process in processes:
            process.terminate()
            process.communicate()


def compile_late_kernels() -> None:
    """Compile the functions that examples need after the simulations; exit the process as soon as its stdin closes."""
    import numpy as np

    from cornercase import clustering, dtw, metrics
    from cornercase._common.process.parent_death import exit_when_stdin_closes
    from cornercase.metrics._ending import find_outcome

    exit_when_stdin_closes()
    crossing = _make_crossing_recording()
    metrics.measure(crossing, "Ego", "Other", ["wttc"])
    for dimensions in (2, 4, 1):
        dtw.distance_matrix([np.zeros((2, dimensions)), np.ones((2, dimensions))], dtype="float32", n_jobs=1)
    find_outcome(crossing, "Ego", "Other")
    clustering.cluster(_make_two_group_distances())


def _import_kernels() -> None:
    """Import all modules with Numba functions, so that the number of functions is known before compilation begins."""
    package = Path(__file__).parents[1]
    for path in sorted(package.rglob("*.py")):
        if path != Path(__file__) and any(sign in path.read_text("utf-8") for sign in _KERNEL_IMPORTS):
            import_module(".".join(("cornercase", *path.relative_to(package).with_suffix("").parts)))


def _iter_runs_by_package(folder: Path) -> Iterator[tuple[str, Callable[[], Any]]]:
    """Yield pairs: the name of a subpackage, and a short run that uses it. All runs together compile everything."""
    from cornercase import clustering, drivers, metrics, optimizers, reduction, report, simulators
    from cornercase._common.errors import InputError
    from cornercase.exploration._config import ExplorationConfig
    from cornercase.exploration._explore import explore_config
    from cornercase.exploration._paper_examples import paper_experiment_config
    from cornercase.metrics._ending import find_outcome

    for name in ("x-intersection", "t-intersection"):
        config = replace(paper_experiment_config(name, budget=_N_SCENARIOS), duration=_DURATION)
        study = folder / name / "study.db"
        reduced, scenario = study.parent / "reduced", config.logical.scenario_file
        yield "simulators", partial(explore_config, config, study)
        yield "clustering", partial(clustering.analyze, study)
        yield "reduction", partial(reduction.reduce, study, reduced, scenario=scenario)
        yield "evidence", partial(report.summarize, study)
    # The few scenarios of an example may have no groups.
    yield "clustering", partial(clustering.cluster, _make_two_group_distances())
    # With few scenarios all pairwise distances are computed.
    yield "reduction", _reduce_large_set
    # Short runs never reach a crossing.
    yield "clustering", partial(find_outcome, _make_crossing_recording(), "Ego", "Other")
    simulate = partial(simulators.simulate, scenario, duration=_DURATION)
    for plugin in drivers.DRIVERS.names():
        # An FMU and a program are files of the user.
        if not drivers.DRIVERS.takes_whole_text(plugin):
            yield "drivers", partial(simulate, drivers={"Ego": plugin})
    for plugin in drivers.VEHICLES.names():
        # This driver is not compiled, so that the vehicle's own kernels are.
        yield "drivers", partial(simulate, drivers={"Ego": f"cc-human + {plugin}"})
    yield "drivers", partial(simulate, drivers={"Ego": _make_lane_reading_driver()})
    yield "metrics", partial(metrics.measure, simulate(), config.ego, config.other)
    for plugin in optimizers.OPTIMIZERS.names():
        changed = replace(config, optimizer=plugin, critical=1.0, metrics=as_metric_tuple(config.metrics)[:1])

        def explore(searched: ExplorationConfig = changed, study: Path = folder / f"{plugin}.db") -> None:
            try:
                explore_config(searched, study)
            except InputError:
                # Its extra is not installed.
                return

        yield "optimizers", explore


def _make_lane_reading_driver() -> SystemUnderTest:
    from cornercase.drivers import SystemUnderTest, View

    class Looking(SystemUnderTest):
        def step(self, view: View, dt: float) -> float:
            return 0.0 if view.leader is None else float(view.leader.lane or 0)

    return Looking()


def _reduce_large_set() -> None:
    import numpy as np

    from cornercase.clustering._embedding import EmbeddedDistances
    from cornercase.reduction._coverage import measure_nearest_distances
    from cornercase.reduction.selection._greedy import select_scenarios

    points = np.linspace(0.0, 1.0, _LARGE_SET)[:, None]
    distances = EmbeddedDistances(points)
    selected = select_scenarios(points, [distances], np.zeros(len(points), dtype=np.int64), size=2)
    measure_nearest_distances(
        distances, [scenario.index for scenario in selected] + list(range(0, _LARGE_SET, 10)), draws=1
    )


def _make_two_group_distances() -> FloatArray:
    import numpy as np

    positions = np.concatenate([np.linspace(0.0, 1.0, 12), np.linspace(9.0, 10.0, 12)])
    return np.asarray(np.abs(np.subtract.outer(positions, positions)))


def _make_crossing_recording() -> Recording:
    import numpy as np

    from cornercase import recordings

    time = np.arange(20.0)
    position, zeros = time - 10.0, np.zeros((2, len(time)))
    return recordings.Recording(
        time=time,
        names=("Ego", "Other"),
        object_types=("car", "car"),
        x=np.stack([2.0 * position, zeros[0]]),
        y=np.stack([zeros[0], 2.0 * position - 9.0]),
        heading=np.stack([zeros[0], zeros[0] + 0.5 * np.pi]),
        speed=zeros + 2.0,
        acceleration=zeros,
        length=np.full(2, 4.0),
        width=np.full(2, 2.0),
        center_x=np.zeros(2),
    )
