"""Selection and encoding of the recordings that a report page contains."""

from __future__ import annotations

import base64
import math
from collections.abc import Collection, Iterator, Sequence
from typing import Final

import numpy as np

from cornercase.report._report_data import ReportData
from cornercase.study import StudyFile

# Number of recordings from which the total size is estimated.
_SIZE_SAMPLE: Final = 64


def encode_recordings(study: StudyFile, ids: Sequence[int], *, max_characters: float = math.inf) -> dict[int, str]:
    """Encode recordings as base64 texts by scenario id; stop once the texts together exceed `max_characters`."""
    texts: dict[int, str] = {}
    size = 0
    for scenario in ids:
        if size > max_characters:
            break
        texts[scenario] = base64.b64encode(study.rounded_recording(scenario)).decode()
        size += len(texts[scenario])
    return texts


def encode_important_recordings(
    study: StudyFile,
    data: ReportData,
    *,
    max_characters: int = 16_000_000,
    sample_characters: int = 8_000_000,
    n_most_critical: int = 100,
) -> dict[int, str]:
    """Encode all recordings of a study, or only the most important ones if all together exceed `max_characters`.

    In the second case, recordings are encoded up to about `sample_characters`. First come the reduced set, examples of
    clusters, the Pareto front and the `n_most_critical` scenarios by each metric, then an even sample of the others.
    With the defaults, a page of 20,000 scenarios stays below 30 MB.
    """
    ids = [row.id for row in data.rows]
    first = list(dict.fromkeys(_important_ids(data, n_most_critical)))
    first_ids = set(first)
    rest = [ids[k] for k in _van_der_corput_order(len(ids)) if ids[k] not in first_ids]
    sample = encode_recordings(study, (rest or first)[:_SIZE_SAMPLE])
    expected = sum(map(len, sample.values())) / max(len(sample), 1) * len(ids)
    return encode_recordings(
        study, [*first, *rest], max_characters=math.inf if expected <= max_characters else sample_characters
    )


def describe_left_out_recordings(data: ReportData, recordings: Collection[int]) -> str:
    """Describe which recordings the report page contains; the text is empty if the page contains all of them."""
    n_contained, run = len(recordings), len(data.rows)
    if n_contained == run:
        return ""
    return (
        f"This file holds {n_contained} of the {run} recordings, as all would make it too large: those of the kept"
        " scenarios, of the examples of kinds, of the Pareto front and of the most critical ones, and an even sample of"
        " the others; cornercase watch shows all of them."
    )


def _important_ids(data: ReportData, n_most_critical: int) -> Iterator[int]:
    """Yield the ids of the scenarios that users look at first; an id may be repeated."""
    summary = data.summary
    if summary.reduced_set is not None:
        yield from summary.reduced_set.ids
    yield from data.examples
    yield from summary.estimates.pareto_front or ()
    ids = np.array([row.id for row in data.rows])
    for metric in data.metrics:
        oriented = metric.to_minimize(data.scores[metric.name])
        yield from ids[np.argsort(oriented, kind="stable")[:n_most_critical]].tolist()


def _van_der_corput_order(count: int) -> list[int]:
    """Return the numbers from 0 to `count` - 1 in van der Corput order.

    For each k, the first k numbers are spread evenly over all numbers.
    """
    bits = max(count - 1, 1).bit_length()
    mirrored = (int(f"{k:0{bits}b}"[::-1], 2) for k in range(1 << bits))
    return [k for k in mirrored if k < count]
