"""The recordings of a study, as a page holds them."""

from __future__ import annotations

import base64
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from cornercase.metrics import METRICS
from cornercase.report.blocks import pack_block, pack_record
from cornercase.report.data import ReportData
from cornercase.study import Study

_IN_BLOCK: Final = 16
# Recordings of which the size of all is predicted.
_TRIED: Final = 64
# Characters of the recordings that a page has, where all are few enough, and where only some are in it: with what else
# there is of 20,000 scenarios, a page has less than 30 MB.
_WHOLE, _SAMPLE = 16_000_000, 8_000_000
# The most critical scenarios by each metric that are among them.
_MOST_CRITICAL: Final = 100


@dataclass(frozen=True, eq=False)
class PackedRecordings:
    """Recordings of a study in compressed blocks.

    Attributes
    ----------
    blocks : tuple of str
        In base64.
    index : mapping of str to (int, int)
        By id the block, and where in it the recording begins.
    """

    blocks: tuple[str, ...]
    index: dict[str, list[int]]


def pack_recordings(study: Study, ids: Sequence[int], *, most: int | None = None) -> PackedRecordings:
    """Pack recordings of a study.

    Parameters
    ----------
    study : Study
        Open.
    ids : sequence of int
        Scenarios that were run, those that are looked at together next to each other.
    most : int, optional
        Characters that the blocks have together, about; what comes after that is left out.

    Returns
    -------
    PackedRecordings
        In this order.
    """
    blocks: list[str] = []
    index: dict[str, list[int]] = {}
    size = 0
    for k in range(0, len(ids), _IN_BLOCK):
        if most is not None and size > most:
            break
        some = ids[k : k + _IN_BLOCK]
        block, offsets = pack_block(list(_records(study, some)))
        index |= {str(one): [len(blocks), offset] for one, offset in zip(some, offsets, strict=True)}
        blocks.append(base64.b64encode(block).decode())
        size += len(blocks[-1])
    return PackedRecordings(tuple(blocks), index)


def pack_most(study: Study, data: ReportData) -> PackedRecordings:
    """Pack all recordings of a study, or where that were too many for a page, those that tell most.

    Parameters
    ----------
    study : Study
        Open.
    data : ReportData
        What the report shows of it.

    Returns
    -------
    PackedRecordings
        Those of the kept scenarios, of the examples of kinds, of the Pareto front and of the most critical ones first,
        then the others in an order of which each beginning is spread evenly over all.
    """
    ids = [row.id for row in data.rows]
    first = list(dict.fromkeys(_telling(data)))
    known = set(first)
    rest = [ids[k] for k in _spread(len(ids)) if ids[k] not in known]
    some = pack_recordings(study, rest[:_TRIED])
    expected = sum(map(len, some.blocks)) / max(len(some.index), 1) * len(ids)
    return pack_recordings(study, [*first, *rest], most=None if expected <= _WHOLE else _SAMPLE)


def tell_left_out(data: ReportData, packed: PackedRecordings) -> str:
    """Say which recordings a page does not have.

    Parameters
    ----------
    data : ReportData
        What the report shows.
    packed : PackedRecordings
        Recordings of the page.

    Returns
    -------
    str
        A sentence; empty where it has all.
    """
    there, run = len(packed.index), len(data.rows)
    if there == run:
        return ""
    return (
        f"This file holds {there} of the {run} recordings, as all would make it too large: those of the kept scenarios,"
        " of the examples of kinds, of the Pareto front and of the most critical ones, and an even sample of the"
        " others; cornercase watch shows all of them."
    )


def _telling(data: ReportData) -> Iterator[int]:
    """Ids of the scenarios that are looked at first."""
    summary = data.summary
    if summary.reduced is not None:
        yield from summary.reduced.ids
    yield from data.examples
    yield from summary.knowledge.front or ()
    ids = np.array([row.id for row in data.rows])
    for one in data.metrics:
        oriented = one.oriented(data.scores[one.name])
        yield from ids[np.argsort(oriented, kind="stable")[:_MOST_CRITICAL]].tolist()


def _spread(count: int) -> list[int]:
    """Numbers below `count` in van der Corput's order: each beginning is spread evenly over all."""
    bits = max(count - 1, 1).bit_length()
    mirrored = (int(f"{k:0{bits}b}"[::-1], 2) for k in range(1 << bits))
    return [k for k in mirrored if k < count]


def _records(study: Study, ids: Sequence[int]) -> Iterator[bytes]:
    metrics = [METRICS.create(name) for name in study.meta.metrics]
    for scenario in ids:
        courses = {one.name: one.capped(study.course(scenario, one.name)) for one in metrics}
        yield pack_record(scenario, study.recording(scenario), courses)
