"""Section on the estimated probabilities of rare events, and the parameter distributions that they hold for."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from html import escape
from itertools import pairwise
from typing import Any, Final

from cornercase.report._report_data import ReportData
from cornercase.report.html._tables import Section, make_section, render_table
from cornercase.report.text._phrases import format_range, use_math_signs
from cornercase.scenario import Parameter

_EVENTS: Final = (
    "critical",
    "collision",
    "encounter",
    "critical given an encounter",
    "collision given an encounter",
)
# Most weights of a distribution that are listed.
_MAX_LISTED: Final = 12


def render_probability(data: ReportData) -> Iterator[Section]:
    """Yield the section on estimated probabilities and their certainty; nothing if the study has no estimate."""
    estimate = data.summary.probability
    if estimate is None:
        return
    rows = [
        _format_event_row(_name_event(event, estimate), estimate[event])
        for event in _EVENTS
        if isinstance(estimate.get(event), Mapping)
    ]
    head = [
        "event", "probability", "95 % interval", "90 % interval", "standard error", "met in", "effectively", "method",
        "plain Monte Carlo would need",
    ]  # fmt: skip
    yield make_section(
        "probability",
        "How probable is it, and how sure is that?",
        [
            render_table(head, rows, left_aligned=(0, -2)),
            *(f"<p>{escape(sentence)}</p>" for sentence in _describe_certainty(estimate)),
            "<p>The probabilities hold for these distributions of the parameters, which are independent but for"
            " constraints, and for nothing else:</p>",
            render_table(
                ["parameter", "range", "distribution"],
                [
                    [parameter.name, format_range(parameter), describe_distribution(parameter)]
                    for parameter in data.parameters
                ],
                left_aligned=(0, 1, 2),
            ),
        ],
    )


def _describe_certainty(estimate: Mapping[str, Any]) -> Iterator[str]:
    """Yield sentences on the certainty of an estimate, its warnings, and the scenarios behind it."""
    events = [estimate["critical"], estimate["collision"]]
    if all(event.get("relative standard error") == 0.0 for event in events):
        yield "How sure: these are the probabilities themselves, as all scenarios of the space were run."
        return
    yield (
        "How sure: the interval is made to hold the true probability in 95, or 90, of 100 estimates. The fewer"
        " scenarios met the event effectively, the less it can be trusted."
    )
    yield from estimate["warnings"] or ["No warning: enough scenarios met each event, and none of them dominates."]
    if learned := estimate.get("to learn where to draw"):
        is_weighted = any("importance" in str(event.get("method")) for event in events)
        weighted = " The others were drawn where critical ones are frequent, and each has a weight."
        yield (
            f"{learned} of the {estimate['scenarios']} scenarios were run only to learn where to draw."
            f"{weighted if is_weighted else ''} So the share of the scenarios on this page that collide is not the"
            " probability."
        )


def _name_event(event: str, estimate: Mapping[str, Any]) -> str:
    name, *given = event.partition(" given")
    condition = estimate.get("an encounter is") if name == "encounter" else None
    condition = estimate["critical is"] if name == "critical" else condition
    return "".join((name, f" ({use_math_signs(str(condition))})" if condition else "", *given))


def _format_event_row(name: str, event: Mapping[str, Any]) -> list[str]:
    def format_interval(key: str) -> str:
        low, high = event[key]
        return f"{low:.3g} to {high:.3g}"

    def format_number(key: str, unit: str = "") -> str:
        value = event.get(key)
        return f"{value:.3g}{unit}" if isinstance(value, int | float) and math.isfinite(value) else "–"

    error = event.get("relative standard error")
    return [
        name,
        format_number("probability"),
        format_interval("95 % interval"),
        format_interval("90 % interval") if event.get("90 % interval") else "–",
        f"{100.0 * error:.1f} %" if isinstance(error, float) and math.isfinite(error) else "–",
        f"{event.get('met in', 0)} of {event.get('scenarios', 0)}",
        format_number("effective number met"),
        str(event.get("method", "–")),
        format_number("plain Monte Carlo would need"),
    ]


def describe_distribution(parameter: Parameter) -> str:
    """Describe the distribution of a parameter, as ``"Poisson, mean 3"``."""
    distribution = parameter.distribution
    if distribution is None:
        return "uniform, as the file names none"
    numbers = distribution.shape_parameters
    if distribution.kind == "normal":
        return f"normal, mean {numbers[0]:.4g}, standard deviation {numbers[1]:.4g}, cut off at the ends of the range"
    if distribution.kind == "lognormal":
        return (
            f"log-normal, mean {numbers[0]:.4g} and standard deviation {numbers[1]:.4g} of the logarithm, cut off at"
            " the ends of the range"
        )
    if distribution.kind == "poisson":
        return f"Poisson, mean {numbers[0]:.4g}"
    if distribution.kind == "histogram":
        n_edges = len(numbers) // 2 + 1
        edges, weights = numbers[:n_edges], numbers[n_edges:]
        bins = [f"{low:.4g} to {high:.4g}" for low, high in pairwise(edges)]
        return f"histogram: {_format_weights(bins, weights)}"
    if distribution.kind == "set":
        values = list(parameter.choices) or [str(k + 1) for k in range(len(numbers))]
        return f"set: {_format_weights(values, numbers)}"
    return distribution.kind


def _format_weights(names: list[str], weights: tuple[float, ...]) -> str:
    total = sum(weights) or 1.0
    texts = [f"{name} {100.0 * weight / total:.3g} %" for name, weight in zip(names, weights, strict=False)]
    more = len(texts) - _MAX_LISTED
    return ", ".join(texts[:_MAX_LISTED]) + (f" and {more} more" if more > 0 else "")
