"""Colours, markers and labels shared by all figures."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Final

from cornercase._common.text import sanitize
from cornercase.metrics import Metric
from cornercase.report.text._phrases import format_axis_label, format_cluster_name
from cornercase.scenario import Parameter

if TYPE_CHECKING:
    from contextlib import AbstractContextManager

    from matplotlib.axis import Axis

COLOURS: Final = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000", "#F0E442")
"""Colours by Okabe and Ito, which colour-blind readers can distinguish; markers carry the same information."""
GREY: Final = "#999999"
_MARKERS: Final = ("o", "s", "^", "D", "v", "P", "*", "X")
_MAX_TICK_LENGTH: Final = 16
_MAX_LINE_LENGTH, _MAX_LINES = 32, 8


def matplotlib_defaults() -> AbstractContextManager[None]:
    """Return a context in which matplotlib uses its default style instead of the user's settings."""
    from matplotlib import style

    return style.context("default")


def cluster_style(cluster: int, name_by_cluster: Mapping[int, str] | None = None) -> tuple[str, str, str]:
    """Return colour, marker and legend name of a cluster for matplotlib; -1 is noise."""
    if cluster < 0:
        return GREY, "x", format_cluster_name(cluster)
    name = (name_by_cluster or {}).get(cluster, format_cluster_name(cluster))
    return COLOURS[cluster % len(COLOURS)], _MARKERS[cluster % len(_MARKERS)], wrap_name(name)


def wrap_name(text: str) -> str:
    """Break a long name into at most eight lines."""
    return sanitize.wrap_text(text, _MAX_LINE_LENGTH, _MAX_LINES)


def format_score_label(metric: Metric) -> str:
    """Return the axis label of a metric's score, such as ``"wttc score [s], low is critical"``."""
    return f"{metric.name} score [{metric.unit}], {'low' if metric.lower_is_critical else 'high'} is critical"


def label_axis(axis: Axis, parameter: Parameter) -> None:
    """Label an axis with the name and unit of a parameter; its choices, if any, become the ticks."""
    axis.set_label_text(format_axis_label(parameter))
    if parameter.choices:
        axis.set_ticks(range(len(parameter.choices)), [shorten_tick_label(choice) for choice in parameter.choices])


def shorten_tick_label(text: str) -> str:
    """Shorten a tick label to at most 16 characters."""
    return sanitize.shorten(text, _MAX_TICK_LENGTH)
