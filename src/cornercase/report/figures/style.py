"""Colours, markers and names that all figures share."""

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
"""Okabe and Ito's colours, which the colour-blind can tell apart; markers show the same."""
GREY: Final = "#999999"
_MARKERS: Final = ("o", "s", "^", "D", "v", "P", "*", "X")
_LONGEST: Final = 16
_LINE, _LINES = 32, 8


def default_style() -> AbstractContextManager[None]:
    """Draw within the block as matplotlib does by default, whatever a user has set for figures.

    Returns
    -------
    context manager
    """
    from matplotlib import style

    return style.context("default")


def look_of(cluster: int, names: Mapping[int, str] | None = None) -> tuple[str, str, str]:
    """Give the colour, the marker and the name of a cluster.

    Parameters
    ----------
    cluster : int
        -1 is noise.
    names : mapping of int to str, optional
        What clusters are called.

    Returns
    -------
    colour, marker, name : str
        A colour and a marker of matplotlib, and a name for the legend.
    """
    if cluster < 0:
        return GREY, "x", name_cluster(cluster)
    name = (names or {}).get(cluster, name_cluster(cluster))
    return COLOURS[cluster % len(COLOURS)], _MARKERS[cluster % len(_MARKERS)], wrap(name)


def wrap(text: str) -> str:
    """Break a long name into lines.

    Parameters
    ----------
    text : str
        Any text.

    Returns
    -------
    str
        Eight lines at most: enough for all names of kinds but those of entities with very long names.
    """
    return texts.wrapped(text, _LINE, _LINES)


def name_score(metric: Metric) -> str:
    """Name the score of a metric, with its unit and what is critical.

    Parameters
    ----------
    metric : Metric
        Says what is critical.

    Returns
    -------
    str
        ``"wttc score [s], low is critical"``.
    """
    return f"{metric.name} score [{metric.unit}], {'low' if metric.lower_is_critical else 'high'} is critical"


def set_axis(axis: Axis, parameter: Parameter) -> None:
    """Write the name of a parameter at an axis, and its choices where it has some.

    Parameters
    ----------
    axis : matplotlib.axis.Axis
        Axis of a figure.
    parameter : Parameter
        The parameter.
    """
    axis.set_label_text(name_axis(parameter))
    if parameter.choices:
        axis.set_ticks(range(len(parameter.choices)), [shorten(choice) for choice in parameter.choices])


def shorten(text: str) -> str:
    """Cut a text that is too long for a tick.

    Parameters
    ----------
    text : str
        Any text.

    Returns
    -------
    str
        With an ellipsis where it was cut.
    """
    return texts.shorten(text, _LONGEST)
