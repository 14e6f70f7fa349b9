"""The reduced set, and what it leaves out."""

from __future__ import annotations

from collections.abc import Iterator

from cornercase.reduction import ReducedSet
from cornercase.report import tables
from cornercase.report.album import Album
from cornercase.report.data import ReportData
from cornercase.report.figures.parameter_space import draw_hulls
from cornercase.report.figures.scores import draw_coverage
from cornercase.report.figures.style import name_axis


def show_kept(data: ReportData, album: Album) -> Iterator[str]:
    """Show the scenarios that are kept, and what they leave out.

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
    reduced = data.summary.reduced
    if reduced is None or not reduced.kept:
        return
    yield "<h2>The few to keep</h2>"
    yield album.add(
        draw_hulls(data.values, [row.id for row in data.rows], data.parameters, reduced, data.influential),
        "hulls",
        f"Hull of each cluster by {reduced.by}, or of its near-convex parts; archetypes (circles), the prototype of"
        " each (star), and what is kept for what these leave out (triangles).",
    )
    yield tables.make_table(
        [
            "file",
            "cluster",
            "role",
            *map(name_axis, data.parameters),
            *(f"{metric.name} [{metric.unit}]" for metric in data.metrics),
            "why",
        ],
        [
            [
                one.file,
                str(one.cluster),
                one.role,
                *(tables.format_value(parameter.read(one.values)) for parameter in data.parameters),
                *(f"{one.scores[metric.name]:.3g}" for metric in data.metrics),
                one.why,
            ]
            for one in reduced.kept
        ],
        text=(0, 2, -1),
    )
    # A study that was reduced by an early version has none.
    if reduced.shapes:
        yield "<h3>Shapes of the clusters</h3>"
        yield tables.tell_shapes(reduced.shapes)
        yield (
            "<p>Convexity: how much of what lies between the scenarios of a cluster is the cluster's; from 0.8 on it"
            " counts as convex.</p>"
        )
    yield from _show_left_out(data, album, reduced)


def _show_left_out(data: ReportData, album: Album, reduced: ReducedSet) -> Iterator[str]:
    yield "<h3>What the kept ones leave out</h3>"
    curves = {
        name: (gaps, data.critical[data.rows_of(data.summary.analyses[name].ids.tolist())])
        for name, gaps in data.gaps.items()
    }
    yield album.add(
        draw_coverage(curves, [data.summary.analyses[name].unit for name in curves]),
        "coverage",
        "Share of all scenarios that were run, and of the critical ones, whose nearest kept one is at most so far away"
        " by Dynamic Time Warping; beside it k-medoids, and the range that 90 of 100 random choices of as many leave."
        " The kept ones and k-medoids were chosen from these scenarios.",
    )
    yield tables.tell_coverage(reduced.coverage)
    yield (
        "<p>DTW distance from each scenario that was run to the nearest kept one, also as a share of the largest"
        " distance between any two. The kept ones were chosen to make these small.</p>"
    )
    if judged := tables.tell_held_out(reduced.coverage):
        yield judged
        yield (
            "<p>What chose a set does not grade it: the same of scenarios that were held out, each fifth of them (one"
            " fifth where there are many) from a set that was chosen in the same way from the other four; than how many"
            " of 100 random subsets of these four that is better; and k-medoids of these four, which leave a small mean"
            " in that one clustering.</p>"
        )
    if reduced.critical:
        yield tables.tell_critical_coverage(reduced.critical)
        yield (
            "<p>Two scenarios are alike where they are closer than a share of what is usual in a cluster. Held out:"
            " critical scenarios that did not choose the set, as above. A critical scenario is on the boundary where"
            " one of its neighbours in the parameter space is not critical. The last two columns predict scenarios that"
            " were not run, by Gaussian processes.</p>"
        )
