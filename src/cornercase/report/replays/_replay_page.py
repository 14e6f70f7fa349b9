"""Page of a replay: one HTML file without external references."""

from __future__ import annotations

import base64
from dataclasses import asdict
from typing import Any, Final

from cornercase.recordings._rounded import encode_rounded
from cornercase.report._page import REPLAY_SCRIPTS
from cornercase.report._payload import parameter_columns, round_score, score_source_column, study_info_payload
from cornercase.report._road_drawing import encode_road_outline
from cornercase.report.html._templates import render_template
from cornercase.report.replays._replay_data import ReplayData

_STYLES: Final = ("style.css", "replay.css")
_SCRIPTS: Final = ("store.js", "recordings.js", *REPLAY_SCRIPTS, "replay/alone.js")
_POLICY: Final = "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data:"


def render_replay_page(data: ReplayData) -> str:
    """Render the page of a replay; the same study gives the same bytes."""
    items = sorted({take.row.id: take for take in data.items}.items())
    recordings = {
        scenario: base64.b64encode(encode_rounded(take.recording, take.courses)).decode() for scenario, take in items
    }
    meta = data.meta
    ids = " beside ".join(str(take.row.id) for take in data.items)
    return render_template(
        "replay.html.j2",
        _STYLES,
        _SCRIPTS,
        policy=_POLICY,
        title=f"{meta.title}, scenario {ids}",
        about=f"From {data.file_name}. {meta.roles_text}",
        contents=_replay_payload(data) | {"recordings": list(recordings)},
        recordings=recordings,
    )


def _replay_payload(data: ReplayData) -> dict[str, Any]:
    """Return the contents of the page for the replayed scenarios only."""
    meta, metrics = data.meta, data.metrics
    items = sorted({take.row.id: take for take in data.items}.values(), key=lambda take: take.row.id)
    outcomes = sorted({take.outcome for take in items} - {""})
    return study_info_payload(meta, data.file_name) | {
        "searched": metrics[0].name if data.criterion is not None else "",
        "critical": None if data.criterion is None else asdict(data.criterion),
        "outcomes": outcomes,
        "scenarios": {
            "id": [take.row.id for take in items],
            "round": [take.row.round for take in items],
            "failed": [0] * len(items),
            "values": parameter_columns(data.parameters, [take.row for take in items]),
            "scores": {metric.name: [round_score(take.scores[metric.name]) for take in items] for metric in metrics},
            "critical": [int(take.is_critical) for take in items],
            "outcome": [outcomes.index(take.outcome) if take.outcome else None for take in items],
            "kept": [0] * len(items),
        }
        | score_source_column(meta, [[take.score_sources.get(metric.name) for metric in metrics] for take in items]),
        "kept": {},
        "errors": {},
        "kinds": {},
        "events": {str(take.row.id): dict(take.events) for take in items},
        "shown": [take.row.id for take in data.items],
        "roads": None if data.road is None else encode_road_outline(data.road),
        "roads_missing": data.road_missing_reason,
    }
