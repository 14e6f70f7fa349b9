"""The command that compiles ahead what other commands would compile when they need it first."""

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

if TYPE_CHECKING:
    from cornercase._common.typing import FloatArray
    from cornercase.recordings import Recording

# What is compiled depends neither on how many scenarios there are nor on how long they take.
_SCENARIOS, _SECONDS = 12, 3.0
# More than are all compared with each other.
_MANY: Final = 2100
# Machine code is made of what these words stand in.
_SIGNS: Final = ("compiling import kernel", "compiling.kernel")
_LATER: Final = "from cornercase.cli.warming import compile_later; compile_later()"


@app.command(name="warm-up")
def warm_up() -> None:
    """Compile in advance what other commands would compile at first use.

    Compiled code is kept beside the package, or in the folder that NUMBA_CACHE_DIR names. Run it when you build a
    container image, which then starts at full speed. Exit code 1 if it cannot be kept.

    \b
    Example:
      cornercase warm-up
    """
    from cornercase._common.compiling import count_kernels, heard_compilation, why_not_kept
    from cornercase._common.progress import ProgressBar

    begun, compiled = time.monotonic(), list[str]()
    _import_kernels()
    bar = ProgressBar(count_kernels()[1], "compiling", "kernels")

    def heard(name: str) -> None:
        compiled.append(name)
        ready, known = count_kernels()
        bar.update(ready, name, known)

    try:
        with tempfile.TemporaryDirectory() as folder, heard_compilation(heard), warnings.catch_warnings():
            # What of the examples has no effect is nobody's concern here.
            warnings.simplefilter("ignore")
            for room, run in _small_runs(Path(folder)):
                bar.update(count_kernels()[0], room)
                run()
        bar.update(count_kernels()[1], "", count_kernels()[1])
    finally:
        bar.stop()
    seconds = f"{time.monotonic() - begun:.0f} s"
    if not compiled:
        out.print(f"Everything is compiled already, as was seen in {seconds}.")
    elif unkept := why_not_kept():
        err.print(f"{len(set(compiled))} kernels compiled in {seconds}, and not kept: {unkept}.")
        raise typer.Exit(1)
    else:
        out.print(f"{len(set(compiled))} kernels compiled in {seconds}, and kept.")


@contextmanager
def two_compile() -> Iterator[None]:
    """Once this process compiles, let another one compile what comes after the simulations.

    Both keep their machine code in the same place, so that what the other one has compiled is there when it is needed.

    Yields
    ------
    None
    """
    from cornercase._common.compiling import companion
    from cornercase._common.platform import available_cpus

    started: list[subprocess.Popen[bytes]] = []

    def start() -> None:
        # The current folder may be a stranger's.
        command, nothing = [sys.executable, "-P", "-c", _LATER], subprocess.DEVNULL
        # Its input ends with this process, however this one ends.
        started.append(subprocess.Popen(command, stdin=subprocess.PIPE, stdout=nothing, stderr=nothing))

    if available_cpus() < 2:
        yield
        return
    try:
        with companion(start):
            yield
    finally:
        # What is cut while it is written counts as missing.
        for process in started:
            process.terminate()
            process.communicate()


def compile_later() -> None:
    """Compile what the demonstrations need late: drivers, of which compiled frames come to last, and all after them.

    To be called in a process of its own, which ends with its standard input.
    """
    import numpy as np

    from cornercase import clustering, dtw, metrics
    from cornercase._common.lifeline import end_with_input

    end_with_input()
    _drive()
    crossing = _crossing()
    metrics.measure(crossing, "Ego", "Other", ["wttc"])
    for dimensions in (2, 4, 1):
        dtw.distance_matrix([np.zeros((2, dimensions)), np.ones((2, dimensions))], dtype="float32", n_jobs=1)
    clustering.find_outcome(crossing, "Ego", "Other")
    clustering.cluster(_two_groups())


def _drive() -> None:
    """Let a built-in driver decide once."""
    import numpy as np

    from cornercase import drivers

    along, one = np.arange(0.0, 50.0, 0.5), np.ones(1)
    driver = drivers.named_driver("normal")
    driver.start(1, 1)
    driver.acceleration(
        drivers.Situation(
            0.0, 0.05, drivers.DrivenPath(along, along, *np.zeros((3, len(along)))), one, one, 0.0 * one, 0.0 * one,
            one, 0.0 * one, length=4.0, width=2.0, center_x=1.5, target_speed=10.0 * one,
            others_x=np.full((1, 1), 30.0), others_y=np.zeros((1, 1)), others_heading=np.zeros((1, 1)),
            others_speed=np.zeros((1, 1)), others_length=one, others_width=one, others_center_x=0.0 * one,
            others_kind=("pedestrian",), active=np.ones(1, dtype=np.bool_),
        )
    )  # fmt: skip


def _import_kernels() -> None:
    """Import all modules that hold kernels, so that they are counted before the first of them is compiled."""
    package = Path(__file__).parents[1]
    for path in sorted(package.rglob("*.py")):
        if path != Path(__file__) and any(sign in path.read_text("utf-8") for sign in _SIGNS):
            import_module(".".join(("cornercase", *path.relative_to(package).with_suffix("").parts)))


def _small_runs(folder: Path) -> Iterator[tuple[str, Callable[[], Any]]]:
    """Yield small runs of all that compiles, each with its room: what they compile is found out by running it."""
    from cornercase import clustering, drivers, exploration, metrics, optimizers, reduction, report, simulators
    from cornercase._common.errors import InputError

    for name in ("x-intersection", "t-intersection"):
        about = replace(exploration.demonstration(name, budget=_SCENARIOS), duration=_SECONDS)
        study = folder / name / "study.db"
        reduced, scenario = study.parent / "reduced", about.logical.scenario
        yield "simulators", partial(exploration.explore_configuration, about, study)
        yield "clustering", partial(clustering.analyze, study)
        yield "reduction", partial(reduction.reduce, study, reduced, scenario=scenario)
        yield "evidence", partial(report.summarize, study)
    # So few scenarios of an example need not have any groups that could be judged.
    yield "clustering", partial(clustering.cluster, _two_groups())
    # So few scenarios are all compared with each other.
    yield "reduction", _reduce_many
    # So short runs do not come to a crossing.
    yield "clustering", partial(clustering.find_outcome, _crossing(), "Ego", "Other")
    simulate = partial(simulators.simulate, scenario, duration=_SECONDS)
    for one in drivers.DRIVERS.names():
        yield "drivers", partial(simulate, drivers={"Ego": one})
    yield "metrics", partial(metrics.measure, simulate(), about.ego, about.other)
    for one in optimizers.OPTIMIZERS.names():
        searched = replace(about, optimizer=one, critical=1.0, metrics=about.metrics[:1])

        def explore(searched: exploration.Configuration = searched, study: Path = folder / f"{one}.db") -> None:
            try:
                exploration.explore_configuration(searched, study)
            except InputError:
                # It comes with an extra that is not there.
                return

        yield "optimizers", explore


def _reduce_many() -> None:
    """Choose from more scenarios than are all compared with each other, and compare the choice with others."""
    import numpy as np

    from cornercase import clustering, reduction

    points = np.linspace(0.0, 1.0, _MANY)[:, None]
    distances = clustering.PlacedDistances(points)
    kept = reduction.choose_scenarios(points, [distances], np.zeros(len(points), dtype=np.int64), size=2)
    reduction.measure_gaps(distances, [one.index for one in kept] + list(range(0, _MANY, 10)), draws=1)


def _two_groups() -> FloatArray:
    """Distances of two groups, far apart."""
    import numpy as np

    along = np.concatenate([np.linspace(0.0, 1.0, 12), np.linspace(9.0, 10.0, 12)])
    return np.asarray(np.abs(np.subtract.outer(along, along)))


def _crossing() -> Recording:
    """Two cars, of which the one crosses the way of the other."""
    import numpy as np

    from cornercase import recordings

    time = np.arange(20.0)
    along, still = time - 10.0, np.zeros((2, len(time)))
    return recordings.Recording(
        time=time,
        names=("Ego", "Other"),
        kinds=("car", "car"),
        x=np.stack([2.0 * along, still[0]]),
        y=np.stack([still[0], 2.0 * along - 9.0]),
        heading=np.stack([still[0], still[0] + 0.5 * np.pi]),
        speed=still + 2.0,
        acceleration=still,
        length=np.full(2, 4.0),
        width=np.full(2, 2.0),
        center_x=np.zeros(2),
    )
