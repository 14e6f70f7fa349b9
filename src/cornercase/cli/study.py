"""Commands `analyze` and `reduce`: cluster and select the scenarios of a study."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from rich.table import Column, Table

from cornercase._common.errors import InputError
from cornercase._common.memory import DEFAULT_MEMORY
from cornercase.cli import options as opt
from cornercase.cli import parsing
from cornercase.cli.command_options import add_api_options
from cornercase.cli.options import Option, app, out
from cornercase.cli.profiling import Profile


@app.command()
@add_api_options("cluster")
def analyze(
    study: opt.StudyFile,
    *,
    by: opt.CompareBy = None,
    gamma: opt.Gamma = "auto",
    eps: opt.Eps = "auto",
    min_samples: opt.MinSamples = "auto",
    method: Annotated[
        str | None, Option(metavar="dbscan|hdbscan", help="Algorithm that finds clusters; default: dbscan.")
    ] = None,
    window: Annotated[
        float | None,
        Option(metavar="S", help="Largest time difference in s of two instants that are matched; default: no limit."),
    ] = None,
    keep_clusters: Annotated[
        bool, Option("--keep-clusters", help="Keep the existing clusters, and assign new scenarios to them.")
    ] = False,
    explore_settings: Annotated[
        Path | None,
        Option(
            "--explore-settings",
            metavar="FILE.html",
            help="Write a page that shows what gamma and eps do, to choose them by hand; existing clusters stay.",
        ),
    ] = None,
    workers: opt.LocalWorkers = 1,
    cluster: str | None = None,
    critical: opt.CriticalOverride = None,
    memory: opt.Memory = DEFAULT_MEMORY,
    profile: Profile = None,
) -> None:
    """Cluster the scenarios of a study, by behaviour and by criticality.

    An aspect is what scenarios are compared by. Aspects are: ego-trajectory, ego-speed, ego-motion, behaviour (the
    ego's distance over time), interaction, relative, bearing (direction from the ego to the other), each metric of the
    study, and aspects that other packages add.

    \b
    Example:
      cornercase analyze study.db --by ego-trajectory --by wttc
      cornercase analyze study.db --by interaction --window 1
      cornercase analyze study.db --explore-settings settings.html
      cornercase analyze study.db --by wttc --gamma 1 --eps 0.2 --min-samples 6
    """
    from cornercase import clustering
    from cornercase.evidence._criticality_bands import bands_of_study
    from cornercase.study._study_file import open_study

    if explore_settings is not None:
        given = {"--gamma": gamma != "auto", "--eps": eps != "auto", "--min-samples": min_samples != "auto"}
        given |= {"--method": method is not None, "--window": window is not None, "--keep-clusters": keep_clusters}
        for option, is_given in given.items():
            if is_given:
                raise InputError(
                    f"--explore-settings, {option}: give only one of them; the page shows clusters of many settings."
                )
        _write_clustering_settings_page(
            study, explore_settings, by, workers=workers, cluster=cluster, critical=critical, memory=memory
        )
        return
    results = clustering.analyze(
        study,
        by,
        gamma=parsing.parse_number_or_auto(gamma, "--gamma"),
        eps=parsing.parse_number_or_auto(eps, "--eps"),
        min_samples=parsing.parse_count_or_auto(min_samples, "--min-samples"),
        method=None if method is None else parsing.require_one_of(method, ("dbscan", "hdbscan"), "--method"),
        window=window,
        keep_clusters=keep_clusters,
        workers=workers,
        cluster=cluster,
        critical=critical,
        memory=memory,
        progress=True,
    )
    # 80 characters are enough for the longest metric name and two clusters.
    numbers = (Column(name, no_wrap=True) for name in ("noise", "stability", "gamma", "eps"))
    table = Table(Column("by", no_wrap=True), "clusters", "sizes", *numbers, "min samples", box=None, pad_edge=False)
    for name, analysis in results.items():
        fit = analysis.clustering
        sizes, noise = " ".join(map(str, analysis.sizes)), str(int((fit.labels < 0).sum()))
        stability = "–" if fit.stability is None else f"{fit.stability:.2f}"
        settings = f"{fit.gamma:.4g}", f"{fit.eps:.4g}", str(fit.min_samples)
        table.add_row(name, str(len(analysis.sizes)), sizes, noise, stability, *settings)
    out.print(table)
    for name, analysis in results.items():
        for member in analysis.profiles if len(analysis.sizes) > 1 else ():
            if member.name:
                out.print(f"{name} {member.cluster}: {member.label} ({member.size} scenarios)", markup=False)
    with open_study(study, readonly=True) as opened:
        for bands in bands_of_study(opened).values():
            out.print(bands.describe(), markup=False)


def _write_clustering_settings_page(study: Path, page: Path, by: list[str] | None, **options: Any) -> None:
    """Write a page that shows the effect of clustering settings; first analyze aspects that have no clusters yet."""
    from cornercase import clustering
    from cornercase.report import write_clustering_settings_page
    from cornercase.study._study_file import open_study

    with open_study(study, readonly=True) as opened:
        analyzed = opened.analyzed_aspects()
    missing = [name for name in by if name not in analyzed] if by else None
    if missing or not (by or analyzed):
        clustering.analyze(study, missing, progress=True, **options)
    written = write_clustering_settings_page(study, page, by or (), progress=True)
    out.print(f"The page is {written.resolve()}")


@app.command()
@add_api_options("cluster", "drivers")
def reduce(
    study: opt.StudyFile,
    *,
    output: Annotated[Path, Option("--output", "-o", metavar="DIR", help="Folder for the selected scenarios.")],
    by: Annotated[
        str | None,
        Option(
            "--by",
            metavar="ASPECT|METRIC|bands:METRIC",
            help="Aspect whose clusters, or metric whose bands of criticality, are represented; default: the aspect"
            " whose clusters say most about how scenarios end.",
        ),
    ] = None,
    archetypes: Annotated[
        str | None,
        Option(
            metavar="N|auto",
            help="Keep only prototypes and this number of archetypes of each cluster, as in the paper.",
        ),
    ] = None,
    archetypes_by: Annotated[
        str,
        Option(
            metavar="auto|hull|pcha|parts|kernel",
            help="Method that finds archetypes; auto chooses by the convexity of each cluster.",
        ),
    ] = "auto",
    size: Annotated[int | None, Option(metavar="N", help="Number of scenarios to keep.", min=1)] = None,
    share: Annotated[float | None, Option(metavar="X", help="Fraction of scenarios to keep; default: 0.1.")] = None,
    cover: Annotated[
        float | None,
        Option(
            metavar="X",
            help="Keep adding the scenario farthest from the kept ones until each other one is near a kept one: within"
            " this fraction of the largest distance.",
        ),
    ] = None,
    ids: Annotated[
        str | None,
        Option(
            "--ids",
            metavar="ID,ID-ID",
            help="Write exactly these scenarios, such as 3,17-20; the study keeps the set that it has.",
        ),
    ] = None,
    within: Annotated[
        float,
        Option(
            metavar="X",
            help="Distance up to which scenarios count as similar, as fraction of the median distance in clusters.",
        ),
    ] = 0.5,
    kill_mutants: Annotated[
        int | None,
        Option(
            metavar="N",
            help="First keep scenarios that together kill as many of N mutants of the ego's driver as possible.",
            min=1,
        ),
    ] = None,
    require: Annotated[
        list[str] | None,
        Option(
            "--require",
            metavar="EXPRESSION",
            help="Requirement that a killed mutant violates, as for test; default: no collision.",
        ),
    ] = None,
    seed: opt.MutantSeed = 0,
    scenario: opt.NamedScenario = None,
    workers: opt.LocalWorkers = 1,
    cluster: str | None = None,
    drivers: Any = None,
    critical: opt.CriticalOverride = None,
    memory: opt.Memory = DEFAULT_MEMORY,
    profile: Profile = None,
    maps: opt.Maps = None,
) -> None:
    """Keep the few concrete scenarios that matter, as files that run on their own.

    \b
    Example:
      cornercase reduce study.db --size 32 -o reduced
      cornercase reduce study.db --size 10 --kill-mutants 40 -o reduced
      cornercase reduce study.db --ids 3,17-20 -o chosen
    """
    from cornercase import reduction
    from cornercase.clustering import read_analysis
    from cornercase.evidence._criticality_bands import BANDS_PREFIX
    from cornercase.reduction._reduce import default_aspect
    from cornercase.reduction._write_files import write_chosen_scenarios
    from cornercase.report._sentences import describe_selected_dangers
    from cornercase.study._study_file import open_study
    from cornercase.suite import analyze_mutants

    if ids is not None:
        selecting = {"--by": by, "--size": size, "--share": share, "--cover": cover, "--archetypes": archetypes}
        for option, value in (selecting | {"--kill-mutants": kill_mutants}).items():
            if value is not None:
                raise InputError(f"--ids, {option}: give only one of them; --ids already selects the scenarios.")
    exposure = None
    if kill_mutants is None:
        if require:
            raise InputError("--require: only applies to mutants; give --kill-mutants too.")
        if cluster is not None:
            raise InputError("--cluster: only runs mutants; give --kill-mutants too.")
        if drivers:
            raise InputError("--driver: only drives mutants; give --kill-mutants too.")
    else:
        for option, value in (("--cover", cover), ("--archetypes", archetypes)):
            if value is not None:
                raise InputError(f"--kill-mutants, {option}: give only one of them.")
        # Check that the study was analyzed before the mutants run.
        with open_study(study, readonly=True, critical=critical) as opened:
            read_analysis(opened, (by or default_aspect(opened)).removeprefix(BANDS_PREFIX))
        exposure = analyze_mutants(
            study,
            kill_mutants,
            require=require or (),
            seed=seed,
            scenario=scenario,
            drivers=drivers,
            workers=workers,
            cluster=cluster,
            progress=True,
        )
    if ids is not None:
        chosen = write_chosen_scenarios(
            study, output, parsing.parse_ids(ids, "--ids"), scenario=scenario, critical=critical
        )
        n_written = f"{len(chosen)} scenario{'' if len(chosen) == 1 else 's'}"
        out.print(f"{n_written} written to {output}; 'cornercase test {output}' runs them", markup=False)
        return
    reduced = reduction.reduce(
        study,
        output,
        by=by,
        size=size,
        share=share,
        cover=cover,
        archetypes=None if archetypes is None else parsing.parse_count_or_auto(archetypes, "--archetypes"),
        archetypes_by=parsing.require_one_of(
            archetypes_by, ("auto", "hull", "pcha", "parts", "kernel"), "--archetypes-by"
        ),
        within=within,
        kill_matrix=exposure,
        scenario=scenario,
        critical=critical,
        memory=memory,
        progress=True,
    )
    out.print(f"{len(reduced.scenarios)} of {reduced.n_run} scenarios kept, in {output}")
    with open_study(study, readonly=True, critical=critical) as opened:
        out.print(describe_selected_dangers(opened, reduced.ids))
    if reduced.exposing is not None:
        count = sum(scenario.role == "exposing" for scenario in reduced.scenarios)
        out.print(f"{count} of them expose mutants; {reduced.exposing.summary_text}.")
