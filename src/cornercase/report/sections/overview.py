"""What was run: the head of the page, where it gets critical, what failed, and how it was made."""

from __future__ import annotations

from collections.abc import Iterator
from html import escape
from typing import Any

from cornercase.metrics import Metric
from cornercase.report.album import Album
from cornercase.report.data import ReportData
from cornercase.report.figures.parameter_space import draw_criticality
from cornercase.report.tables import format_value, make_table
from cornercase.report.template import fill_numbers
from cornercase.report.words import name_range


def tell_overview(data: ReportData) -> Iterator[str]:
    """Give the head of the page.

    Parameters
    ----------
    data : ReportData
        What the report shows.

    Yields
    ------
    str
        HTML.
    """
    summary, meta = data.summary, data.summary.meta
    yield f"<h1>{escape(meta.title)}</h1>"
    yield (
        f"<p>{escape(meta.ego)} is the ego, {escape(meta.other)} the other. Searched by {escape(meta.optimizer)} for"
        f" {'the ' if meta.pareto else ''}{escape(summary.searched)}.</p>"
    )
    yield fill_numbers(
        {
            "scenarios run": summary.run,
            "failed": summary.failed,
            "collisions": summary.collisions,
            "kept": "–" if summary.reduced is None else len(summary.reduced),
            "spent": f"{sum(summary.seconds.values()):.0f} s",
        }
    )


def show_criticality(data: ReportData, album: Album) -> Iterator[str]:
    """Show where in the parameter space it gets critical, by each metric.

    Parameters
    ----------
    data : ReportData
        What the report shows.
    album : Album
        Takes the figures.

    Yields
    ------
    str
        HTML.
    """
    yield "<h2>Where it gets critical</h2>"
    for metric in data.metrics:
        one, unit = data.summary.metrics[metric.name], _unit(metric)
        at = ", ".join(f"{name} = {format_value(value)}" for name, value in one.at.items())
        of_runs = ""
        if one.spread is not None:
            median, largest = one.spread
            of_runs = (
                f" Each was run {data.summary.meta.repeats} times; between its runs the score differs by"
                f" {median:.3g}{unit} in the median scenario, {largest:.3g}{unit} at most."
            )
        yield album.add(
            draw_criticality(data.values, data.parameters, data.scores[metric.name], metric),
            f"criticality-{metric.name}",
            f"Each scenario that was run, by its {metric.name} score. The most critical one is scenario {one.scenario}"
            f" with {one.most_critical:.3g}{unit} ({at}).{of_runs}",
        )


def tell_failures(data: ReportData) -> Iterator[str]:
    """Say why scenarios could not be run.

    Parameters
    ----------
    data : ReportData
        What the report shows.

    Yields
    ------
    str
        HTML.
    """
    if data.failed:
        yield "<h2>Scenarios that could not be run</h2>"
        yield make_table(["scenario", "why"], [[str(row.id), row.error or ""] for row in data.failed], text=(1,))


def tell_provenance(data: ReportData) -> Iterator[str]:
    """Say how the study was made.

    Parameters
    ----------
    data : ReportData
        What the report shows.

    Yields
    ------
    str
        HTML.
    """
    meta = data.summary.meta
    facts: dict[str, Any] = {
        "scenario file": meta.scenario,
        "fingerprint": meta.fingerprint,
        "study": data.study,
        **{f"range of {one.name}": name_range(one) for one in data.parameters},
        "optimizer": meta.optimizer,
        "seed": meta.seed,
        "simulator": meta.simulator,
        **{f"simulator's {key}": value for key, value in meta.settings.items()},
        **{f"time to {stage} [s]": f"{seconds:.2f}" for stage, seconds in data.summary.seconds.items()},
        "cornercase": meta.version,
    }
    yield "<h2>How it was made</h2>"
    yield make_table(["what", "value"], [[key, str(value)] for key, value in facts.items()], text=(0, 1))


def _unit(metric: Metric) -> str:
    return "" if metric.unit == "1" else f" {metric.unit}"
