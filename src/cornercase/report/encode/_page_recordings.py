"""Select and compress the recordings that a page contains."""

from __future__ import annotations

import base64
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from cornercase.report._report_data import ReportData
from cornercase.report.encode._record_format import compress_records, encode_recording
from cornercase.study import StudyFile

_RECORDINGS_PER_BLOCK: Final = 16
# Number of recordings from which the total size is estimated.
_SIZE_SAMPLE: Final = 64


@dataclass(frozen=True, eq=False)
class PackedRecordings:
    """Recordings of a study in compressed blocks."""

    blocks: tuple[str, ...]  # base64
    index: dict[str, list[int]]  # by id: block and offset in the unpacked block


def encode_recordings(study: StudyFile, ids: Sequence[int], *, max_characters: int | None = None) -> PackedRecordings:
    """Compress recordings in the order of `ids`, up to about `max_characters` of text.

    Recordings that are likely to be viewed together should be neighbours: they share a block.
    """
    blocks: list[str] = []
    index: dict[str, list[int]] = {}
    size = 0
    for k in range(0, len(ids), _RECORDINGS_PER_BLOCK):
        if max_characters is not None and size > max_characters:
            break
        block_ids = ids[k : k + _RECORDINGS_PER_BLOCK]
        block, offsets = compress_records(list(_encode_records(study, block_ids)))
        index |= {str(scenario): [len(blocks), offset] for scenario, offset in zip(block_ids, offsets, strict=True)}
        blocks.append(base64.b64encode(block).decode())
        size += len(blocks[-1])
    return PackedRecordings(tuple(blocks), index)


def encode_important_recordings(
    study: StudyFile,
    data: ReportData,
    *,
    max_characters: int = 16_000_000,
    sample_characters: int = 8_000_000,
    n_most_critical: int = 100,
) -> PackedRecordings:
    """Compress all recordings of a study, or only the most important ones if all exceed `max_characters`.

    The important ones take about `sample_characters`: first the reduced set, examples of clusters, the Pareto front and
    the most critical scenarios by each metric, then an even sample of the others. With the defaults, a page of 20,000
    scenarios stays below 30 MB.
    """
    ids = [row.id for row in data.rows]
    first = list(dict.fromkeys(_important_ids(data, n_most_critical)))
    first_ids = set(first)
    rest = [ids[k] for k in _van_der_corput_order(len(ids)) if ids[k] not in first_ids]
    sample = encode_recordings(study, rest[:_SIZE_SAMPLE])
    expected = sum(map(len, sample.blocks)) / max(len(sample.index), 1) * len(ids)
    return encode_recordings(
        study, [*first, *rest], max_characters=None if expected <= max_characters else sample_characters
    )


def describe_left_out_recordings(data: ReportData, recordings: PackedRecordings) -> str:
    """Describe which recordings the page lacks; empty if it contains all of them."""
    n_contained, run = len(recordings.index), len(data.rows)
    if n_contained == run:
        return ""
    return (
        f"This file holds {n_contained} of the {run} recordings, as all would make it too large: those of the kept"
        " scenarios, of the examples of kinds, of the Pareto front and of the most critical ones, and an even sample of"
        " the others; cornercase watch shows all of them."
    )


def _important_ids(data: ReportData, n_most_critical: int) -> Iterator[int]:
    """Yield ids of the scenarios that users look at first."""
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
    """Return 0 to `count` - 1 in van der Corput order: any number of first values is evenly spread."""
    bits = max(count - 1, 1).bit_length()
    mirrored = (int(f"{k:0{bits}b}"[::-1], 2) for k in range(1 << bits))
    return [k for k in mirrored if k < count]


def _encode_records(study: StudyFile, ids: Sequence[int]) -> Iterator[bytes]:
    metrics = study.meta.create_metrics()
    for scenario in ids:
        recording, courses = study.recording_and_courses(scenario)
        clipped = {metric.name: metric.clip_course(courses[metric.name]) for metric in metrics}
        yield encode_recording(scenario, recording, clipped)
