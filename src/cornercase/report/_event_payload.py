"""What happened when in scenarios, as values for the replay."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final

from cornercase.metrics._outcome import Impact
from cornercase.recordings import Recording
from cornercase.study import StudyFile

MAX_WITH_EVENTS: Final = 1000
"""Largest number of recordings of a page with events: finding them takes some ms each."""


def find_events_of_scenarios(
    study: StudyFile, ids: Iterable[int], impacts: Mapping[int, Sequence[Impact]]
) -> dict[str, dict[str, Any]]:
    """Find the events of scenarios that ran, by id; of the first 1000 if there are more.

    `impacts` are those of each scenario that ran.
    """
    return {
        str(scenario): find_events_of_scenario(study, scenario, impacts=impacts[scenario])
        for scenario in list(ids)[:MAX_WITH_EVENTS]
    }


def find_events_of_scenario(
    study: StudyFile, scenario: int, recording: Recording | None = None, impacts: Sequence[Impact] | None = None
) -> dict[str, Any]:
    """Find the events of a scenario that ran, with the entity that counts.

    That is the one that the ego collides with first; else the one that the score by the study's first metric is
    measured against. `recording` and `impacts` are those of the scenario, by default read from the study.
    """
    from cornercase.metrics._timeline import find_events

    meta = study.meta
    recording = study.recording(scenario) if recording is None else recording
    if impacts is None:
        # They are the same for each other entity.
        impacts = study.digest(scenario).outcomes[0].impacts
    impact = _first_impact(impacts, meta.others)
    if impact is None:
        sources = study.scenario_score_sources(scenario)
        other = sources.get(meta.metrics[0]) or meta.others[0]
        events = find_events(recording, meta.ego, other)
    else:
        events = find_events(recording, meta.ego, impact.entity, impact.time)
    times = {
        "sees": events.sees,
        "foresees": events.foresees,
        "slows": events.slows,
        "brakes": events.brakes,
        "contact": events.contact,
        "closest": events.closest if events.contact is None else None,
    }
    payload: dict[str, Any] = {"other": events.other}
    payload |= {name: round(time, 3) for name, time in times.items() if time is not None}
    if "closest" in payload:
        payload["gap"] = round(events.gap, 3)
    if impact is not None and impact.fault is not None:
        payload["fault"] = impact.fault.describe(meta.ego, impact.entity)
        payload["why"] = "; ".join(impact.fault.reasons)
    return payload


def _first_impact(impacts: Sequence[Impact], others: Sequence[str]) -> Impact | None:
    """Return the first collision with an entity that the ego is measured against, else with any."""
    measured = [impact for impact in impacts if impact.entity in others]
    return next(iter(measured or impacts), None)
