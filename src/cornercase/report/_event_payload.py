"""Times of sight, braking and contact between the ego and another entity, as JSON values for the replay."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

from cornercase.metrics._outcome import Impact
from cornercase.recordings import Recording
from cornercase.study import StudyFile

if TYPE_CHECKING:
    from cornercase.metrics._timeline import EncounterEvents

MAX_WITH_EVENTS: Final = 1000
"""Largest number of scenarios on a page whose events are found, since this takes some ms for each scenario."""


def find_events_of_scenarios(
    study: StudyFile,
    ids: Iterable[int],
    impacts: Mapping[int, Sequence[Impact]],
    known_events: Mapping[int, EncounterEvents],
) -> dict[str, dict[str, Any]]:
    """Find when the ego sees, brakes for and touches another entity in each scenario, as JSON values by id.

    Scenarios after the first 1000 are left out. `impacts` are the collisions of the ego in each scenario that ran.
    `known_events` are events that were found before, by id.
    """
    payload = {}
    for scenario in list(ids)[:MAX_WITH_EVENTS]:
        impact = _first_impact(impacts[scenario], study.meta.others)
        events = known_events.get(scenario) or _find_events(study, scenario, study.recording(scenario), impact)
        payload[str(scenario)] = _events_payload(study, events, impact)
    return payload


def find_events_of_scenario(study: StudyFile, scenario: int, recording: Recording | None = None) -> dict[str, Any]:
    """Find when the ego sees, brakes for and touches another entity in a scenario that ran, as JSON values.

    The entity is the first of the study's other entities that the ego collides with, or else the first entity that the
    ego collides with. Without a collision it is the entity that the score by the study's first metric is measured
    against, or the first other entity if that is unknown. `recording` belongs to the scenario; by default it is read
    from the study.
    """
    # Impacts are the same for each other entity.
    impact = _first_impact(study.digest(scenario).outcomes[0].impacts, study.meta.others)
    recording = study.recording(scenario) if recording is None else recording
    return _events_payload(study, _find_events(study, scenario, recording, impact), impact)


def _find_events(study: StudyFile, scenario: int, recording: Recording, impact: Impact | None) -> EncounterEvents:
    from cornercase.metrics._timeline import find_events

    if impact is not None:
        return find_events(recording, study.meta.ego, impact.entity, impact.time)
    other = study.scenario_score_sources(scenario).get(study.meta.metrics[0]) or study.meta.others[0]
    return find_events(recording, study.meta.ego, other)


def _events_payload(study: StudyFile, events: EncounterEvents, impact: Impact | None) -> dict[str, Any]:
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
        payload["fault"] = impact.fault.describe(study.meta.ego, impact.entity)
        payload["why"] = "; ".join(impact.fault.reasons)
    return payload


def _first_impact(impacts: Sequence[Impact], others: Sequence[str]) -> Impact | None:
    """Return the first collision with one of `others`, else the first collision; None without a collision."""
    measured = [impact for impact in impacts if impact.entity in others]
    return next(iter(measured or impacts), None)
