"""The page of a replay: one HTML file without outside references, and with nothing but the replay."""

from __future__ import annotations

import base64
from typing import Any, Final

from cornercase.report.blocks import pack_block, pack_record
from cornercase.report.contents import plain_score, plain_values, tell_against, tell_subject
from cornercase.report.page import REPLAY_SCRIPTS
from cornercase.report.replays.footage import Footage
from cornercase.report.roads import pack_roads
from cornercase.report.templates import fill_template
from cornercase.report.words import tell_roles

_STYLES: Final = ("style.css", "replay.css")
_SCRIPTS: Final = ("store.js", "recordings.js", *REPLAY_SCRIPTS, "replay/alone.js")
_POLICY: Final = "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data:"


def fill_replay(footage: Footage) -> str:
    """Put the page of a replay together.

    Parameters
    ----------
    footage : Footage
        What it shows.

    Returns
    -------
    str
        HTML; the same for the same study.
    """
    unique = {take.row.id: take for take in footage.takes}
    block, offsets = pack_block(
        [pack_record(one, take.recording, take.courses) for one, take in sorted(unique.items())]
    )
    index = {str(one): [0, offset] for one, offset in zip(sorted(unique), offsets, strict=True)}
    meta = footage.meta
    which = " beside ".join(str(take.row.id) for take in footage.takes)
    return fill_template(
        "replay.html.j2",
        _STYLES,
        _SCRIPTS,
        policy=_POLICY,
        title=f"{meta.title}, scenario {which}",
        about=f"From {footage.study}. {tell_roles(meta)}",
        contents=_contents(footage) | {"recordings": index},
        blocks=[base64.b64encode(block).decode()],
    )


def _contents(footage: Footage) -> dict[str, Any]:
    """What the page of a study knows, of these scenarios only."""
    meta, metrics = footage.meta, footage.metrics
    takes = sorted({take.row.id: take for take in footage.takes}.values(), key=lambda take: take.row.id)
    outcomes = sorted({take.outcome for take in takes} - {""})
    critical = None
    if footage.threshold is not None:
        first = metrics[0]
        critical = {
            "threshold": footage.threshold,
            "lower_is_critical": first.lower_is_critical,
            "unit": first.unit,
        }
    return tell_subject(meta, footage.study) | {
        "searched": metrics[0].name if footage.threshold is not None else "",
        "critical": critical,
        "outcomes": outcomes,
        "scenarios": {
            "id": [take.row.id for take in takes],
            "round": [take.row.round for take in takes],
            "failed": [0] * len(takes),
            "values": plain_values(footage.parameters, [take.row for take in takes]),
            "scores": {one.name: [plain_score(take.scores[one.name]) for take in takes] for one in metrics},
            "critical": [int(take.critical) for take in takes],
            "outcome": [outcomes.index(take.outcome) if take.outcome else None for take in takes],
            "kept": [0] * len(takes),
        }
        | tell_against(meta, [[take.against.get(one.name) for one in metrics] for take in takes]),
        "kept": {},
        "errors": {},
        "kinds": {},
        "shown": [take.row.id for take in footage.takes],
        "roads": None if footage.road is None else pack_roads(footage.road),
        "roads_missing": footage.road_missing,
    }
