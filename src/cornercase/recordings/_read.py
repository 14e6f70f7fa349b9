"""Read recordings of cornercase and of other tools."""

from __future__ import annotations

from pathlib import Path

from cornercase._common import validation
from cornercase._common.errors import InputError
from cornercase.recordings._csv import read_recording_csv
from cornercase.recordings._recording import Recording
from cornercase.recordings.formats._carla_log import read_carla_log
from cornercase.recordings.formats._commonroad import read_commonroad
from cornercase.recordings.formats._erg import read_erg
from cornercase.recordings.formats._esmini_log import ESMINI_LOG_START, read_esmini_log
from cornercase.recordings.formats._osi import read_osi
from cornercase.recordings.formats._sumo_fcd import read_sumo_fcd


def read_recording(path: Path | str) -> Recording:
    """Read a recording of cornercase or of another tool.

    Parameters
    ----------
    path : path
        The extension selects the format: an ASAM OSI trace (``.osi``, ``.mcap``; extra ``osi``), a CommonRoad scenario
        (``.xml``; extra ``commonroad``), floating car data of SUMO (``.xml``), a result file of CarMaker (``.erg``), a
        file of CARLA's recorder (``.log``), otherwise CSV: a log of esmini, or a table with at least the columns
        `CSV_COLUMNS`. Rows of the table may be in any order. An entity without a row at an instant does not exist at
        this instant.

    Returns
    -------
    Recording

    Raises
    ------
    InputError
        The file cannot be read, a column is missing, a field is not a number, an entity has two rows of the same time,
        or the required extra is not installed. The message names the line, if any.

    Examples
    --------
    >>> import cornercase as cc
    >>> run = cc.simulate("examples/x_intersection/x_intersection.xosc", {"ego_start": 45.0})
    >>> run.to_csv("run.csv")
    >>> cc.read_recording("run.csv")
    <Recording of Ego (car), Truck (truck), C (car), Pedestrian (pedestrian), 15.7 s in 315 instants, no collision>
    """
    path = validation.check_path("path", path)
    # Opening a pipe could block.
    if path.exists() and not path.is_file():
        raise InputError(f"{path}: is not a file.")
    if path.suffix.lower() in (".osi", ".mcap", ".xz", ".lzma"):
        return read_osi(path)
    if path.suffix.lower() == ".erg":
        return read_erg(path)
    if path.suffix.lower() == ".log":
        return read_carla_log(path)
    if path.suffix.lower() == ".xml":
        return read_sumo_fcd(path) if _has_text_near_start(path, "<fcd-export") else read_commonroad(path)
    if _has_text_near_start(path, ESMINI_LOG_START):
        return read_esmini_log(path)
    return read_recording_csv(path)


def _has_text_near_start(path: Path, words: str) -> bool:
    """Return whether a text occurs near the beginning of a file."""
    try:
        with open(path, encoding="utf-8", errors="replace") as file:
            return words in file.read(8192)
    except OSError:
        return False
