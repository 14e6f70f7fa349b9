"""Page that plays a replay: one HTML file without external references."""

from __future__ import annotations

import base64
from dataclasses import asdict
from typing import Any, Final

from cornercase.recordings._compact_encoding import encode_rounded
from cornercase.report._report_page import REPLAY_SCRIPTS
from cornercase.report._report_payload import parameter_columns, round_score, score_source_column, study_info_payload
from cornercase.report._road_drawing import encode_road_outline
from cornercase.report.html._templates import render_template
from cornercase.report.replays._replay_data import ReplayData

_STYLES: Final = ("style.css", "replay.css")
_SCRIPTS: Final = ("store.js", "recordings.js", *REPLAY_SCRIPTS, "replay/alone.js")
_POLICY: Final = "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data:"


def render_replay_page(data: ReplayData) -> str:
    """Render the page of a replay; the same study gives the same bytes."""
    items = sorted({item.row.id: item for item in data.items}.items())
    recordings = {
        scenario: base64.b64encode(encode_rounded(item.recording, item.courses)).decode() for scenario, item in items
    }
    meta = data.meta
    ids = " beside ".join(str(item.row.id) for item in data.items)
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
    """Return the data for the scripts of a replay page, reduced to the replayed scenarios."""
    meta, metrics = data.meta, data.metrics
    items = sorted({item.row.id: item for item in data.items}.values(), key=lambda item: item.row.id)
    outcomes = sorted({item.outcome for item in items} - {""})
    return study_info_payload(meta, data.file_name) | {
        "searched": metrics[0].name if data.criterion is not None else "",
        "critical": None if data.criterion is None else asdict(data.criterion),
        "outcomes": outcomes,
        "scenarios": {
            "id": [item.row.id for item in items],
            "round": [item.row.round for item in items],
            "failed": [0] * len(items),
            "values": parameter_columns(data.parameters, [item.row for item in items]),
            "scores": {metric.name: [round_score(item.scores[metric.name]) for item in items] for metric in metrics},
            "critical": [int(item.is_critical) for item in items],
            "outcome": [outcomes.index(item.outcome) if item.outcome else None for item in items],
            "kept": [0] * len(items),
        }
        | score_source_column(meta, [[item.score_sources.get(metric.name) for metric in metrics] for item in items]),
        "kept": {},
        "errors": {},
        "kinds": {},
        "events": {str(item.row.id): dict(item.events) for item in items},
        "shown": [item.row.id for item in data.items],
        "roads": None if data.road is None else encode_road_outline(data.road),
        "roads_missing": data.road_missing_reason,
    }
