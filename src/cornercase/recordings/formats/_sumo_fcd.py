"""Floating car data of SUMO (``--fcd-output``)."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Final

from lxml import etree

from cornercase._common.errors import InputError
from cornercase.recordings._from_samples import EntitySamples, box_center_from_point, recording_from_samples
from cornercase.recordings._recording import Recording
from cornercase.scenario._xml import read_xml

# Kind, length and width in m of SUMO's default types.
_DEFAULT_BOXES: Final = {
    "DEFAULT_VEHTYPE": ("car", 5.0, 1.8),
    "DEFAULT_PEDTYPE": ("pedestrian", 0.215, 0.478),
    "DEFAULT_BIKETYPE": ("bicycle", 1.6, 0.65),
}


def read_sumo_fcd(path: Path | str) -> Recording:
    """Read floating car data of SUMO; entities get the box sizes of SUMO's default types if the file has none."""
    path = Path(path)
    tracks: dict[str, EntitySamples] = {}
    for step in read_xml(path).iterfind("timestep"):
        time = _read_number(path, step, "time")
        for element in step.iterchildren("vehicle", "person"):
            name = element.get("id", "")
            usual = "DEFAULT_PEDTYPE" if element.tag == "person" else "DEFAULT_VEHTYPE"
            kind, length, width = _DEFAULT_BOXES.get(element.get("type", ""), _DEFAULT_BOXES[usual])
            if element.get("length") is not None:
                length, width = _read_number(path, element, "length"), _read_number(path, element, "width")
            track = tracks.setdefault(name, EntitySamples(kind, length, width))
            heading = math.pi / 2 - math.radians(_read_number(path, element, "angle"))
            heading = math.remainder(heading, 2 * math.pi)
            # A vehicle's position is the center of its front, a person's the center of the body.
            behind = 0.0 if element.tag == "person" else 0.5 * track.length
            center = box_center_from_point(
                _read_number(path, element, "x"), _read_number(path, element, "y"), heading, -behind
            )
            track.samples[time] = (*center, heading, _read_number(path, element, "speed"), math.nan)
    return recording_from_samples(path, tracks)


def _read_number(path: Path, element: etree._Element, attribute: str) -> float:
    try:
        number = float(element.get(attribute, ""))
        # Times are checked all at once.
        if attribute != "time" and not math.isfinite(number):
            raise ValueError
        return number
    except ValueError:
        raise InputError(
            f"{path}, line {element.sourceline}: <{element.tag}> needs a number in '{attribute}', not"
            f" '{element.get(attribute, '')}'."
        ) from None
