"""Axes of a scenario file: right-handed as in the standard, or left-handed as in CARLA."""

from __future__ import annotations

from typing import Final

from lxml import etree

from cornercase._common.io.tracked_xml import find_untracked

LEFT_HANDED_PREFIX: Final = "CARLA:"
"""Start of the header's description that declares left-handed axes, as in ScenarioRunner."""

MIRRORED_ATTRIBUTES: Final = {
    "WorldPosition": ("y", "h"),
    "RelativeWorldPosition": ("dy",),
    "RelativeObjectPosition": ("dy",),
    "RoadPosition": ("t",),
    "Orientation": ("h",),
    "Clothoid": ("curvature", "curvaturePrime", "curvatureDot"),
    "ClothoidSplineSegment": ("curvatureStart", "curvatureEnd", "hOffset"),
}
"""Attributes that change their sign in left-handed axes, by element."""


def find_left_handed_header(root: etree._Element) -> etree._Element | None:
    """Return the file header if it declares left-handed axes, else None."""
    for header in find_untracked(root, "FileHeader"):
        if str(header.attrib.get("description", "")).startswith(LEFT_HANDED_PREFIX):
            return header
    return None


def mirror_axes(root: etree._Element) -> None:
    """Change the signs of y and t coordinates, headings and curvatures in a tree, in place.

    Attributes that are not plain numbers, such as parameters, stay as they are.
    """
    for element in root.iter(*MIRRORED_ATTRIBUTES):
        for name in MIRRORED_ATTRIBUTES[str(element.tag)]:
            try:
                number = float(element.get(name, ""))
            except ValueError:
                continue  # refused when it is read
            element.set(name, repr(0.0 - number))
