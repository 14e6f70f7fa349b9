"""Selection of the entities that an ego is measured against."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from cornercase._common.errors import InputError
from cornercase._common.validation import check_str_sequence
from cornercase.metrics._geometry.encounter import Encounter
from cornercase.recordings import Recording

ALL_OTHERS: Final = "*"
"""Name that stands for all entities but the ego."""


def resolve_others(other: object, ego: str, entity_names: Sequence[str]) -> tuple[str, ...]:
    """Return the names of the entities that `other` stands for, each once; InputError if `other` is invalid.

    ``"*"`` stands for all of `entity_names` but the ego. Whether other names are in `entity_names` is not checked.

    Examples
    --------
    >>> resolve_others("*", "Ego", ["A", "Ego", "B"])
    ('A', 'B')
    """
    given = check_str_sequence("other", other)
    if not given:
        raise InputError("`other` is empty; name an entity, or * for all but the ego.")
    if ego in given:
        raise InputError(f"`other` {ego}: this is the ego itself; name the entity that the ego meets.")
    for name in given:
        parts = [part.strip() for part in name.split(",")]
        if name not in entity_names and len(parts) > 1 and set(parts) <= set(entity_names):
            raise InputError(f"`other` {name}: this is a list, not the name of an entity; give each entity by itself.")
    everyone = [name for name in entity_names if name != ego]
    if ALL_OTHERS in given and not everyone:
        raise InputError(f"`other` {ALL_OTHERS}: there is no entity besides {ego}; add another one to the scenario.")
    return tuple(dict.fromkeys(name for entry in given for name in (everyone if entry == ALL_OTHERS else [entry])))


def present_others(recording: Recording, others: Sequence[str]) -> tuple[str, ...]:
    """Return the entities among `others` that exist at least at one instant of the recording, in the same order.

    If none of them exists, return the first of `others` that is named in the recording, or else the first of `others`.
    """
    recorded = [name for name in others if name in recording.names]
    present = [name for name in recorded if np.isfinite(recording.x[recording.entity_index(name)]).any()]
    return tuple(present or recorded[:1] or others[:1])


def nearest_other(recording: Recording, ego: str, other: str | Sequence[str]) -> str:
    """Return the entity, of those named in `other`, that the ego collides with first.

    Without a collision, return the entity whose box comes nearest to the ego's box.
    """
    others = present_others(recording, (other,) if isinstance(other, str) else other)
    if len(others) == 1:
        return others[0]
    collisions = [recording.first_collision(ego, name) for name in others]
    times = [(collision.time, k) for k, collision in enumerate(collisions) if collision is not None]
    if times:
        return others[min(times)[1]]
    gaps = [Encounter(recording, ego, name).closest_instant_and_gap for name in others]
    # An entity that never exists together with the ego counts as farthest.
    return others[min(range(len(others)), key=lambda k: (gaps[k][0] is None, gaps[k][1]))]
