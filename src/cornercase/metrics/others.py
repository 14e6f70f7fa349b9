"""Whom an ego is measured against."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from cornercase._common.arguments import texts
from cornercase._common.errors import InputError
from cornercase.metrics._parts.meeting import Meeting
from cornercase.recordings import Recording

EVERYBODY: Final = "*"
"""Stands for all entities but the ego."""


def name_others(other: object, ego: str, known: Sequence[str]) -> tuple[str, ...]:
    """Take the names of one or several others.

    Parameters
    ----------
    other : object
        A name, or a sequence of names; ``"*"`` stands for all that are known but the ego.
    ego : str
    known : sequence of str
        Names of all entities.

    Returns
    -------
    tuple of str
        At least one; each once. Those that are given need not be among those that are known.

    Raises
    ------
    InputError
        It is something else, there is none, the ego is among them, or names stand in one text with commas between.

    Examples
    --------
    >>> name_others("*", "Ego", ["A", "Ego", "B"])
    ('A', 'B')
    """
    given = texts("other", other)
    if not given:
        raise InputError("`other`: there is none; name an entity, or * for all but the ego.")
    if ego in given:
        raise InputError(f"`other` {ego}: is the ego itself; name the entity that it meets.")
    for name in given:
        parts = [part.strip() for part in name.split(",")]
        if name not in known and len(parts) > 1 and set(parts) <= set(known):
            raise InputError(f"`other` {name}: is not an entity; give several one by one.")
    everyone = [name for name in known if name != ego]
    if EVERYBODY in given and not everyone:
        raise InputError(f"`other` {EVERYBODY}: there is nobody but {ego}.")
    return tuple(dict.fromkeys(name for one in given for name in (everyone if one == EVERYBODY else [one])))


def others_there(recording: Recording, others: Sequence[str]) -> tuple[str, ...]:
    """Leave out those of several others that are never there.

    Parameters
    ----------
    recording : Recording
    others : sequence of str
        Names of entities, one at least.

    Returns
    -------
    tuple of str
        In the same order, without those that the recording does not know. Where none of them is ever there, one that
        it knows, or else the first.
    """
    known = [name for name in others if name in recording.names]
    there = [name for name in known if np.isfinite(recording.x[recording.index(name)]).any()]
    return tuple(there or known[:1] or others[:1])


def nearest_other(recording: Recording, ego: str, other: str | Sequence[str]) -> str:
    """Find the one of several others that comes nearest to the ego.

    Parameters
    ----------
    recording : Recording
    ego : str
        Name of an entity.
    other : str or sequence of str
        Names of one or several others.

    Returns
    -------
    str
        The first that the ego collides with; without a collision the one whose box has the smallest gap to the ego's
        at any instant, of equal ones the first.

    Raises
    ------
    InputError
        The recording has none of them, or no entity of the ego's name.
    """
    others = others_there(recording, (other,) if isinstance(other, str) else other)
    if len(others) == 1:
        return others[0]
    hits = [recording.first_collision(ego, name) for name in others]
    touched = [(hit.time, k) for k, hit in enumerate(hits) if hit is not None]
    if touched:
        return others[min(touched)[1]]
    gaps = [Meeting(recording, ego, name).nearest for name in others]
    # Who is never there with the ego is farther than anybody.
    return others[min(range(len(others)), key=lambda k: (gaps[k][0] is None, gaps[k][1]))]
