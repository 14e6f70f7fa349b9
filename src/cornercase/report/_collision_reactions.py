"""Numbers of collisions in a study by how the ego braked, and by what would have avoided them."""

from __future__ import annotations

import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from cornercase.metrics._outcome import Impact
from cornercase.study import StudyFile

if TYPE_CHECKING:
    from cornercase.metrics._timeline import EgoReaction, EncounterEvents


@dataclass(frozen=True)
class CollisionReactionCounts:
    """Numbers of collisions by how the ego braked, and by what would have avoided them, as the recorded motion shows.

    Attributes
    ----------
    n_collisions : int
        Number of scenarios in which the ego collides with one of the entities that the metrics consider.
    n_measured : int
        Number of examined collisions: all collisions whose motion is known, or an evenly spaced sample of them in a
        large study. All following numbers count examined collisions only.
    n_without_braking : int
        Collisions in which the ego does not begin to brake, or to brake harder, in sight of the other entity.
    n_braking : int
        Collisions in which the ego brakes or stands until the contact.
    n_driving_on : int
        Collisions in which the ego brakes, and speeds up again before the contact.
    n_reactions : int
        Collisions in which the braking counts as a reaction: it begins not earlier than 0.5 s before the ego could see
        the collision coming.
    median_reaction : float or None
        Median time in s from the instant at which the ego could see the collision coming to the begin of its braking,
        over the `n_reactions` collisions. None if `n_reactions` is 0.
    n_seen_too_late : int
        Collisions that the ego could not see coming, or so late that even immediate full braking would not have stopped
        the ego in time.
    n_avoided_earlier : mapping of float to int
        Collisions that the ego would have avoided if the same braking had begun earlier, by the time in s by which it
        had begun earlier. Empty if the ego brakes in no collision.
    n_avoided_by_full_braking : int
        Collisions without braking that the careful driver of UN Regulation No. 157 would have avoided.
    n_avoided_by_waiting : int
        Collisions counted in `n_driving_on` that the ego would have avoided if it had stopped and waited.
    events : mapping of int to EncounterEvents
        Times of sight, braking and contact, by id of the examined scenario.

    Examples
    --------
    >>> import cornercase as cc
    >>> replies = cc.summarize("study.db").replies  # doctest: +SKIP
    >>> replies.n_collisions, replies.n_with_braking, replies.n_avoided_earlier  # doctest: +SKIP
    (10, 10, {0.3: 10, 0.5: 10, 1.0: 10})
    """

    n_collisions: int
    n_measured: int
    n_without_braking: int
    n_braking: int
    n_driving_on: int
    n_reactions: int
    median_reaction: float | None
    n_seen_too_late: int
    n_avoided_earlier: Mapping[float, int] = field(default_factory=dict)
    n_avoided_by_full_braking: int = 0
    n_avoided_by_waiting: int = 0
    events: Mapping[int, EncounterEvents] = field(default_factory=dict, repr=False)

    @property
    def n_with_braking(self) -> int:
        """Number of collisions in which the ego brakes; afterwards it may speed up again."""
        return self.n_braking + self.n_driving_on


def count_collision_reactions(
    study: StudyFile, impacts: Sequence[Sequence[Impact]], *, max_measured: int = 200
) -> CollisionReactionCounts | None:
    """Count the collisions of the ego by how it braked; None without collisions, or if no motion is known.

    `impacts` are the collisions of the ego in each scenario that ran. To save time, at most `max_measured` recordings
    are read; shares computed from this sample have an error of a few percent.
    """
    others = frozenset(study.meta.others)
    first_hits = {
        row.id: hit
        for row, hits in zip(study.finished_rows(), impacts, strict=True)
        if (hit := next((hit for hit in hits if hit.entity in others), None)) is not None
    }
    if not first_hits:
        return None
    from cornercase.metrics._timeline import EARLIER, find_ego_reaction

    ids = list(first_hits)
    if len(ids) > max_measured:
        ids = [ids[k] for k in np.linspace(0, len(ids) - 1, max_measured).round().astype(int)]
    replies = {
        scenario: find_ego_reaction(
            study.recording(scenario), study.meta.ego, first_hits[scenario].entity, first_hits[scenario].time
        )
        for scenario in ids
    }
    known_replies = {scenario: reply for scenario, reply in replies.items() if reply is not None}
    return _count(len(first_hits), known_replies, EARLIER) if known_replies else None


def _count(
    n_collisions: int, replies_by_id: Mapping[int, EgoReaction], earlier: Sequence[float]
) -> CollisionReactionCounts:
    replies = replies_by_id.values()
    kinds = [reply.reply for reply in replies]
    reactions = [reply.reaction for reply in replies if reply.reaction is not None]
    moved = [reply.avoided_by for reply in replies if reply.avoided_by is not None]
    return CollisionReactionCounts(
        n_collisions=n_collisions,
        n_measured=len(replies),
        n_without_braking=kinds.count("none"),
        n_braking=kinds.count("brakes"),
        n_driving_on=kinds.count("drives on"),
        n_reactions=len(reactions),
        median_reaction=round(statistics.median(reactions), 3) if reactions else None,
        n_seen_too_late=sum(reply.seen_too_late for reply in replies),
        n_avoided_earlier={time: sum(avoided[k] for avoided in moved) for k, time in enumerate(earlier)}
        if moved
        else {},
        n_avoided_by_full_braking=sum(reply.avoided is True for reply in replies if reply.reply == "none"),
        n_avoided_by_waiting=sum(reply.avoided is True for reply in replies if reply.reply == "drives on"),
        events={scenario: reply.events for scenario, reply in replies_by_id.items()},
    )
