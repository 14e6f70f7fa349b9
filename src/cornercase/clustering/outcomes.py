"""How a scenario ends."""

from __future__ import annotations

from cornercase.metrics import visits
from cornercase.recordings import Recording


def tell_outcome(recording: Recording, ego: str, other: str) -> str:
    """Tell how a scenario ended for the ego: who collided, else who was first where the ways cross.

    Parameters
    ----------
    recording : Recording
        What came out of the scenario.
    ego, other : str
        Names of the two entities.

    Returns
    -------
    str
        ``"Ego and Pedestrian collide"``, ``"Ego first"``, ``"Pedestrian first"`` or ``"ways do not cross"``.
    """
    hit = [collision for collision in recording.collisions if ego in collision.entities]
    if hit:
        return f"{ego} and {' '.join(name for name in hit[0].entities if name != ego)} collide"
    stays = visits(recording, ego, other, None)
    if not stays:
        return "ways do not cross"
    mine, others = min(stays, key=lambda pair: min(pair[0].enters, pair[1].enters))
    return f"{ego} first" if mine.enters < others.enters else f"{other} first"
