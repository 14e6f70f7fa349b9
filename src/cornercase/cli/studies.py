"""Commands that make something of a study."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer
from rich.table import Column, Table

from cornercase._common.errors import InputError
from cornercase._common.json_keys import with_identifiers
from cornercase._common.memory import DEFAULT_MEMORY
from cornercase._common.texts import json_text
from cornercase.cli import parsing
from cornercase.cli.messages import in_words_of_the_command_line
from cornercase.cli.options import (
    By,
    Cluster,
    CriticalAnew,
    Eps,
    Gamma,
    LocalWorkers,
    Maps,
    Memory,
    MinSamples,
    Seed,
    SimulatorName,
    StudyFile,
    Workers,
    app,
    err,
    out,
    tell_ending,
)
from cornercase.cli.profiling import Profile
from cornercase.cli.warming import two_compile

if TYPE_CHECKING:
    from cornercase.scenario import Scenario
    from cornercase.study import Study

# Scenarios that a demonstration keeps as a suite.
_SUITE: Final = 20


@app.command()
def analyze(
    study: StudyFile,
    *,
    by: By = None,
    gamma: Gamma = "auto",
    eps: Eps = "auto",
    min_samples: MinSamples = "auto",
    method: Annotated[
        str | None, typer.Option(metavar="dbscan|hdbscan", help="How to find clusters; default: dbscan.")
    ] = None,
    window: Annotated[
        float | None,
        typer.Option(metavar="S", help="Match only instants at most this many s apart; default: any."),
    ] = None,
    keep_clusters: Annotated[
        bool, typer.Option("--keep-clusters", help="Keep existing clusters; assign new scenarios to them.")
    ] = False,
    workers: LocalWorkers = 1,
    cluster: Cluster = None,
    critical: CriticalAnew = None,
    memory: Memory = DEFAULT_MEMORY,
    profile: Profile = None,
) -> None:
    """Cluster the scenarios of a study, by behaviour and by criticality.

    Aspects: ego-trajectory, ego-speed, ego-motion, behaviour (the ego's distance over time), interaction, relative,
    bearing (of the other, as the ego sees it), those of other packages, and each metric.

    \b
    Example:
      cornercase analyze study.db --by ego-trajectory --by wttc
      cornercase analyze study.db --by interaction --window 1
    """
    from cornercase import clustering

    results = clustering.analyze(
        study,
        by,
        gamma=parsing.number_or_auto(gamma, "--gamma"),
        eps=parsing.number_or_auto(eps, "--eps"),
        min_samples=parsing.count_or_auto(min_samples, "--min-samples"),
        method=None if method is None else parsing.one_of(method, ("dbscan", "hdbscan"), "--method"),
        window=window,
        keep=keep_clusters,
        workers=workers,
        cluster=cluster,
        critical=critical,
        memory=memory,
        progress=True,
    )
    # Eighty characters are enough for the metric of the longest name and two clusters.
    whole = (Column(name, no_wrap=True) for name in ("noise", "stability", "gamma", "eps"))
    table = Table(Column("by", no_wrap=True), "clusters", "sizes", *whole, "min samples", box=None, pad_edge=False)
    for name, one in results.items():
        found = one.clustering
        sizes = " ".join(map(str, one.sizes))
        noise = str(int((found.labels < 0).sum()))
        table.add_row(
            name,
            str(len(one.sizes)),
            sizes,
            noise,
            "–" if found.stability is None else f"{found.stability:.2f}",
            f"{found.gamma:.4g}",
            f"{found.eps:.4g}",
            str(found.min_samples),
        )
    out.print(table)
    for name, one in results.items():
        for kind in one.profiles if len(one.sizes) > 1 else ():
            if kind.name:
                out.print(f"{name}, cluster {kind.cluster}: {kind.label} ({kind.size} scenarios)", markup=False)


@app.command()
def reduce(
    study: StudyFile,
    *,
    output: Annotated[Path, typer.Option("--output", "-o", metavar="DIR", help="Folder for the kept scenarios.")],
    by: Annotated[
        str | None,
        typer.Option(
            "--by", metavar="ASPECT|METRIC", help="Aspect whose clusters are used; default: the searched metric."
        ),
    ] = None,
    archetypes: Annotated[
        str | None,
        typer.Option(
            metavar="N|auto",
            help="As in the paper, keep only prototypes and this number of archetypes for each cluster.",
        ),
    ] = None,
    archetypes_by: Annotated[
        str,
        typer.Option(
            metavar="auto|hull|pcha|parts|kernel",
            help="How to find archetypes; auto depends on the convexity of each cluster.",
        ),
    ] = "auto",
    size: Annotated[int | None, typer.Option(metavar="N", help="Number of scenarios to keep.", min=1)] = None,
    share: Annotated[float | None, typer.Option(metavar="X", help="Share of scenarios to keep; default: 0.1.")] = None,
    cover: Annotated[
        float | None,
        typer.Option(
            metavar="X",
            help="Keep as few as possible; none is farther from a kept one than this share of the largest distance.",
        ),
    ] = None,
    within: Annotated[
        float,
        typer.Option(
            metavar="X", help="Two scenarios are alike within this share of the median distance inside clusters."
        ),
    ] = 0.5,
    kill_mutants: Annotated[
        int | None,
        typer.Option(
            metavar="N",
            help="First keep the scenarios that expose most of N mutants of the ego's driver.",
            min=1,
        ),
    ] = None,
    require: Annotated[
        list[str] | None,
        typer.Option(
            "--require",
            metavar="EXPRESSION",
            help="Requirement that a mutant has to fail, as for test; default: no collision.",
        ),
    ] = None,
    seed: Annotated[int, typer.Option(metavar="N", help="Seed of the mutants: same seed, same mutants.", min=0)] = 0,
    scenario: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.xosc",
            help="Scenario explored; default: as the study names it, beside it or here.",
        ),
    ] = None,
    workers: LocalWorkers = 1,
    cluster: Cluster = None,
    critical: CriticalAnew = None,
    memory: Memory = DEFAULT_MEMORY,
    profile: Profile = None,
    maps: Maps = None,
) -> None:
    """Keep the few concrete scenarios that matter, as files that run on their own.

    \b
    Example:
      cornercase reduce study.db --size 32 -o reduced
      cornercase reduce study.db --size 10 --kill-mutants 40 -o reduced
    """
    from cornercase import reduction
    from cornercase.clustering import read_analysis
    from cornercase.study import open_study
    from cornercase.suite import find_exposure

    if require and kill_mutants is None:
        raise InputError("--require: says what mutants have to fail; give --kill-mutants too.")
    if cluster is not None and kill_mutants is None:
        raise InputError("--cluster: runs mutants; give --kill-mutants too.")
    for option, given in (("--cover", cover), ("--archetypes", archetypes)):
        if kill_mutants is not None and given is not None:
            raise InputError(f"--kill-mutants, {option}: give one of them.")
    exposure = None
    if kill_mutants is not None:
        # Not after the mutants have run.
        with open_study(study, readonly=True, critical=critical) as opened:
            read_analysis(opened, by or opened.meta.metrics[0])
        exposure = find_exposure(
            study,
            kill_mutants,
            require=require or (),
            seed=seed,
            scenario=scenario,
            workers=workers,
            cluster=cluster,
            progress=True,
        )
    reduced = reduction.reduce(
        study,
        output,
        by=by,
        size=size,
        share=share,
        cover=cover,
        archetypes=None if archetypes is None else parsing.count_or_auto(archetypes, "--archetypes"),
        archetypes_by=parsing.one_of(archetypes_by, ("auto", "hull", "pcha", "parts", "kernel"), "--archetypes-by"),
        within=within,
        exposure=exposure,
        scenario=scenario,
        critical=critical,
        memory=memory,
        progress=True,
    )
    out.print(f"{len(reduced.kept)} of {reduced.run} scenarios kept, in {output}")
    if reduced.exposing is not None:
        count = sum(one.role == "exposing" for one in reduced.kept)
        out.print(f"{count} of them expose mutants; {reduced.exposing.text}.")


@app.command()
def report(
    study: StudyFile,
    *,
    output: Annotated[Path, typer.Option("--output", "-o", metavar="FILE.html", help="Page to write.")],
    figures: Annotated[
        bool,
        typer.Option(
            "--figures", help="Also write figures for a paper, as PNG and SVG, into a folder beside the page."
        ),
    ] = False,
    figures_in: Annotated[
        Path | None, typer.Option("--figures-in", metavar="DIR", help="Write these figures into another folder.")
    ] = None,
    scenario: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.xosc", help="Scenario that was explored; default: found beside the study or in this folder."
        ),
    ] = None,
    critical: CriticalAnew = None,
    memory: Memory = DEFAULT_MEMORY,
    profile: Profile = None,
    maps: Maps = None,
) -> None:
    """Write the report: one page that holds everything.

    \b
    Example:
      cornercase report study.db -o report.html
      cornercase report study.db --figures -o report.html
    """
    from cornercase.report import write_report

    page = write_report(
        study,
        output,
        figures=figures if figures_in is None else figures_in,
        scenario=scenario,
        critical=critical,
        memory=memory,
        progress=True,
    )
    out.print(f"The report is {page.resolve()}")


@app.command()
def watch(
    study: Annotated[Path, typer.Argument(metavar="STUDY.db", help="Study; it need not exist yet.")],
    *,
    port: Annotated[int, typer.Option(metavar="N", help="Port of the page; default: a free one.", min=0)] = 0,
    host: Annotated[
        str, typer.Option(metavar="ADDRESS", help="Network interface; any other one lets other machines connect.")
    ] = "127.0.0.1",
    scenario: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.xosc", help="Scenario that was explored; default: found beside the study or in this folder."
        ),
    ] = None,
    browser: Annotated[bool, typer.Option("--browser/--no-browser", help="Open the page in the browser.")] = True,
    maps: Maps = None,
) -> None:
    """Serve the report of a study on this machine; it grows while explore runs.

    It needs the extra live. The address is the password: with it, people can read the page and write notes. Ctrl-C ends
    it.

    \b
    Example:
      cornercase watch study.db
    """
    from cornercase.report import watch as watch_study

    watch_study(study, port=port, host=host, scenario=scenario, browser=browser, tell=out.print)


@app.command()
def replay(
    study: StudyFile,
    scenario_id: Annotated[int, typer.Argument(metavar="ID", help="Which scenario.", min=1)],
    *,
    output: Annotated[Path, typer.Option("--output", "-o", metavar="FILE.html|gif|mp4", help="Page or film to write.")],
    beside: Annotated[
        int | None, typer.Option(metavar="ID", help="Another scenario, shown beside it on the same clock.", min=1)
    ] = None,
    fps: Annotated[
        float | None, typer.Option(metavar="N", help="Frames per second of a film; default: 25, for a GIF 10.")
    ] = None,
    speed: Annotated[float, typer.Option(metavar="X", help="How fast a film runs: 0.5 is slow motion.")] = 1.0,
    scenario: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.xosc", help="Scenario that was explored; default: found beside the study or in this folder."
        ),
    ] = None,
    critical: CriticalAnew = None,
    maps: Maps = None,
) -> None:
    """Replay a scenario, as a page or as a film.

    \b
    Example:
      cornercase replay study.db 45 -o run.html
      cornercase replay study.db 45 --beside 3 --speed 0.5 -o run.mp4
    """
    from cornercase import report

    written = report.replay(
        study,
        scenario_id,
        output,
        beside=beside,
        fps=fps,
        speed=speed,
        scenario=scenario,
        critical=critical,
        progress=True,
    )
    out.print(f"The replay is {written.resolve()}")


@app.command()
def demo(
    name: Annotated[str, typer.Argument(metavar="x-intersection|t-intersection", help="Name of the example.")],
    *,
    budget: Annotated[
        int | None,
        typer.Option(metavar="N", help="Concrete scenarios to run; default: as in the paper.", min=1),
    ] = None,
    seed: Seed = 0,
    driver: Annotated[str | None, typer.Option(metavar="NAME", help="Driver of the ego.")] = None,
    simulator: SimulatorName = "builtin",
    workers: Workers = 1,
    output: Annotated[Path | None, typer.Option("--output", "-o", metavar="DIR", help="Folder to write.")] = None,
    profile: Profile = None,
) -> None:
    """Explore, cluster, reduce and report an example; the t-intersection also gets a suite of tests.

    \b
    Example:
      cornercase demo x-intersection --budget 100 -o demo
      cornercase demo t-intersection -o t
    """
    from cornercase import clustering, reduction
    from cornercase.exploration import demonstration, explore_configuration, mutants_of_demonstration
    from cornercase.report import write_report
    from cornercase.study import Study

    folder = output or Path("demo") / name
    configuration = demonstration(
        name, budget=budget, seed=seed, driver=driver, simulator=simulator, workers=workers, folder=folder / "scenario"
    )
    study = folder / "study.db"
    with two_compile():
        tell_ending(explore_configuration(configuration, study, progress=True))
        with Study.open(study, readonly=False) as opened:
            clustering.analyze(opened, progress=True)
            # First, as the study remembers the last set that was kept of it.
            if (mutants := mutants_of_demonstration(name)) is not None:
                _keep_suite(opened, folder / "suite", mutants, configuration.logical.scenario)
            reduction.reduce(opened, folder / "reduced", scenario=configuration.logical.scenario, progress=True)
            write_report(opened, folder / "report.html", scenario=configuration.logical.scenario, progress=True)
    out.print(f"The report is {(folder / 'report.html').resolve()}")


def _keep_suite(study: Study, folder: Path, mutants: int, scenario: Scenario) -> None:
    """Keep what exposes mutants of the ego's driver, and say how it is run."""
    from cornercase import reduction
    from cornercase.suite import find_exposure

    try:
        exposure = find_exposure(study, mutants, scenario=scenario, progress=True)
    except InputError as why:
        err.print(f"No suite of tests was made. {in_words_of_the_command_line(str(why))}")
        return
    kept = reduction.reduce(study, folder, size=_SUITE, exposure=exposure, scenario=scenario)
    out.print(f"{len(kept.kept)} scenarios that expose worse drivers are in {folder}; run them with another one:")
    out.print(f'  cornercase test {folder} --driver Ego=aggressive --require "no collision"', soft_wrap=True)


@app.command()
def show(
    study: StudyFile,
    *,
    critical: CriticalAnew = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON, for programs.")] = False,
    config: Annotated[
        bool, typer.Option("--config", help="Print a study file for cornercase explore --config.")
    ] = False,
) -> None:
    """Show what was run and what was found.

    \b
    Example:
      cornercase show study.db
      cornercase show study.db --critical 0.5
      cornercase show study.db --config > study.toml
    """
    from cornercase.report import NAMED, put_in_words, summarize, tell_study_file

    if config:
        if as_json or critical is not None:
            raise InputError("--config: tells how the study was made; leave --json and --critical out.")
        sys.stdout.write(tell_study_file(study))
        return
    words = put_in_words(summarize(study, critical=critical))
    if as_json:
        sys.stdout.write(json_text(with_identifiers(words, NAMED)) + "\n")
        return
    for key, value in words.items():
        if value != {}:
            _show(key, value)
        elif key == "clusters":
            out.print("clusters: none yet; 'cornercase analyze' finds them")


@app.command()
def export(
    study: StudyFile,
    *,
    output: Annotated[Path, typer.Option("--output", "-o", metavar="DIR", help="Folder for the tables.")],
    parquet: Annotated[
        bool, typer.Option("--parquet", help="Also write tables of scenarios, recordings and courses as Parquet.")
    ] = False,
) -> None:
    """Write everything in a study as tables.

    \b
    Example:
      cornercase export study.db -o tables
    """
    from cornercase.study import Study

    with Study.open(study, readonly=True) as opened:
        opened.export(output, parquet=parquet)
    out.print(f"Written to {output}")


def _show(key: str, value: Any, indent: str = "") -> None:
    if isinstance(value, dict):
        out.print(f"{indent}{key}")
        for inner, one in value.items():
            _show(inner, one, indent + "  ")
    else:
        text = ", ".join(map(_in_words, value)) if isinstance(value, list) else _in_words(value)
        out.print(f"{indent}{key}: {text}")


def _in_words(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, float) else "–" if value is None else str(value)
