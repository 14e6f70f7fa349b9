"""The recordings of a study, as a page holds them."""

from __future__ import annotations

import base64
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

from cornercase.metrics import METRICS
from cornercase.report.blocks import pack_block, pack_record
from cornercase.study import Study

_IN_BLOCK: Final = 16


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


def pack_recordings(study: Study, ids: Sequence[int]) -> PackedRecordings:
    """Pack recordings of a study.

    Parameters
    ----------
    study : Study
        Open.
    ids : sequence of int
        Scenarios that were run, those that are looked at together next to each other.

    Returns
    -------
    PackedRecordings
        In this order.
    """
    blocks: list[str] = []
    index: dict[str, list[int]] = {}
    for k in range(0, len(ids), _IN_BLOCK):
        some = ids[k : k + _IN_BLOCK]
        block, offsets = pack_block(list(_records(study, some)))
        index |= {str(one): [len(blocks), offset] for one, offset in zip(some, offsets, strict=True)}
        blocks.append(base64.b64encode(block).decode())
    return PackedRecordings(tuple(blocks), index)


def _records(study: Study, ids: Sequence[int]) -> Iterator[bytes]:
    metrics = [METRICS.create(name) for name in study.meta.metrics]
    for scenario in ids:
        courses = {one.name: one.capped(study.course(scenario, one.name)) for one in metrics}
        yield pack_record(scenario, study.recording(scenario), courses)
