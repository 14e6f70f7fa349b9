"""Sentences on how the ego reacted before its collisions, and on other reactions that would have avoided them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

from cornercase.report._collision_reactions import CollisionReactionCounts

# A median reaction up to this time in s is described as zero; time steps of recordings are about as long.
_SAME_TIME: Final = 0.05


def describe_reactions(counts: CollisionReactionCounts, ego: str, other: str) -> tuple[str, tuple[str, ...]]:
    """Describe the ego's reactions before collisions as a text, and alternatives to them as list items."""
    sentences = [*_describe_earlier_braking(counts, ego, other), *_describe_braking(counts, ego, other)]
    return " ".join(sentences), tuple(_describe_alternatives(counts, ego, other))


def _describe_earlier_braking(counts: CollisionReactionCounts, ego: str, other: str) -> Iterator[str]:
    total = counts.n_with_braking
    if not counts.n_avoided_earlier:
        return
    waits = ", waits then" if counts.n_driving_on else ""
    assumption = f"if {ego} stays on its path{waits}, and {other} moves as recorded"
    if not any(counts.n_avoided_earlier.values()):
        longest = max(counts.n_avoided_earlier)
        collisions = _format_collision_count(total, counts.n_measured)
        yield f"Braking up to {longest:g} s earlier avoids none of {collisions}, {assumption}."
        return
    parts: list[str] = []
    for time, count in counts.n_avoided_earlier.items():
        avoided = "none" if not count else "all" if count == total > 1 else str(count)
        parts.append(f"{time:g} s earlier {avoided}" if parts else f"{time:g} s earlier avoids {avoided}")
        if len(parts) == 1:
            parts[0] += f" of {_format_collision_count(total, counts.n_measured)}"
        if count == total:
            break
    yield f"Braking {', '.join(parts)}: {assumption}."


def _format_collision_count(count: int, total: int) -> str:
    number = "the one collision" if count == 1 else f"the {count} collisions"
    return number if count == total else f"{number} with braking"


def _describe_braking(counts: CollisionReactionCounts, ego: str, other: str) -> Iterator[str]:
    total = counts.n_measured
    collisions = "the one collision" if total == 1 else f"the {total} collisions"
    if total < counts.n_collisions:
        collisions = f"{total} of the {counts.n_collisions} collisions, an even sample,"
    if counts.n_with_braking:
        which = collisions if counts.n_with_braking == total else f"{counts.n_with_braking} of {collisions}"
        yield f"In {which} {ego} brakes{_describe_reaction(counts)}."
    else:
        yield f"{ego} brakes in none of {collisions}."
    if counts.n_driving_on:
        yield f"In {counts.n_driving_on} it drives on again before they touch."
    if counts.n_without_braking and counts.n_with_braking:
        yield f"In {counts.n_without_braking} it does not brake for it."
    if counts.n_seen_too_late:
        yield (
            f"In {counts.n_seen_too_late} full braking was too late once it could see that coming; what avoids these"
            f" has to act on earlier signs of what {other} is about to do."
        )


def _describe_reaction(counts: CollisionReactionCounts) -> str:
    reaction = counts.median_reaction
    if reaction is None:
        return ""
    when = f"{abs(reaction):.2g} s {'after' if reaction > 0.0 else 'before'} it could see the collision coming"
    if abs(reaction) <= _SAME_TIME + 1e-9:
        when = "as soon as it could see the collision coming"
    few = "" if counts.n_reactions == counts.n_with_braking else f" of {counts.n_reactions}"
    return f"; the median{few} begins {when}" if counts.n_with_braking > 1 else f", {when}"


def _describe_alternatives(counts: CollisionReactionCounts, ego: str, other: str) -> Iterator[str]:
    if counts.n_driving_on:
        avoided = _count_of(counts.n_avoided_by_waiting, counts.n_driving_on)
        yield f"Waiting where it stopped, instead of driving on, avoids {avoided}."
    if counts.n_without_braking:
        avoided = _count_of(counts.n_avoided_by_full_braking, counts.n_without_braking)
        yield (
            "Where it does not brake, the careful driver of UN Regulation No. 157, who brakes fully 1.15 s after the"
            f" collision can be seen coming, avoids {avoided}."
        )
    yield (
        "Whoever is at fault, a better driver may avoid them: search again with the same seed and another driver, by"
        f" --driver {ego}=NAME, and compare."
    )
    yield (
        "What would have avoided them is computed from the recordings, not simulated:"
        f" {other} goes straight on after the contact. Coming means in sight, and less than 5 s away if both go"
        " straight on at these speeds; a cut-in that has only begun does not show it."
    )


def _count_of(count: int, total: int) -> str:
    if count == total:
        return f"all {total}" if total > 1 else "it"
    return f"{count or 'none'} of {total}"
