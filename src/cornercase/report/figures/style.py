"""Colours, markers and labels shared by all figures."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Final

from cornercase._common import texts
from cornercase.metrics import Metric
from cornercase.report.words import name_axis, name_cluster
from cornercase.scenario import Parameter

if TYPE_CHECKING:
    from contextlib import AbstractContextManager

    from matplotlib.axis import Axis

COLOURS: Final = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000", "#F0E442")
"""Colours by Okabe and Ito, which colour-blind readers can distinguish; markers carry the same information."""
GREY: Final = "#999999"
_MARKERS: Final = ("o", "s", "^", "D", "v", "P", "*", "X")
_LONGEST: Final = 16
_LINE, _LINES = 32, 8


def default_style() -> AbstractContextManager[None]:
    """Return a context in which matplotlib uses its default style, whatever the user has configured."""
    from matplotlib import style

    return style.context("default")


def look_of(cluster: int, names: Mapping[int, str] | None = None) -> tuple[str, str, str]:
    """Return matplotlib colour, marker and legend name of a cluster (-1: noise)."""
    if cluster < 0:
        return GREY, "x", name_cluster(cluster)
    name = (names or {}).get(cluster, name_cluster(cluster))
    return COLOURS[cluster % len(COLOURS)], _MARKERS[cluster % len(_MARKERS)], wrap(name)


def wrap(text: str) -> str:
    """Break a long name into at most eight lines."""
    return texts.wrapped(text, _LINE, _LINES)


def name_score(metric: Metric) -> str:
    """Return the axis label of a metric's score, as ``"wttc score [s], low is critical"``."""
    return f"{metric.name} score [{metric.unit}], {'low' if metric.lower_is_critical else 'high'} is critical"


def set_axis(axis: Axis, parameter: Parameter) -> None:
    """Label an axis with the name of a parameter, and its choices if it has some."""
    axis.set_label_text(name_axis(parameter))
    if parameter.choices:
        axis.set_ticks(range(len(parameter.choices)), [shorten(choice) for choice in parameter.choices])


def shorten(text: str) -> str:
    """Shorten a tick label."""
    return texts.shorten(text, _LONGEST)
