"""Write recordings as traces of ASAM OSI."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from cornercase._common.errors import InputError
from cornercase._common.io.files import atomic_write
from cornercase.recordings._osi_messages import OsiEntity, OsiState, fill_ground_truth, require_osi
from cornercase.recordings._recording import Recording


def write_osi(path: Path | str, recording: Recording, ego: str | None = None) -> None:
    """Write a recording as a single-channel trace of ASAM OSI.

    Each instant becomes one message of type GroundTruth. Four bytes with the length of the message precede it. The
    field ``source_reference`` of an object names the entity of the scenario. Recordings contain no heights, so a usual
    height of each object type is written.

    Parameters
    ----------
    path : path
        File to write; its name must end in ``.osi``. An existing file is replaced.
    recording : Recording
    ego : str, optional
        Entity that is the host vehicle.

    Raises
    ------
    InputError
        The extra ``osi`` is not installed, there is no entity `ego`, the file name does not end in ``.osi``, or the
        file cannot be written.

    References
    ----------
    ASAM OSI 3.8, "OSI Trace File Formats" and ``GroundTruth``.

    Examples
    --------
    >>> import cornercase as cc
    >>> from cornercase.recordings import read_recording, write_osi
    >>> recording = cc.simulate("examples/x_intersection/x_intersection.xosc", duration=1.0)
    >>> write_osi("run.osi", recording, ego="Ego")
    >>> read_recording("run.osi").names
    ('Ego', 'Truck', 'C', 'Pedestrian')
    """
    path = Path(path)
    if path.suffix.lower() != ".osi":
        raise InputError(f"{path}: the name of an OSI trace of one channel must end in .osi; give another name.")
    require_osi(f"{path}: writing OSI traces")
    from osi3.osi_groundtruth_pb2 import GroundTruth

    host = None if ego is None else recording.entity_index(ego)
    boxes = zip(recording.length.tolist(), recording.width.tolist(), recording.center_x.tolist(), strict=True)
    entities = [
        OsiEntity(name, kind, *box)
        for name, kind, box in zip(recording.names, recording.object_types, boxes, strict=True)
    ]
    motion = np.stack(
        (recording.x, recording.y, recording.heading, recording.speed, recording.acceleration, _yaw_rates(recording))
    )
    parts = list[bytes]()
    for k, time in enumerate(recording.time.tolist()):
        truth = GroundTruth()
        fill_ground_truth(truth, time, entities, [OsiState(*state) for state in motion[:, :, k].T.tolist()], host)
        message = truth.SerializeToString(deterministic=True)
        parts += [len(message).to_bytes(4, "little"), message]
    with atomic_write(path) as temporary:
        temporary.write_bytes(b"".join(parts))


def _yaw_rates(recording: Recording) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    """Return the yaw rate of each entity since the previous instant in rad/s; 0 at its first instant."""
    rates = np.zeros_like(recording.heading)
    if len(recording.time) > 1:
        turns = np.diff(recording.heading, axis=1)
        turns = (turns + np.pi) % (2.0 * np.pi) - np.pi
        rates[:, 1:] = np.nan_to_num(turns / np.diff(recording.time))
    return rates
