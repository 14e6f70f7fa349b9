"""HTML page that shows how the settings of kernel PCA (gamma) and of DBSCAN (eps) affect the clusters."""

from __future__ import annotations

import base64
import math
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from cornercase._common import validation
from cornercase._common.errors import InputError
from cornercase._common.io.files import check_output_differs_from_source
from cornercase._common.progress import progress_step, show_bars
from cornercase._common.text.sanitize import escape_control_characters
from cornercase._common.typing import FloatArray, IntArray
from cornercase.clustering import Analysis, read_analysis
from cornercase.clustering._settings_map import GAMMAS, OutcomesAndScores, SettingsMap, compute_settings_map
from cornercase.report._report_payload import parameter_columns, round_score
from cornercase.report.html._templates import render_template, write_page
from cornercase.report.text._phrases import describe_aspect, describe_clustering_method
from cornercase.study import StudyFile
from cornercase.study._study_file import open_study

_STYLES: Final = ("style.css", "settings.css")
_SCRIPTS: Final = ("clipboard.js", "colours.js", "settings.js")
_POLICY: Final = "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data:"
# Byte that stands for the label of noise in the page.
_NOISE_BYTE: Final = 255


def write_clustering_settings_page(
    study: StudyFile | Path | str,
    path: Path | str,
    by: Sequence[str] = (),
    *,
    progress: bool = False,
) -> Path:
    """Write an HTML page that shows the effect of the clustering settings, so that an engineer can choose them.

    For each aspect (what scenarios are compared by), the page has a map over gamma, a setting of the kernel, and eps,
    the radius of neighbourhoods in DBSCAN. The map shows the number of clusters, the share of noise, the stability of
    the clusters, their agreement with how scenarios end, and the share of each metric's variance that they explain. For
    each cell of the map, the page shows the clusters in the parameter space and in kernel space, and the command that
    sets this gamma and eps. The study is not changed. The page warns that a high agreement is no evidence for clusters
    if their settings were chosen because of this agreement.

    Parameters
    ----------
    study : Study, StudyFile or path
        Study that was analyzed before. If it has more than 500 scenarios, a random sample of 500 is clustered.
    path : path
        Page to write; the name ends with ``.html`` or ``.htm``. The same study gives the same bytes.
    by : sequence of str, optional
        Aspects to show; by default all aspects by which the study was analyzed.
    progress : bool, default False
        Show a progress bar.

    Returns
    -------
    Path
        The page.

    Raises
    ------
    InputError
        The study was not analyzed, or not by one of the aspects, or the file cannot be written.

    See Also
    --------
    cornercase.analyze : Cluster with the chosen settings.

    Examples
    --------
    >>> from cornercase.report import write_clustering_settings_page
    >>> write_clustering_settings_page("study.db", "settings.html")  # doctest: +SKIP
    PosixPath('settings.html')
    """
    path = validation.check_path("path", path)
    with open_study(study, readonly=True) as opened:
        check_output_differs_from_source(path, opened.path)
        if path.suffix.lower() not in (".html", ".htm"):
            raise InputError(f"{path}: is not the name of a page; give a file name that ends with .html.")
        aspects = tuple(by) or tuple(opened.analyzed_aspects())
        if not aspects:
            raise InputError(f"{opened.path}: was not analyzed yet; run 'cornercase analyze' first.")
        page = _render_page(opened, aspects, progress)
    write_page(path, page)
    return path


def _render_page(study: StudyFile, aspects: Sequence[str], progress: bool) -> str:
    analyses = [read_analysis(study, name) for name in aspects]
    observed = OutcomesAndScores.from_study(study)
    maps: list[SettingsMap] = []
    with show_bars(progress), progress_step(len(analyses) * len(GAMMAS), "clustering", "kernels") as update:
        for k, analysis in enumerate(analyses):

            def report_kernel(done: int, before: int = k * len(GAMMAS)) -> None:
                update(before + done)

            maps.append(compute_settings_map(study, analysis, observed, report_kernel))
    rows = {row.id: row for row in study.finished_rows()}
    parameters = study.space.parameters
    contents = {
        "parameters": [
            {"name": item.name, "unit": item.unit, "low": item.low, "high": item.high, "choices": list(item.choices)}
            for item in parameters
        ],
        "metrics": [{"name": metric.name, "unit": metric.unit} for metric in study.meta.create_metrics()],
        "outcomes": list(observed.outcome_names),
        "scenarios": {
            "id": observed.ids.tolist(),
            "values": parameter_columns(parameters, [rows[scenario] for scenario in observed.ids.tolist()]),
            "scores": {name: [round_score(x) for x in scores.tolist()] for name, scores in observed.scores.items()},
            "outcome": observed.outcome.tolist(),
        },
        "aspects": [
            _aspect_payload(study, analysis, settings_map, observed)
            for analysis, settings_map in zip(analyses, maps, strict=True)
        ],
    }
    return render_template(
        "settings.html.j2",
        _STYLES,
        _SCRIPTS,
        policy=_POLICY,
        title=escape_control_characters(f"Settings of the clustering: {study.meta.title}"),
        about=escape_control_characters(f"From {study.path.name}. {study.meta.roles_text}"),
        contents=contents,
    )


def _aspect_payload(
    study: StudyFile, analysis: Analysis, settings_map: SettingsMap, observed: OutcomesAndScores
) -> dict[str, Any]:
    rows, clustering = settings_map.rows, analysis.clustering
    row_of = {scenario: row for row, scenario in enumerate(observed.ids.tolist())}
    distinct, which = np.unique(settings_map.labels.reshape(-1, len(rows)), axis=0, return_inverse=True)
    scores: list[tuple[str, str, FloatArray]] = [
        ("clusters", "Number of clusters", settings_map.n_clusters.astype(np.float64)),
        ("noise", "Noise [%]", 100.0 * settings_map.noise),
        ("stability", "Stability", settings_map.stability),
        ("agreement", "Agreement with the outcome", settings_map.agreement),
        *(
            (f"explained {name}", f"Explained variance of {name} [%]", 100.0 * share)
            for name, share in settings_map.explained.items()
        ),
    ]
    command = ["cornercase", "analyze", study.path.name, "--by", analysis.by]
    if analysis.window is not None:
        command += ["--window", f"{analysis.window:g}"]
    return {
        "name": analysis.by,
        "compares": "" if analysis.by in study.meta.metrics else describe_aspect(analysis.by),
        "unit": analysis.unit,
        "scale": clustering.scale,
        "scenarios": len(analysis.ids),
        "rows": [row_of[scenario] for scenario in analysis.ids[rows].tolist()],
        "gammas": list(settings_map.gammas),
        "eps": list(settings_map.eps),
        "min_samples": list(settings_map.min_samples),
        "usual": _index_of_usual_min_samples(settings_map, clustering.min_samples),
        "labels": base64.b64encode(_label_bytes(distinct)).decode(),
        "which": which.reshape(-1).tolist(),
        "scores": [
            {"key": key, "title": title, "values": [_rounded(x) for x in values.ravel().tolist()]}
            for key, title, values in scores
        ],
        "embeddings": [_first_two_components(embedding) for embedding in settings_map.embeddings],
        "chosen": {
            "labels": base64.b64encode(_label_bytes(analysis.labels[rows])).decode(),
            "embedding": _first_two_components(clustering.embedding[rows]),
            "gamma": clustering.gamma,
            "eps": clustering.eps if clustering.method == "dbscan" else None,
            "min_samples": clustering.min_samples,
            "text": describe_clustering_method(analysis),
        },
        "command": shlex.join(command),
    }


def _index_of_usual_min_samples(settings_map: SettingsMap, chosen: int) -> int:
    """Return the index of `chosen`, the min_samples of the study, in the map; the middle index if the map lacks it."""
    counts = settings_map.min_samples
    return counts.index(chosen) if chosen in counts else len(counts) // 2


def _label_bytes(labels: IntArray) -> bytes:
    return np.where(labels < 0, _NOISE_BYTE, labels).astype(np.uint8).tobytes()


def _first_two_components(embedding: FloatArray) -> list[list[float]]:
    """Return the first two components of an embedding (n, d) as two lists; a missing component is filled with zeros."""
    padded = np.zeros((2, len(embedding)))
    padded[: min(2, embedding.shape[1])] = embedding[:, :2].T
    return [[round(x, 4) for x in component] for component in padded.tolist()]


def _rounded(value: float) -> float | None:
    return round(value, 3) if math.isfinite(value) else None
