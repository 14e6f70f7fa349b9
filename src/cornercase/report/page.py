"""The report's HTML page."""

from __future__ import annotations

import base64
from collections.abc import Iterable, Sequence
from html import escape
from pathlib import Path
from typing import Any, Final

import numpy as np

from cornercase._common.errors import InputError
from cornercase._common.files import portable_name, written_whole
from cornercase._common.typing import FloatArray
from cornercase.clustering import EGO_TRAJECTORY, compare_clusterings, unit_of
from cornercase.exploration import Objective
from cornercase.metrics import METRICS, Metric
from cornercase.reduction import gaps
from cornercase.report import figures, tables
from cornercase.report.summary import knowledge, run_spread
from cornercase.study import Row, Study

_MOST_NAMED: Final = 12
_METHODS: Final = {"dbscan": "DBSCAN", "hdbscan": "HDBSCAN"}
_STYLE: Final = """
body{font:16px/1.5 system-ui,sans-serif;max-width:70rem;margin:2rem auto;padding:0 1rem;color:#1a1a1a}
h1{margin-bottom:.2rem}h2{margin-top:2.4rem;border-bottom:1px solid #ccc}figure{margin:1rem 0}img{max-width:100%}
figcaption{color:#444;font-size:.92rem}table{border-collapse:collapse;font-size:.9rem;margin:.8rem 0}
th,td{padding:.25rem .6rem;text-align:right;border-bottom:1px solid #ddd}th{background:#f3f3f3}
td.text,th.text{text-align:left}.wide{overflow-x:auto}.numbers{display:flex;flex-wrap:wrap;gap:1rem;margin:1rem 0}
.numbers div{border:1px solid #ccc;border-radius:.4rem;padding:.4rem .9rem}.numbers b{display:block;font-size:1.5rem}
td.text:first-child{white-space:nowrap}td.text:last-child{min-width:12rem}
@media print{body{margin:0;font-size:11px}h2,figure{break-inside:avoid}}
"""


def write_report(study: Study, path: Path | str) -> None:
    """Write one page without outside references, and its figures as PNG in a folder beside it.

    Parameters
    ----------
    study : Study
        What it was not analysed for is left out.
    path : path
        Of the page; the folder is called after it, with ``-figures`` at the end.

    Raises
    ------
    InputError
        Nothing was run yet, or the page cannot be written.
    """
    path = Path(path)
    if not study.done():
        raise InputError(f"{study.path}: no scenario was run yet, so there is nothing to report.")
    page = _Page(study, path)
    body = "\n".join(page.parts())
    title = escape(f"cornercase: {Path(study.meta.scenario).stem}")
    with written_whole(path) as temporary:
        temporary.write_text(
            "<!DOCTYPE html>\n<html lang='en'><head><meta charset='utf-8'>"
            "<meta name='viewport' content='width=device-width, initial-scale=1'>"
            f"<title>{title}</title><style>{_STYLE}</style></head><body>\n{body}\n</body></html>\n",
            encoding="utf-8",
            newline="\n",
        )


class _Page:
    def __init__(self, study: Study, path: Path) -> None:
        self._study, self._path = study, path
        self._rows = study.done()
        self._metrics: list[Metric] = [METRICS.create(name) for name in study.meta.metrics]
        self._objective = Objective.of_study(study.meta)
        self._scores = {metric.name: study.scores(metric.name) for metric in self._metrics}
        self._recordings = {row.id: study.recording(row.id) for row in self._rows}
        # Choices are drawn by their number.
        self._values: FloatArray = np.array(
            [
                [
                    p.choices.index(str(p.read(row.values))) if p.choices else p.read(row.values)
                    for p in study.space.parameters
                ]
                for row in self._rows
            ],
            dtype=np.float64,
        )
        self._chosen = self._influential()

    def parts(self) -> Iterable[str]:
        yield from self._head()
        yield from self._criticality()
        yield from self._knowledge()
        for name in self._study.analyses():
            yield from self._clustering(name)
        yield from self._agreement()
        yield from self._reduction()
        yield from self._failures()
        yield from self._provenance()

    def _influential(self) -> list[int]:
        """Parameters by the share of the score's variance that ten bins of each explain, the largest first."""
        scores = self._scores[self._metrics[0].name]
        shares = []
        for column in self._values.T:
            bins = np.searchsorted(np.quantile(column, np.linspace(0, 1, 11)[1:-1]), column)
            means = np.array([scores[bins == b].mean() for b in np.unique(bins)])
            counts = np.array([(bins == b).sum() for b in np.unique(bins)])
            shares.append(float((counts * (means - scores.mean()) ** 2).sum()))
        order = sorted(range(len(shares)), key=lambda j: (-shares[j], j))
        return sorted(order[:2]) + order[2:]

    def _head(self) -> Iterable[str]:
        meta, study = self._study.meta, self._study
        collisions = sum(map(self._collides, self._rows))
        reduction = study.reduction()
        seconds = sum(study.elapsed().values())
        yield f"<h1>{escape(Path(meta.scenario).stem)}</h1>"
        searched = escape(self._objective.text)
        yield (
            f"<p>{escape(meta.ego)} is the ego, {escape(meta.other)} the other. Searched by"
            f" {escape(meta.optimizer)} for {'the ' if self._objective.pareto else ''}{searched}.</p>"
        )
        numbers = {
            "scenarios run": len(self._rows),
            "failed": len(study.failed()),
            "collisions": collisions,
            "kept": "–" if reduction is None else len(reduction["kept"]),
            "spent": f"{seconds:.0f} s",
        }
        boxes = "".join(f"<div><b>{value}</b>{escape(name)}</div>" for name, value in numbers.items())
        yield f"<div class='numbers'>{boxes}</div>"

    def _criticality(self) -> Iterable[str]:
        yield "<h2>Where it gets critical</h2>"
        for metric in self._metrics:
            scores = self._scores[metric.name]
            figure = figures.criticality(self._values, self._study.space.parameters, scores, metric)
            worst = int(metric.oriented(scores).argmin())
            at = ", ".join(f"{k} = {_number(v)}" for k, v in self._rows[worst].values.items())
            width, of_runs = run_spread(self._study, metric.name), ""
            if width is not None:
                of_runs = (
                    f" Each was run {self._study.meta.repeats} times; between its runs the score differs by"
                    f" {width[0]:.3g}{_unit(metric)} in the median scenario, {width[1]:.3g}{_unit(metric)}"
                    " at most."
                )
            yield self._figure(
                figure,
                f"criticality-{metric.name}",
                f"Each scenario that was run, by its {metric.name} score. The most critical one is scenario"
                f" {self._rows[worst].id} with {scores[worst]:.3g}{_unit(metric)} ({at}).{of_runs}",
            )

    def _knowledge(self) -> Iterable[str]:
        known = knowledge(self._study, self._objective)
        if "front" in known:
            yield "<h2>The Pareto front</h2>"
            rows = [k for k, row in enumerate(self._rows) if f"scenario {row.id}" in known["front"]]
            scores = [self._scores[metric.name] for metric in self._metrics]
            yield self._figure(
                figures.front(scores, self._metrics, rows),
                "front",
                f"Each scenario that was run, by its scores. Of {len(rows)} no other is as critical in every metric and"
                " more critical in one.",
            )
        if "share" in known.get("critical", {}):
            yield "<h2>What is known of the critical set</h2>"
            yield tables.critical_set(known["critical"], len(self._rows))
        if "sensitivity" in known:
            yield "<h2>What matters</h2>"
            found = known["sensitivity"]
            each, little = found["parameters"], found["of little influence"]
            yield self._figure(
                figures.sensitivities(
                    list(each), [one["first order"] for one in each.values()], [one["total"] for one in each.values()]
                ),
                "sensitivity",
                f"How much of the variance of {self._objective.text} comes from each parameter, by a Gaussian process"
                f" that foretells {max(found['foretold'], 0.0):.0%} of the variance of scenarios that it was not told."
                + (f" Of little influence: {', '.join(little)}." if little else ""),
            )

    def _clustering(self, name: str) -> Iterable[str]:
        arrays, info = self._study.analysis(name, "ids", "labels", "embedding")
        index = {row.id: k for k, row in enumerate(self._rows)}
        rows = [index[i] for i in arrays["ids"].tolist()]
        labels = arrays["labels"]
        what = "the ego's trajectory" if name == EGO_TRAJECTORY else f"the course of {name}"
        yield f"<h2>Kinds of scenario, by {escape(what)}</h2>"
        figure = figures.clusters(
            arrays["embedding"], labels, self._values[rows], self._study.space.parameters, self._chosen[:2]
        )
        yield self._figure(
            figure,
            f"clusters-{name}",
            f"Dynamic Time Warping, RBF kernel PCA (gamma {info['gamma']:.4g}, {100 * info['explained']:.0f} % of the"
            f" variance in three components), {_METHODS[info['method']]} (eps {info['eps']:.4g}, min"
            f" samples {info['min_samples']})."
            + (
                f" The kernel space is that of {info['landmarks']} landmarks; of the kernel between others"
                f" {info['error']:.1%} is lost."
                if info["landmarks"]
                else ""
            )
            + (
                f" Found of {fitted} scenarios; {len(labels) - fitted} have joined them since."
                if (fitted := len(info["fitted"])) < len(labels)
                else ""
            ),
        )
        if chosen_from := tables.choices(info["candidates"], info["gamma"], info["eps"]):
            yield chosen_from
            yield (
                "<p>The best setting for each number of clusters. DBCV and silhouette say how dense and how far apart"
                " clusters are (1 is best), stability how much of them is found again in random parts of 80 %.</p>"
            )
        yield tables.table(
            [
                "cluster",
                "scenarios",
                "collisions",
                *(f"median {m.name} [{m.unit}]" for m in self._metrics),
                "shortest [s]",
                "longest [s]",
            ],
            [
                self._profile(label, [rows[k] for k in np.flatnonzero(labels == label)])
                for label in np.unique(labels).tolist()
            ],
        )
        # Empty where an earlier version analysed the study.
        if info["profiles"]:
            yield tables.in_words(info["profiles"])
        metric = self._metrics[0] if name == EGO_TRAJECTORY else METRICS.create(name)
        ids = [self._rows[k].id for k in rows]
        yield self._figure(
            figures.courses(
                [self._recordings[i].time for i in ids],
                [metric.capped(self._study.course(i, metric.name)) for i in ids],
                labels,
                metric,
            ),
            f"courses-{name}",
            f"Course of {metric.name} in each cluster: median, and the band that holds 80 % of its scenarios.",
        )

    def _agreement(self) -> Iterable[str]:
        found = compare_clusterings(self._study)
        if not found:
            return
        yield "<h2>Do the clusterings agree?</h2>"
        yield tables.table(
            ["by", "and by", "adjusted Rand", "adjusted mutual information", "differ", "scenarios"],
            [
                [
                    a, b, f"{one.rand:.2f}", f"{one.mutual:.2f}", str(len(one.differ)),
                    ", ".join(map(str, one.differ[:_MOST_NAMED])) + (" …" if len(one.differ) > _MOST_NAMED else ""),
                ]
                for (a, b), one in found.items()
            ],
            text=(0, 1, -1),
        )  # fmt: skip
        yield (
            "<p>1 where two clusterings are the same, about 0 where one says nothing of the other. Scenarios differ"
            " where their clusters are not matched with each other.</p>"
        )

    def _profile(self, label: int, members: Sequence[int]) -> list[str]:
        longest = [float(self._recordings[self._rows[k].id].time[-1]) for k in members]
        return [
            figures.look(label)[2],
            str(len(members)),
            str(sum(self._collides(self._rows[k]) for k in members)),
            *(f"{np.median(self._scores[m.name][list(members)]):.3g}" for m in self._metrics),
            f"{min(longest):.2f}",
            f"{max(longest):.2f}",
        ]

    def _reduction(self) -> Iterable[str]:
        reduction = self._study.reduction()
        if reduction is None or not reduction["kept"]:
            return
        yield "<h2>The few to keep</h2>"
        figure = figures.hulls(
            self._values,
            [row.id for row in self._rows],
            self._study.space.parameters,
            reduction,
            self._chosen,
        )
        yield self._figure(
            figure,
            "hulls",
            f"Hull of each cluster by {reduction['by']}, or of its near-convex parts; archetypes (circles), the"
            " prototype of each (star), and what is kept for what these leave out (triangles).",
        )
        parameters = [figures.axis_name(p) for p in self._study.space.parameters]
        yield tables.table(
            ["file", "cluster", "role", *parameters, *(f"{m.name} [{m.unit}]" for m in self._metrics), "why"],
            [
                [
                    item["file"],
                    str(item["cluster"]),
                    item["role"],
                    *(_number(p.read(item["values"])) for p in self._study.space.parameters),
                    *(f"{item['scores'][m.name]:.3g}" for m in self._metrics),
                    item["why"],
                ]
                for item in reduction["kept"]
            ],
            text=(0, 2, -1),
        )
        # Empty where an earlier version reduced the study.
        if reduction["shapes"]:
            yield "<h3>Shapes of the clusters</h3>"
            yield tables.shapes(reduction["shapes"])
            yield (
                "<p>Convexity: how much of what lies between the scenarios of a cluster is the cluster's; from 0.8 on"
                " it counts as convex.</p>"
            )
        yield "<h3>What the kept ones leave out</h3>"
        yield self._figure(
            self._left_out(reduction),
            "coverage",
            "Share of all scenarios, and of the critical ones, whose nearest kept one is at most so far away by Dynamic"
            " Time Warping; beside it k-medoids, and the range that 90 of 100 random choices of as many leave.",
        )
        yield tables.coverage(reduction["coverage"])
        yield (
            "<p>DTW distance from each scenario that was run to the nearest kept one, also as a share of the largest"
            " distance between any two; than how many of 100 random subsets of the same size that is better; and"
            " k-medoids of the same size, which leave a small mean in that one clustering.</p>"
        )
        if reduction["critical"]:
            yield tables.critical_coverage(reduction["critical"])
            yield (
                "<p>Two scenarios are alike where they are closer than a share of what is usual in a cluster. A"
                " critical scenario is on the boundary where one of its neighbours in the parameter space is not"
                " critical. The last two columns foretell scenarios that were not run, by Gaussian processes.</p>"
            )

    def _left_out(self, reduction: dict[str, Any]) -> Any:
        kept = [item["id"] for item in reduction["kept"]]
        ids = [row.id for row in self._rows]
        critical = dict.fromkeys(ids, False)
        limit = self._study.meta.critical
        if limit is not None and not self._objective.pareto:
            scores = self._objective.oriented_of(self._study)
            critical = dict(zip(ids, (scores <= self._objective.flip(limit)).tolist(), strict=True))
        curves = {}
        for name in reduction["coverage"]:
            arrays, _ = self._study.analysis(name, "ids", "distances")
            compared = arrays["ids"].tolist()
            chosen = [compared.index(i) for i in kept if i in compared]
            if chosen:
                curves[name] = gaps(arrays["distances"], chosen), np.array([critical[i] for i in compared])
        return figures.coverage(curves, [unit_of(name) for name in curves])

    def _failures(self) -> Iterable[str]:
        failed = self._study.failed()
        if failed:
            yield "<h2>Scenarios that could not be run</h2>"
            yield tables.table(["scenario", "why"], [[str(row.id), row.error or ""] for row in failed], text=(1,))

    def _provenance(self) -> Iterable[str]:
        meta, study = self._study.meta, self._study
        facts: dict[str, Any] = {
            "scenario file": meta.scenario,
            "fingerprint": meta.fingerprint,
            "study": study.path.name,
            **{
                f"range of {p.name}": ", ".join(p.choices) if p.choices else f"{p.low:g} to {p.high:g} {p.unit}"
                for p in study.space.parameters
            },
            "optimizer": meta.optimizer,
            "seed": meta.seed,
            "simulator": meta.simulator,
            **{f"simulator's {key}": value for key, value in meta.settings.items()},
            **{f"time to {stage} [s]": f"{seconds:.2f}" for stage, seconds in study.elapsed().items()},
            "cornercase": meta.version,
        }
        yield "<h2>How it was made</h2>"
        yield tables.table(["what", "value"], [[key, str(value)] for key, value in facts.items()], text=(0, 1))

    def _collides(self, row: Row) -> bool:
        pair = {self._study.meta.ego, self._study.meta.other}
        return any(set(c.entities) == pair for c in self._recordings[row.id].collisions)

    def _figure(self, figure: Any, name: str, caption: str) -> str:
        data = figures.png(figure)
        with written_whole(
            self._path.with_name(f"{self._path.stem}-figures") / f"{portable_name(name)}.png"
        ) as temporary:
            temporary.write_bytes(data)
        source = base64.b64encode(data).decode()
        text = escape(caption)
        return (
            f"<figure><img alt='{text}' src='data:image/png;base64,{source}'><figcaption>{text}</figcaption></figure>"
        )


def _unit(metric: Metric) -> str:
    return "" if metric.unit == "1" else f" {metric.unit}"


def _number(value: float | str) -> str:
    return value if isinstance(value, str) else f"{value:.6g}"
