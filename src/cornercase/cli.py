"""The command line: parses, calls the API, prints."""

from __future__ import annotations

import inspect
import json
import sys
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.table import Table

from cornercase import __version__, option_values
from cornercase.errors import InputError

app = typer.Typer(
    name="cornercase",
    help="Find, cluster and reduce the critical concrete scenarios of a logical scenario.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)

_out = Console(soft_wrap=True, highlight=False)
_err = Console(stderr=True, soft_wrap=True, highlight=False)

ScenarioFile = Annotated[Path, typer.Argument(metavar="SCENARIO.xosc", help="OpenSCENARIO file.")]
StudyFile = Annotated[Path, typer.Argument(metavar="STUDY.db", help="Study, as written by explore.")]
Ego = Annotated[str, typer.Option(help="Entity under test.")]
Other = Annotated[str, typer.Option(help="Entity it is measured against.")]
Metrics = Annotated[
    list[str],
    typer.Option("--metric", metavar="NAME", help="Criticality metric, all are stored; the first is searched."),
]
Seed = Annotated[int, typer.Option(help="Same seed, same result.", min=0)]
TimeStep = Annotated[float, typer.Option(metavar="S", help="Time step in s.")]
Duration = Annotated[float, typer.Option(metavar="S", help="Longest duration of a scenario in s.")]
OnCollision = Annotated[str, typer.Option(metavar="stop|continue", help="What a collision does to the run.")]
Drivers = Annotated[
    list[str] | None,
    typer.Option("--driver", metavar="ENTITY=NAME", help="Driver preset, or package.module:Class of your own."),
]
By = Annotated[
    list[str] | None,
    typer.Option("--by", metavar="ego-trajectory|METRIC", help="What to cluster by; default: all there is."),
]
Gamma = Annotated[str, typer.Option(metavar="X|auto", help="Kernel width parameter.")]
Eps = Annotated[str, typer.Option(metavar="X|auto", help="DBSCAN's neighbourhood in the kernel space.")]
MinSamples = Annotated[str, typer.Option(metavar="N|auto", help="DBSCAN's least number of neighbours.")]
SimulatorName = Annotated[str, typer.Option("--simulator", metavar="NAME", help="What runs the scenarios.")]
Timeout = Annotated[float | None, typer.Option(metavar="S", help="Give a scenario up after this time in s.")]
Retries = Annotated[
    int, typer.Option(metavar="N", help="Run a scenario again so often after the simulator died or hung.", min=0)
]
Workers = Annotated[int, typer.Option(metavar="N", help="Simulators that run side by side.", min=1)]


@app.callback(invoke_without_command=True)
def _main(
    version: Annotated[bool, typer.Option("--version", help="Show the version and leave.")] = False,
) -> None:
    if version:
        _out.print(f"cornercase {__version__}")
        raise typer.Exit


@app.command()
def explore(
    scenario: Annotated[
        Path | None,
        typer.Argument(metavar="[SCENARIO.xosc]", help="OpenSCENARIO file; may be left to --space."),
    ] = None,
    *,
    ego: Ego,
    other: Other,
    metric: Metrics,
    output: Annotated[Path, typer.Option("--output", "-o", metavar="STUDY.db", help="Study to write or go on with.")],
    space: Annotated[Path | None, typer.Option(help="ParameterValueDistribution file.")] = None,
    ranges: Annotated[
        list[str] | None,
        typer.Option("--range", metavar="NAME=LOW:HIGH[:STEP]", help="Adds or replaces a parameter."),
    ] = None,
    continuous: Annotated[
        bool, typer.Option("--continuous", help="Search ranges that have steps as intervals.")
    ] = False,
    optimizer: Annotated[
        str,
        typer.Option(
            metavar="NAME",
            help="bayes, level-set, evolutionary, optuna, sobol, grid or random; options behind a colon, as in"
            " bayes:filling=0.",
        ),
    ] = "bayes",
    critical: Annotated[
        float | None,
        typer.Option(metavar="X", help="Score from which a scenario is critical; default: the metric's own."),
    ] = None,
    weight: Annotated[
        list[str] | None,
        typer.Option("--weight", metavar="METRIC=W", help="Search the weighted sum of these metrics."),
    ] = None,
    pareto: Annotated[bool, typer.Option("--pareto", help="Search the Pareto front of all metrics.")] = False,
    stop_when: Annotated[
        list[str] | None,
        typer.Option(
            "--stop-when",
            metavar="WHAT<X",
            help="Stop when so much is known of the critical set: missed<0.01, interval<0.05,"
            " overlooked(0.01)<0.05, unvisited(0.01)<0.05; of several all.",
        ),
    ] = None,
    budget: Annotated[int, typer.Option(metavar="N", help="Concrete scenarios to run in all.", min=1)] = 200,
    batch: Annotated[int, typer.Option(metavar="N", help="Concrete scenarios per round.", min=1)] = 10,
    patience: Annotated[
        int | None, typer.Option(metavar="N", help="Stop after N rounds without anything new.", min=1)
    ] = None,
    max_seconds: Annotated[float | None, typer.Option(metavar="S", help="Stop after this time.")] = None,
    seed: Seed = 0,
    simulator: SimulatorName = "builtin",
    workers: Workers = 1,
    timeout: Timeout = None,
    retries: Retries = 1,
    repeats: Annotated[
        int, typer.Option(metavar="N", help="Run each scenario N times; its score is the median.", min=1)
    ] = 1,
    time_step: TimeStep = 0.05,
    duration: Duration = 60.0,
    on_collision: OnCollision = "continue",
    driver: Drivers = None,
) -> None:
    """Search a logical scenario for its critical concrete scenarios.

    The same command again goes on where it stopped.

    \b
    Example:
      cornercase explore examples/x_intersection/x_intersection.xosc \\
          --space examples/x_intersection/x_intersection.space.xosc \\
          --ego Ego --other Pedestrian --metric wttc --budget 100 -o study.db
    """
    from cornercase.pipeline import Exploration, explore_scenario
    from cornercase.scenario.logical import LogicalScenario
    from cornercase.scenario.openscenario import Scenario

    logical = LogicalScenario.read(scenario, space, ranges or (), continuous)
    if simulator.partition(":")[0] in ("builtin", "sumo"):
        _notice(Scenario.read(logical.path))
    _explore(
        explore_scenario,
        Exploration(
            logical,
            ego=ego,
            other=other,
            metrics=tuple(metric),
            optimizer=optimizer,
            critical=critical,
            weights=option_values.weights(weight or ()),
            pareto=pareto,
            stop_when=tuple(stop_when or ()),
            budget=budget,
            batch=batch,
            seed=seed,
            patience=patience,
            max_seconds=max_seconds,
            simulator=simulator,
            workers=workers,
            timeout=timeout,
            retries=retries,
            repeats=repeats,
            time_step=time_step,
            duration=duration,
            on_collision=on_collision,
            drivers=option_values.pairs(driver or (), "--driver"),
        ),
        output,
    )


@app.command()
def check(
    scenario: ScenarioFile,
    *,
    space: Annotated[Path | None, typer.Option(help="ParameterValueDistribution file.")] = None,
) -> None:
    """Tell what a scenario file holds, what of it has no effect here, and whether it is valid and can be run.

    \b
    Example:
      cornercase check examples/x_intersection/x_intersection.xosc \\
          --space examples/x_intersection/x_intersection.space.xosc
    """
    from cornercase.scenario.check import check_scenario

    found = check_scenario(scenario, space)
    for key, count in found.contents.items():
        _out.print(f"{key}: {count}")
    _out.print(f"parameters: {', '.join(found.parameters) or 'none'}", markup=False)
    if found.variables:
        _out.print(f"variables: {', '.join(found.variables)}", markup=False)
    if found.ignored:
        _out.print("without effect: " + ", ".join(f"{tag} ({count})" for tag, count in found.ignored.items()))
    if found.schema is None:
        _out.print("schema: not looked at; it comes with pip install 'cornercase[validate]'", markup=False)
    else:
        _out.print(f"schema {found.schema}: {'valid' if not found.invalid else 'not valid'}")
    for line in (*found.invalid, *found.trouble):
        _out.print(f"  {line}", markup=False)
    for line in found.space:
        _out.print(f"varied: {line}", markup=False)
    if found.space:
        _out.print(f"concrete scenarios: {'infinitely many' if found.size is None else found.size}")
    _out.print("can be run" if not found.trouble else "cannot be run")
    if not found.good:
        raise typer.Exit(1)


@app.command()
def convert(
    scenario: ScenarioFile,
    *,
    ego: Ego,
    output: Annotated[Path, typer.Option("--output", "-o", metavar="FILE.xosc", help="File to write.")],
    values: Annotated[
        list[str] | None, typer.Option("--set", metavar="NAME=VALUE", help="Value of a parameter.")
    ] = None,
) -> None:
    """Write a concrete scenario as OpenSCENARIO 1.0, as CARLA's ScenarioRunner reads it.

    Says what is not quite the same there, and refuses what cannot be said.

    \b
    Example:
      cornercase convert examples/t_intersection/t_intersection.xosc \\
          --set c_start_time=1 --ego Ego -o t10.xosc
    """
    from cornercase.scenario.openscenario import Scenario
    from cornercase.scenario.scenario_runner import write_scenario_runner

    for note in write_scenario_runner(
        Scenario.read(scenario), dict(option_values.pairs(values or (), "--set")), output, ego=ego
    ):
        _err.print(note, markup=False)
    _out.print(f"Written to {output}")


@app.command()
def simulate(
    scenario: ScenarioFile,
    *,
    output: Annotated[Path, typer.Option("--output", "-o", metavar="FILE.csv", help="Recording to write.")],
    values: Annotated[
        list[str] | None, typer.Option("--set", metavar="NAME=VALUE", help="Value of a parameter.")
    ] = None,
    time_step: TimeStep = 0.05,
    duration: Duration = 60.0,
    on_collision: OnCollision = "continue",
    driver: Drivers = None,
) -> None:
    """Run one concrete scenario and write its recording.

    \b
    Example:
      cornercase simulate examples/x_intersection/x_intersection.xosc \\
          --set ego_start=40 -o recording.csv
    """
    from cornercase.drivers import named_driver
    from cornercase.scenario.logical import ConcreteScenario
    from cornercase.scenario.openscenario import Scenario
    from cornercase.simulators.builtin import BuiltinSimulator

    pairs = option_values.pairs(values or (), "--set")
    read = Scenario.read(scenario)
    read.require_parameters(list(pairs))
    _notice(read)
    simulator = BuiltinSimulator(
        time_step=time_step,
        duration=duration,
        on_collision=on_collision,
        drivers={entity: named_driver(name) for entity, name in option_values.pairs(driver or (), "--driver").items()},
    )
    (recording,) = simulator.run([ConcreteScenario(scenario, pairs)])
    if isinstance(recording, Exception):
        raise InputError(f"{scenario}: {recording}.")
    recording.to_csv(output)
    _out.print(f"{len(recording.names)} entities, {recording.time[-1]:g} s, written to {output}")
    for collision in recording.collisions:
        _out.print(f"{' and '.join(collision.entities)} collide at {collision.time:g} s")


@app.command()
def measure(
    recording: Annotated[
        Path,
        typer.Argument(
            metavar="RECORDING",
            help="Recording to measure: CSV, also esmini's; SUMO FCD (.xml), CarMaker (.erg), CARLA (.log), ASAM OSI"
            " (.osi, .mcap), CommonRoad (.xml).",
        ),
    ],
    *,
    ego: Ego,
    other: Other,
    output: Annotated[Path, typer.Option("--output", "-o", metavar="FILE.csv", help="Courses to write.")],
    metric: Annotated[
        list[str] | None, typer.Option("--metric", metavar="NAME", help="Criticality metric; default: all.")
    ] = None,
) -> None:
    """Measure a recording, of this or any other simulator, and print the scores.

    \b
    Example:
      cornercase measure recording.csv --ego Ego --other Pedestrian --metric wttc -o courses.csv
    """
    from cornercase.metrics import METRICS
    from cornercase.metrics.courses import write_courses
    from cornercase.recording import read_recording

    read = read_recording(recording)
    metrics = [METRICS.create(name) for name in metric or METRICS.names()]
    courses = {one.name: one.course(read, ego, other) for one in metrics}
    write_courses(output, read.time, courses)
    table = Table("metric", "score", "unit", "critical is", box=None)
    for one in metrics:
        critical = "low" if one.lower_is_critical else "high"
        table.add_row(one.name, f"{one.score(courses[one.name]):.4g}", one.unit, critical)
    _out.print(table)
    _out.print(f"{read.time.size} instants written to {output}")


@app.command(name="import")
def import_(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder with recordings and parameters.csv.")],
    *,
    ego: Ego,
    other: Other,
    metric: Metrics,
    output: Annotated[Path, typer.Option("--output", "-o", metavar="STUDY.db", help="Study to write or go on with.")],
    table: Annotated[
        Path | None,
        typer.Option("--parameters", metavar="FILE.csv", help="Column 'file', and one for each parameter."),
    ] = None,
    critical: Annotated[
        float | None,
        typer.Option(metavar="X", help="Score from which a scenario is critical; default: the metric's own."),
    ] = None,
) -> None:
    """Make a study of recordings that were made elsewhere, to cluster and reduce them.

    Reads what measure reads: cornercase's and esmini's CSV, SUMO's floating car data, CarMaker's ERG, CARLA's recorder
    files, ASAM OSI traces, CommonRoad scenarios.

    \b
    Example:
      cornercase import runs --ego hero --other adversary --metric ttc -o study.db
    """
    from cornercase.importing import import_recordings

    count = import_recordings(
        folder, output, ego=ego, other=other, metrics=metric, table=table, critical=critical, progress=True
    )
    _out.print(f"{count} scenarios in {output}")


@app.command()
def metrics(
    *,
    as_json: Annotated[bool, typer.Option("--json", help="For programs.")] = False,
) -> None:
    """List the criticality metrics, also those of other packages.

    A metric takes options behind a colon, those of its class in the documentation: --metric ttc:accelerating=true

    \b
    Example:
      cornercase metrics
    """
    from cornercase.metrics import METRICS

    known = [METRICS.create(name) for name in METRICS.names()]
    if as_json:
        keys = ("name", "unit", "lower_is_critical", "cap", "source")
        rows = [
            {key: getattr(one, key) for key in keys} | {"definition": (inspect.getdoc(one) or "").partition("\n")[0]}
            for one in known
        ]
        sys.stdout.write(json.dumps(rows, indent=2, ensure_ascii=False) + "\n")
        return
    table = Table("metric", "unit", "critical is", "what it is", "source", box=None)
    for one in known:
        what = (inspect.getdoc(one) or "").partition("\n")[0]
        table.add_row(one.name, one.unit, "low" if one.lower_is_critical else "high", what, one.source)
    _out.print(table)


@app.command()
def simulators(
    *,
    as_json: Annotated[bool, typer.Option("--json", help="For programs.")] = False,
) -> None:
    """List the simulators, whether they can run here, and what they can do.

    \b
    Example:
      cornercase simulators
    """
    from dataclasses import asdict

    from cornercase.simulators import availabilities

    found = availabilities()
    if as_json:
        sys.stdout.write(json.dumps({name: asdict(one) for name, one in found.items()}, indent=2) + "\n")
        return
    table = Table("simulator", "here", "version", "what it can do", "what is missing", box=None)
    for name, one in found.items():
        table.add_row(
            name, "no" if one.missing else "yes", one.version or "-", ", ".join(one.abilities), one.missing or "-"
        )
    _out.print(table)


@app.command()
def analyze(
    study: StudyFile,
    *,
    by: By = None,
    gamma: Gamma = "auto",
    eps: Eps = "auto",
    min_samples: MinSamples = "auto",
    method: Annotated[str, typer.Option(metavar="dbscan|hdbscan", help="What finds the clusters.")] = "dbscan",
    keep: Annotated[
        bool, typer.Option("--keep", help="Keep the clusters that are there; new scenarios join them.")
    ] = False,
) -> None:
    """Cluster what was run, by behaviour and by criticality.

    \b
    Example:
      cornercase analyze study.db --by ego-trajectory --by wttc
    """
    from cornercase.analysis import analyze_study
    from cornercase.study import Study

    with Study.open(study) as opened:
        results = analyze_study(
            opened,
            by,
            gamma=option_values.number_or_auto(gamma, "--gamma"),
            eps=option_values.number_or_auto(eps, "--eps"),
            min_samples=option_values.count_or_auto(min_samples, "--min-samples"),
            method=option_values.one_of(method, ("dbscan", "hdbscan"), "--method"),
            keep=keep,
            progress=True,
        )
    table = Table("by", "clusters", "sizes", "noise", "stability", "gamma", "eps", "min samples", box=None)
    for name, one in results.items():
        found = one.clustering
        sizes = " ".join(map(str, one.sizes))
        noise = str(int((found.labels < 0).sum()))
        table.add_row(
            name,
            str(len(one.sizes)),
            sizes,
            noise,
            "-" if found.stability is None else f"{found.stability:.2f}",
            f"{found.gamma:.4g}",
            f"{found.eps:.4g}",
            str(found.min_samples),
        )
    _out.print(table)


@app.command()
def reduce(
    study: StudyFile,
    *,
    output: Annotated[Path, typer.Option("--output", "-o", metavar="DIR", help="Folder for the kept scenarios.")],
    by: Annotated[
        str | None,
        typer.Option("--by", metavar="ego-trajectory|METRIC", help="Which clusters; default: the searched metric's."),
    ] = None,
    archetypes: Annotated[
        str | None,
        typer.Option(
            metavar="N|auto", help="Keep nothing but prototypes and so many archetypes a cluster, as the paper."
        ),
    ] = None,
    archetypes_by: Annotated[
        str,
        typer.Option(
            metavar="auto|hull|pcha|parts|kernel",
            help="How archetypes are found; auto goes by each cluster's convexity.",
        ),
    ] = "auto",
    size: Annotated[int | None, typer.Option(metavar="N", help="Keep so many in all.", min=1)] = None,
    share: Annotated[float | None, typer.Option(metavar="X", help="Keep such a share of all; default 0.1.")] = None,
    cover: Annotated[
        float | None,
        typer.Option(
            metavar="X", help="Keep as few as leave nothing more unlike than this share of the largest distance."
        ),
    ] = None,
    within: Annotated[
        float,
        typer.Option(metavar="X", help="Scenarios are alike up to this share of the median distance within clusters."),
    ] = 0.5,
) -> None:
    """Keep the few concrete scenarios that matter, as files that run by themselves.

    \b
    Example:
      cornercase reduce study.db --size 32 -o reduced
    """
    from cornercase.reduction import reduce_study
    from cornercase.study import Study

    if sum(one is not None for one in (size, share, cover, archetypes)) > 1:
        raise InputError("--size, --share, --cover, --archetypes: give one of them.")
    with Study.open(study) as opened:
        if share is not None:
            size = option_values.of_all(share, len(opened.done()))
        manifest = reduce_study(
            opened,
            output,
            by=by,
            archetypes=None if archetypes is None else option_values.count_or_auto(archetypes, "--archetypes"),
            size=size,
            cover=cover,
            method=option_values.one_of(archetypes_by, ("auto", "hull", "pcha", "parts", "kernel"), "--archetypes-by"),
            within=within,
        )
    _out.print(f"{manifest['kept']} of {manifest['run']} scenarios kept, in {output}")


@app.command()
def report(
    study: StudyFile,
    *,
    output: Annotated[Path, typer.Option("--output", "-o", metavar="FILE.html", help="Page to write.")],
) -> None:
    """Write one self-contained page, and its figures as PNG beside it.

    \b
    Example:
      cornercase report study.db -o report.html
    """
    from cornercase.report import write_report
    from cornercase.study import Study

    with Study.open(study, readonly=True) as opened:
        write_report(opened, output)
    _out.print(f"The report is {output.resolve()}")


@app.command()
def demo(
    name: Annotated[str, typer.Argument(metavar="x-intersection|t-intersection", help="Which of the examples.")],
    *,
    budget: Annotated[
        int | None,
        typer.Option(metavar="N", help="Concrete scenarios to run; default: as in the paper.", min=1),
    ] = None,
    seed: Seed = 0,
    driver: Annotated[str | None, typer.Option(metavar="NAME", help="Who drives the ego.")] = None,
    simulator: SimulatorName = "builtin",
    workers: Workers = 1,
    output: Annotated[Path | None, typer.Option("--output", "-o", metavar="DIR", help="Folder to write.")] = None,
) -> None:
    """Explore, cluster, reduce and report one of the examples.

    \b
    Example:
      cornercase demo x-intersection --budget 100 -o demo
    """
    from cornercase.pipeline import demonstration, explore_scenario, finish

    folder = output or Path("demo") / name
    exploration = demonstration(name, budget=budget, seed=seed, driver=driver, simulator=simulator, workers=workers)
    study = folder / "study.db"
    _explore(explore_scenario, exploration, study)
    finish(study, folder)
    _out.print(f"The report is {(folder / 'report.html').resolve()}")


@app.command()
def show(
    study: StudyFile,
    *,
    as_json: Annotated[bool, typer.Option("--json", help="For programs.")] = False,
) -> None:
    """Tell what was run and what was found.

    \b
    Example:
      cornercase show study.db
    """
    from cornercase.study import Study
    from cornercase.summary import summarize

    with Study.open(study, readonly=True) as opened:
        summary = summarize(opened)
    if as_json:
        sys.stdout.write(json.dumps(summary, indent=2) + "\n")
        return
    for key, value in summary.items():
        _show(key, value)


@app.command()
def export(
    study: StudyFile,
    *,
    output: Annotated[Path, typer.Option("--output", "-o", metavar="DIR", help="Folder for the tables.")],
    parquet: Annotated[bool, typer.Option("--parquet", help="Write the table of scenarios as Parquet too.")] = False,
) -> None:
    """Write everything in a study as tables.

    \b
    Example:
      cornercase export study.db -o tables
    """
    from cornercase.study import Study

    with Study.open(study, readonly=True) as opened:
        opened.export(output, parquet=parquet)
    _out.print(f"Written to {output}")


def main() -> None:
    """Run the command line; what a user can mend becomes one sentence and exit code 2."""
    try:
        app(standalone_mode=True)
    except InputError as error:
        Console(stderr=True, soft_wrap=True, highlight=False).print(f"cornercase: {error}", markup=False)
        sys.exit(2)
    except KeyboardInterrupt:
        sys.exit(130)


def _notice(scenario: Any) -> None:
    """Say once which actions and conditions of a file have no effect here."""
    from cornercase.scenario.check import without_effect

    ignored = without_effect(scenario)
    if ignored:
        _err.print(f"Without effect here: {', '.join(ignored)}.", markup=False)


def _explore(run: Any, exploration: Any, study: Path) -> None:
    result = run(exploration, study, progress=True)
    if result.interrupted:
        _out.print(f"Interrupted; the same command goes on from the {result.done} scenarios in {study}.")
        raise typer.Exit(130)
    _out.print(f"{result.done} scenarios in {study}; ended because {result.reason}.")


def _show(key: str, value: Any, indent: str = "") -> None:
    if isinstance(value, dict):
        _out.print(f"{indent}{key}", markup=False)
        for inner, one in value.items():
            _show(inner, one, indent + "  ")
    else:
        text = ", ".join(map(str, value)) if isinstance(value, list) else value
        text = f"{text:.6g}" if isinstance(text, float) else text
        _out.print(f"{indent}{key}: {text}", markup=False)
