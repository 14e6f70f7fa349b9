"""Commands `report`, `watch`, `replay`, `show` and `export`: present a study."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from cornercase._common.errors import InputError
from cornercase._common.memory import DEFAULT_MEMORY
from cornercase.cli import options as opt
from cornercase.cli import parsing
from cornercase.cli.options import Option, app, out
from cornercase.cli.profiling import Profile


@app.command()
def report(
    study: Annotated[
        Path, typer.Argument(metavar="STUDY.db|FOLDER", help="Study, as written by explore, or a folder of studies.")
    ],
    *,
    output: opt.PageOutput,
    figures: Annotated[
        bool, Option("--figures", help="Also write figures for a paper, as PNG and SVG, into a folder beside the page.")
    ] = False,
    figures_in: Annotated[
        Path | None,
        Option("--figures-in", metavar="DIR", help="Write figures into this folder instead of beside the page."),
    ] = None,
    one_page: Annotated[
        bool, Option("--one-page", help="Write a summary instead that prints on one page of A4, for whoever decides.")
    ] = False,
    test_cards: Annotated[
        bool,
        Option(
            "--test-cards",
            help="Write test cards instead for a proving ground: a page of A4 for each kept scenario, with values that"
            " can be set.",
        ),
    ] = False,
    ids: Annotated[
        str | None,
        Option("--ids", metavar="ID,ID-ID", help="Scenarios on test cards, such as 3,17-20; default: the kept ones."),
    ] = None,
    scenario: opt.ExploredScenario = None,
    against: Annotated[
        Path | None,
        Option(
            metavar="STUDY.db",
            help="Study whose runs are shown beside those of a suite; default: the one that the suite was made from, if"
            " it is found.",
        ),
    ] = None,
    critical: opt.CriticalOverride = None,
    memory: opt.Memory = DEFAULT_MEMORY,
    profile: Profile = None,
    maps: opt.Maps = None,
) -> None:
    """Write the report: one page that holds everything.

    For a folder of studies, an index page is written.

    \b
    Example:
      cornercase report study.db -o report.html
      cornercase report study.db --figures -o report.html
      cornercase report study.db --one-page -o summary.html
      cornercase report study.db --test-cards -o cards.html
      cornercase report studies -o studies/index.html
    """
    from cornercase.report import write_report
    from cornercase.report._index_page import write_index
    from cornercase.report._one_page_summary import write_one_page_summary

    if test_cards or ids is not None:
        unused = {"--figures": figures, "--figures-in": figures_in is not None, "--against": against is not None}
        _check_test_card_options(study, test_cards, one_page, [flag for flag, given in unused.items() if given])
        _write_test_cards(study, output, ids, scenario, critical)
        return
    if study.is_dir():
        if one_page or figures or figures_in is not None or scenario is not None or critical is not None:
            raise InputError(
                f"{study}: is a folder, for which an index is written; leave --one-page, --figures, --figures-in,"
                " --scenario and --critical out, or name a study in it."
            )
        page = write_index(study, output)
        out.print(f"The index is {page.resolve()}")
        return
    if one_page:
        if figures or figures_in is not None or scenario is not None:
            raise InputError("--one-page: has no figures and no road; leave --figures, --figures-in, --scenario out.")
        page = write_one_page_summary(study, output, critical=critical, memory=memory)
        out.print(f"The summary is {page.resolve()}")
        return
    page = write_report(
        study,
        output,
        figures=figures if figures_in is None else figures_in,
        scenario=scenario,
        against=against,
        critical=critical,
        memory=memory,
        progress=True,
    )
    out.print(f"The report is {page.resolve()}")


def _check_test_card_options(study: Path, test_cards: bool, one_page: bool, unused: Sequence[str]) -> None:
    """Raise InputError if options cannot be combined; `unused` are the given options without effect on test cards."""
    if not test_cards:
        raise InputError("--ids: chooses the scenarios on test cards; add --test-cards, or leave --ids out.")
    if one_page:
        raise InputError(
            "--test-cards and --one-page: each writes a page of its own; give one of them at a time, each with its own"
            " --output."
        )
    if unused:
        raise InputError(f"--test-cards: has no figures and shows no other study; leave {' and '.join(unused)} out.")
    if study.is_dir():
        raise InputError(f"{study}: is a folder, and test cards are made of a study; name a study in it.")


def _write_test_cards(
    study: Path, output: Path, ids: str | None, scenario: Path | None, critical: float | None
) -> None:
    from cornercase.report import write_test_cards

    chosen = None if ids is None else parsing.parse_ids(ids, "--ids")
    page = write_test_cards(study, output, ids=chosen, scenario=scenario, critical=critical)
    out.print(f"The test cards are {page.resolve()}")


@app.command()
def watch(
    study: Annotated[Path, typer.Argument(metavar="STUDY.db", help="Study; it need not exist yet.")],
    *,
    port: Annotated[int, Option(metavar="N", help="Port of the page; default: a free one.", min=0)] = 0,
    host: Annotated[
        str,
        Option(
            metavar="ADDRESS", help="Network interface; with any other than the default, other machines can connect."
        ),
    ] = "127.0.0.1",
    scenario: opt.ExploredScenario = None,
    browser: Annotated[bool, Option("--browser/--no-browser", help="Open the page in the browser.")] = True,
    maps: opt.Maps = None,
) -> None:
    """Serve the report of a study on this machine, as a page that grows while explore runs.

    The command needs further packages: pip install "cornercase[live]". The address contains a password: anyone who
    knows the address can read the page and write notes. Ctrl-C ends the command.

    \b
    Example:
      cornercase watch study.db
    """
    from cornercase.report import watch as watch_study

    watch_study(study, port=port, host=host, scenario=scenario, browser=browser, show=out.print)


@app.command()
def replay(
    study: opt.StudyFile,
    scenario_id: Annotated[int | None, typer.Argument(metavar="ID", help="Id of the scenario.", min=1)] = None,
    *,
    output: Annotated[Path, Option("--output", "-o", metavar="FILE.html|gif|mp4", help="Page or film to write.")],
    beside: Annotated[
        int | None,
        Option(metavar="ID", help="Id of a second scenario, shown at the same time beside the first.", min=1),
    ] = None,
    fps: Annotated[
        float | None, Option(metavar="N", help="Frames per second of a film; default: 25 for MP4, 10 for GIF.")
    ] = None,
    speed: Annotated[float, Option(metavar="X", help="Speed of a film: 0.5 is slow motion.")] = 1.0,
    scenario: opt.ExploredScenario = None,
    critical: opt.CriticalOverride = None,
    maps: opt.Maps = None,
) -> None:
    """Write the replay of a scenario, as a page or as a film.

    \b
    Example:
      cornercase replay study.db 45 -o run.html
      cornercase replay study.db 45 --beside 3 --speed 0.5 -o run.mp4
    """
    from cornercase.report import replay as write_replay

    if study.suffix.lower() == ".csv":
        raise InputError(
            f"{study}: is a recording, and a replay is made from a study; run its scenario with the same driver by"
            " 'cornercase test SCENARIO.xosc --ego NAME --other NAME -o run.db', and replay scenario 1 of run.db."
        )
    if scenario_id is None:
        raise InputError(f"{study}: give the id of a scenario, too, as in 'cornercase replay {study} 1 -o {output}'.")
    path = write_replay(
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
    out.print(f"The replay is {path.resolve()}")


@app.command()
def show(
    study: opt.StudyFile,
    *,
    critical: opt.CriticalOverride = None,
    show_all: Annotated[
        bool, Option("--all", help="Print all numbers instead of the sentences of the report.")
    ] = False,
    as_json: opt.Json = False,
    config: Annotated[bool, Option("--config", help="Print a study file for cornercase explore --config.")] = False,
) -> None:
    """Show what was run and what was found, in the sentences of the report.

    \b
    Example:
      cornercase show study.db
      cornercase show study.db --all
      cornercase show study.db --critical 0.5
      cornercase show study.db --config > study.toml
    """
    from cornercase.report import summarize
    from cornercase.report._repeat_command import format_toml_study_file
    from cornercase.report._sentences import iter_sentences
    from cornercase.report.text._summary_dict import replace_keys_by_words, summary_to_dict
    from cornercase.study._study_file import open_study

    if config:
        if as_json or show_all or critical is not None:
            raise InputError("--config: prints how the study was made; leave --json, --all and --critical out.")
        sys.stdout.write(format_toml_study_file(study))
        return
    if not as_json and not show_all:
        with open_study(study, readonly=True, critical=critical) as opened, opened.snapshot():
            sentences = list(iter_sentences(opened))
        for sentence in sentences:
            out.print(sentence)
        if sentences:
            return
    summary = summary_to_dict(summarize(study, critical=critical))
    if as_json:
        opt.print_json(summary)
        return
    for key, value in replace_keys_by_words(summary).items():
        if value != {}:
            _print_entry(key, value)
        elif key == "clusters":
            out.print("clusters: none yet; 'cornercase analyze' finds them")


@app.command()
def export(
    study: opt.StudyFile,
    *,
    output: Annotated[Path, Option("--output", "-o", metavar="DIR", help="Folder for the tables.")],
    parquet: Annotated[
        bool, Option("--parquet", help="Also write tables of scenarios, recordings and courses as Parquet.")
    ] = False,
    osi: Annotated[bool, Option("--osi", help="Also write each recording as a trace of ASAM OSI.")] = False,
) -> None:
    """Write everything in a study as tables.

    \b
    Example:
      cornercase export study.db -o tables
      cornercase export study.db --osi -o traces
    """
    from cornercase.study import StudyFile

    with StudyFile.open(study, readonly=True) as opened:
        opened.export(output, parquet=parquet, osi=osi)
    out.print(f"Written to {output}")


def _print_entry(key: str, value: Any, indent: str = "") -> None:
    if isinstance(value, dict):
        out.print(f"{indent}{key}")
        for inner_key, inner_value in value.items():
            _print_entry(inner_key, inner_value, indent + "  ")
    else:
        text = (", ".join(map(_format_value, value)) or "none") if isinstance(value, list) else _format_value(value)
        out.print(f"{indent}{key}: {text}")


def _format_value(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, float) else "–" if value is None else str(value)
