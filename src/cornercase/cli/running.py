"""Commands that run scenarios, measure recordings, and say what can do either."""

from __future__ import annotations

import inspect
import sys
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.table import Column, Table

from cornercase._common.errors import InputError
from cornercase._common.files import require_other_file
from cornercase._common.texts import first_line, json_text, shorten
from cornercase.cli import parsing
from cornercase.cli.messages import LONGEST, in_words_of_the_command_line
from cornercase.cli.options import (
    Cluster,
    Critical,
    Drivers,
    Duration,
    Ego,
    Maps,
    MaxFailures,
    Metrics,
    OnCollision,
    Other,
    Retries,
    ScenarioFile,
    Seed,
    SimulatorName,
    SpaceFile,
    StudyOutput,
    Timeout,
    TimeStep,
    Values,
    Vary,
    Workers,
    app,
    err,
    out,
    tell_ending,
)
from cornercase.cli.profiling import Profile
from cornercase.cli.study_file import Config


@app.command()
def explore(
    scenario: Annotated[
        Path | None,
        typer.Argument(metavar="[SCENARIO.xosc]", help="OpenSCENARIO file; may be omitted if --space names it."),
    ] = None,
    *,
    ego: Ego,
    other: Other,
    metric: Metrics,
    output: StudyOutput,
    space: SpaceFile = None,
    ranges: Annotated[
        list[str] | None,
        typer.Option("--range", metavar="NAME=LOW:HIGH[:STEP]", help="Add or replace a parameter."),
    ] = None,
    vary: Vary = None,
    continuous: Annotated[
        bool, typer.Option("--continuous", help="Search ranges with steps as continuous intervals.")
    ] = False,
    optimizer: Annotated[
        str,
        typer.Option(
            metavar="NAME",
            help="bayes, level-set, committee, evolutionary, optuna, sobol, grid or random; options after a colon, as"
            " in bayes:filling=0.",
        ),
    ] = "bayes",
    critical: Critical = None,
    critical_if: Annotated[
        str | None,
        typer.Option(
            "--critical-if",
            metavar="CONDITION",
            help="Search a condition instead: 'collision and not reference:cc-human' is what this driver"
            " would have prevented; bounds on scores ('ttc < 1'), and, or, not, brackets.",
        ),
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
            help="Stop when enough is known about the critical set: missed<0.01, interval<0.05,"
            " overlooked(0.01)<0.05, unvisited(0.01)<0.05, audited-missed<0.1; with several, when all hold.",
        ),
    ] = None,
    budget: Annotated[int, typer.Option(metavar="N", help="Number of concrete scenarios to run in all.", min=1)] = 200,
    batch: Annotated[int, typer.Option(metavar="N", help="Number of concrete scenarios in a round.", min=1)] = 10,
    asynchronous: Annotated[
        bool,
        typer.Option("--asynchronous", help="Work without rounds: propose the next scenario as soon as one has ended."),
    ] = False,
    patience: Annotated[
        int | None,
        typer.Option(
            metavar="N", help="Stop after N rounds without anything new (asynchronous: after as many scenarios).", min=1
        ),
    ] = None,
    max_seconds: Annotated[float | None, typer.Option(metavar="S", help="Stop after this time in s.")] = None,
    seed: Seed = 0,
    simulator: SimulatorName = "builtin",
    workers: Workers = 1,
    cluster: Cluster = None,
    timeout: Timeout = None,
    retries: Retries = 1,
    max_failures: MaxFailures = 5,
    repeats: Annotated[
        int, typer.Option(metavar="N", help="Run each scenario N times; its score is the median.", min=1)
    ] = 1,
    max_repeats: Annotated[
        int | None,
        typer.Option(
            "--max-repeats",
            metavar="M",
            help="Run a scenario N times more, up to M times in all, while it is open whether it is critical: while"
            " the 90 % interval of the probability that a run is critical contains 0.5.",
            min=1,
        ),
    ] = None,
    audit: Annotated[
        float,
        typer.Option(
            metavar="SHARE",
            help="Share of scenarios drawn at random and hidden from the search, to judge what it found.",
        ),
    ] = 0.0,
    time_step: TimeStep = 0.05,
    duration: Duration = 60.0,
    on_collision: OnCollision = "continue",
    driver: Drivers = None,
    check_proposals: Annotated[
        bool,
        typer.Option(
            "--check-proposals",
            help="Simulate nothing; test whether the stored results lead to the same proposals.",
        ),
    ] = False,
    warm_start: Annotated[
        Path | None,
        typer.Option(
            "--warm-start",
            metavar="OTHER.db",
            help="Begin from the scores of a study of the same parameters: another driver, simulator or time step.",
        ),
    ] = None,
    retry_failed: Annotated[
        bool, typer.Option("--retry-failed", help="First run the failed scenarios of the study once more.")
    ] = False,
    config: Config = None,
    profile: Profile = None,
    maps: Maps = None,
) -> None:
    """Search a logical scenario for its critical concrete scenarios.

    The same command again goes on where it stopped. With --check-proposals, exit code 1 means that a
    proposal differs.

    \b
    Example:
      cornercase explore examples/x_intersection/x_intersection.xosc \\
          --space examples/x_intersection/x_intersection.space.xosc \\
          --ego Ego --other Pedestrian --metric wttc --budget 100 -o study.db
      cornercase explore examples/t_intersection/t_intersection.xosc \\
          --space examples/t_intersection/t_intersection.space.xosc \\
          --ego Ego --other C --metric wttc --driver Ego=normal --optimizer committee \\
          --critical-if "collision and not reference:cautious" -o preventable.db
      cornercase explore examples/r157/cut_in.xosc --vary Ego.initial.x=90:110 \\
          --ego Ego --other Other --metric wttc -o varied.db
      cornercase explore --config study.toml --budget 200 -o study.db
    """
    from cornercase import exploration

    result = exploration.explore(
        scenario,
        output,
        space=space,
        ranges=ranges or (),
        vary=vary or (),
        continuous=continuous,
        ego=ego,
        other=other,
        metrics=metric,
        optimizer=optimizer,
        critical=critical,
        critical_if=critical_if,
        weights=parsing.numbers(weight or (), "--weight"),
        pareto=pareto,
        stop_when=stop_when or (),
        budget=budget,
        batch=batch,
        asynchronous=asynchronous,
        patience=patience,
        max_seconds=max_seconds,
        seed=seed,
        simulator=simulator,
        workers=workers,
        cluster=cluster,
        timeout=timeout,
        retries=retries,
        max_failures=max_failures,
        repeats=repeats,
        most_repeats=max_repeats,
        audit=audit,
        time_step=time_step,
        duration=duration,
        on_collision=on_collision,
        drivers=parsing.pairs(driver or (), "--driver"),
        replay=check_proposals,
        from_study=warm_start,
        retry_failed=retry_failed,
        progress=True,
    )
    tell_ending(result)


@app.command()
def check(
    scenarios: Annotated[list[Path], typer.Argument(metavar="SCENARIO.xosc…", help="OpenSCENARIO files.")],
    *,
    space: SpaceFile = None,
    strict: Annotated[
        bool, typer.Option("--strict", help="Refuse what breaks the standard, though it can be read, with its rule.")
    ] = False,
    maps: Maps = None,
) -> None:
    """Check scenario files: what they hold, what has no effect here, and whether they are valid and can run.

    What breaks the standard and can mean only one thing is read so, and named as "adapted". The exit code is 1 if one
    of the files is not valid or cannot run, or with --strict if something was adapted.

    \b
    Example:
      cornercase check examples/x_intersection/x_intersection.xosc \\
          --space examples/x_intersection/x_intersection.space.xosc
      cornercase check reduced/*.xosc --strict
    """
    from cornercase import simulators

    if space is not None and len(scenarios) > 1:
        raise InputError("--space: belongs to one scenario; check one scenario at a time.")
    bad = []
    for scenario in scenarios:
        if len(scenarios) > 1:
            out.print(f"{scenario}:")
        try:
            found = simulators.check(scenario, space, strict=strict)
        except InputError as error:
            if len(scenarios) == 1:
                raise
            out.print(shorten(in_words_of_the_command_line(str(error)).replace("\n", "\\n"), LONGEST))
            bad.append(scenario)
            continue
        _tell_check(found)
        if not found.good:
            bad.append(scenario)
    if len(scenarios) > 1:
        kept = ", break no rule" if strict else ""
        out.print(f"{len(scenarios) - len(bad)} of {len(scenarios)} are valid{kept} and can be run")
    if bad:
        raise typer.Exit(1)


def _tell_check(found: Any) -> None:
    """Print what was found of one scenario."""
    for key, count in found.contents.items():
        out.print(f"{key}: {count}")
    out.print(f"parameters: {', '.join(found.parameters) or 'none'}")
    if found.variables:
        out.print(f"variables: {', '.join(found.variables)}")
    for notice in found.notices:
        # With --strict, what was adapted is said below, with its rule.
        if not (found.adapted and notice.label == "adapted"):
            out.print(shorten(notice.sentence, LONGEST))
    if found.schema is None:
        out.print("schema: not looked at; it comes with pip install 'cornercase[validate]'")
    else:
        but = ", but for what is adapted" if any(one.label == "adapted" for one in found.notices) else ""
        out.print(f"schema {found.schema}: {f'valid{but}' if not found.invalid else 'not valid'}")
    for line in (*found.invalid, *(f"refused: {one}" for one in found.adapted), *found.trouble):
        out.print(shorten(f"  {line}", LONGEST))
    if found.space is not None:
        for parameter in found.space.parameters:
            out.print(f"varied: {_words_of(parameter)}")
        out.print(f"concrete scenarios: {'infinitely many' if found.space.size is None else found.space.size}")
    out.print("can be run" if not found.trouble else "cannot be run")


@app.command(name="convert")
def convert_(
    scenario: ScenarioFile,
    *,
    ego: Ego,
    output: Annotated[Path, typer.Option("--output", "-o", metavar="FILE.xosc", help="File to write.")],
    values: Values = None,
    maps: Maps = None,
) -> None:
    """Write a concrete scenario as OpenSCENARIO 1.0, as CARLA's ScenarioRunner reads it.

    It reports what is not exactly the same there, and refuses what OpenSCENARIO 1.0 cannot express.

    \b
    Example:
      cornercase convert examples/t_intersection/t_intersection.xosc \\
          --set c_start_time=1 --ego Ego -o t10.xosc
    """
    from cornercase.simulators import convert

    for note in convert(scenario, output, ego=ego, values=parsing.pairs(values or (), "--set")).notes:
        err.print(note)
    out.print(f"Written to {output}")


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
        list[str] | None,
        typer.Option("--metric", metavar="NAME", help="Criticality metric; default: all that take no formula."),
    ] = None,
) -> None:
    """Measure a recording, of this or any other simulator, and print the scores.

    \b
    Example:
      cornercase measure recording.csv --ego Ego --other Pedestrian --metric wttc -o courses.csv
    """
    from cornercase.metrics import measure as measure_recording
    from cornercase.recordings import write_courses

    require_other_file(output, recording)
    found = measure_recording(recording, ego, other, metric)
    write_courses(output, found.time, found.courses)
    table = Table(*found.head(), box=None)
    for row in found.rows():
        table.add_row(*row)
    out.print(table)
    out.print(f"{found.time.size} instants written to {output}")


@app.command(name="import")
def import_(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder with recordings and parameters.csv.")],
    *,
    ego: Ego,
    other: Other,
    metric: Metrics,
    output: StudyOutput,
    table: Annotated[
        Path | None,
        typer.Option("--parameters", metavar="FILE.csv", help="Column 'file', and one for each parameter."),
    ] = None,
    critical: Critical = None,
) -> None:
    """Make a study from existing recordings, to cluster and reduce them.

    Reads what measure reads: cornercase's and esmini's CSV, SUMO's floating car data, CarMaker's ERG, CARLA's recorder
    files, ASAM OSI traces, CommonRoad scenarios.

    \b
    Example:
      cornercase import runs --ego hero --other adversary --metric ttc -o study.db
    """
    from cornercase.study import import_recordings

    result = import_recordings(
        folder, output, ego=ego, other=other, metrics=metric, table=table, critical=critical, progress=True
    )
    out.print(f"{result.done} scenarios in {output}")
    if result.failed:
        out.print(f"{result.failed} recordings could not be read or measured; the first: {result.reason}")


@app.command()
def metrics(
    names: Annotated[
        list[str] | None,
        typer.Argument(metavar="[NAME]…", help="Metrics to define, with their options."),
    ] = None,
    *,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON, for programs.")] = False,
) -> None:
    """List the criticality metrics, with those of other packages, or print definitions.

    A metric takes options after a colon, those of its class in the documentation: --metric ttc:accelerating=true

    \b
    Example:
      cornercase metrics
      cornercase metrics wttc
    """
    from cornercase.metrics import METRICS

    if names and not as_json:
        out.print("\n\n".join(_definition(METRICS.create(name)) for name in dict.fromkeys(names)))
        return
    known = [METRICS.create(name) for name in dict.fromkeys(names or METRICS.names())]
    if as_json:
        keys = ("name", "unit", "lower_is_critical", "cap", "source")
        rows = [{key: getattr(one, key) for key in keys} | {"definition": first_line(one)} for one in known]
        sys.stdout.write(json_text(rows) + "\n")
        return
    # Names are typed again, so they are whole however narrow the terminal is.
    table = Table(Column("metric", no_wrap=True), "unit", "critical is", "what it is", "source", box=None)
    for one in known:
        what = first_line(one)
        table.add_row(one.name, one.unit, "low" if one.lower_is_critical else "high", what, one.source)
    out.print(table)


@app.command()
def simulators(
    *,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON, for programs.")] = False,
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
        sys.stdout.write(json_text({name: asdict(one) for name, one in found.items()}) + "\n")
        return
    # Addresses are whole however narrow the terminal is.
    missing = Column("what is missing", overflow="fold")
    table = Table("simulator", "here", "version", "what it can do", missing, box=None)
    for name, one in found.items():
        table.add_row(
            name, "no" if one.missing else "yes", one.version or "-", ", ".join(one.abilities), one.missing or "-"
        )
    out.print(table)


def _definition(metric: Any) -> str:
    """What a metric is, its unit and its options."""
    what = (inspect.getdoc(metric) or "").replace("``", "").replace("`", "").replace(" ::", ":")
    side = "low" if metric.lower_is_critical else "high"
    return (
        f"{metric.name}, in {metric.unit}; {side} is critical\n\n{what}"
        if metric.unit
        else (f"{metric.name}, without unit; {side} is critical\n\n{what}")
    )


def _words_of(parameter: Any) -> str:
    """Say what of a parameter is varied."""
    if parameter.choices:
        return f"{parameter.name}: {len(parameter.choices)} choices"
    step = "" if parameter.step is None else f" in steps of {parameter.step:g}"
    return f"{parameter.name}: {parameter.low:g} to {parameter.high:g}{step} {parameter.unit}".rstrip()
