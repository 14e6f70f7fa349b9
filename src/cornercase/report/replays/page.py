"""Page of a replay: one HTML file without external references."""

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
    """Render the page of a replay; the same study gives the same bytes."""
    item_by_id = {take.row.id: take for take in footage.takes}
    block, offsets = pack_block(
        [pack_record(scenario, take.recording, take.courses) for scenario, take in sorted(item_by_id.items())]
    )
    index = {str(scenario): [0, offset] for scenario, offset in zip(sorted(item_by_id), offsets, strict=True)}
    meta = footage.meta
    ids = " beside ".join(str(take.row.id) for take in footage.takes)
    return fill_template(
        "replay.html.j2",
        _STYLES,
        _SCRIPTS,
        policy=_POLICY,
        title=f"{meta.title}, scenario {ids}",
        about=f"From {footage.study}. {tell_roles(meta)}",
        contents=_contents(footage) | {"recordings": index},
        blocks=[base64.b64encode(block).decode()],
    )


def _contents(footage: Footage) -> dict[str, Any]:
    """Return the contents of the page, limited to the replayed scenarios."""
    meta, metrics = footage.meta, footage.metrics
    items = sorted({take.row.id: take for take in footage.takes}.values(), key=lambda take: take.row.id)
    outcomes = sorted({take.outcome for take in items} - {""})
    critical = None
    if footage.threshold is not None:
        lower, unit = metrics[0].lower_is_critical, metrics[0].unit
        critical = {"threshold": footage.threshold, "lower_is_critical": lower, "unit": unit}
    return tell_subject(meta, footage.study) | {
        "searched": metrics[0].name if footage.threshold is not None else "",
        "critical": critical,
        "outcomes": outcomes,
        "scenarios": {
            "id": [take.row.id for take in items],
            "round": [take.row.round for take in items],
            "failed": [0] * len(items),
            "values": plain_values(footage.parameters, [take.row for take in items]),
            "scores": {metric.name: [plain_score(take.scores[metric.name]) for take in items] for metric in metrics},
            "critical": [int(take.critical) for take in items],
            "outcome": [outcomes.index(take.outcome) if take.outcome else None for take in items],
            "kept": [0] * len(items),
        }
        | tell_against(meta, [[take.against.get(metric.name) for metric in metrics] for take in items]),
        "kept": {},
        "errors": {},
        "kinds": {},
        "shown": [take.row.id for take in footage.takes],
        "roads": None if footage.road is None else pack_roads(footage.road),
        "roads_missing": footage.road_missing,
    }
