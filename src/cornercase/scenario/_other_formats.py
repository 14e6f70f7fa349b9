"""Recognize formats that are similar to the supported OpenSCENARIO XML versions, for helpful error messages."""

from __future__ import annotations

import re
from typing import Final

from lxml import etree

from cornercase._common.io.tracked_xml import find_untracked, note_adaptation

NEWEST_MINOR_VERSION: Final = 3
"""Newest supported minor version of OpenSCENARIO XML 1."""

# Statements of ASAM OpenSCENARIO DSL.
_DSL_STATEMENT: Final = re.compile(
    rb"^(?:import\s+\S|(?:actor|action|scenario|struct|enum|modifier|extend|type|unit|global|namespace|use|export)\s+[\w.]+)",
    re.MULTILINE,
)
_MAX_BYTES_SEARCHED: Final = 20_000
_OPENPASS_ROOTS: Final = {
    "Profiles": "holds agent profiles of openPASS",
    "simulationConfig": "configures a simulation of openPASS",
    "slaveConfig": "configures a simulation of openPASS",
    "systems": "holds systems of openPASS",
}


def describe_non_xml_format(data: bytes) -> str:
    """Return a part of a sentence on the format of a file that is not XML; empty if the format is not recognized."""
    head = data[:_MAX_BYTES_SEARCHED].removeprefix(b"\xef\xbb\xbf").lstrip()
    if head.startswith(b"<") or not _DSL_STATEMENT.search(head):
        return ""
    return (
        "is written in the language of ASAM OpenSCENARIO DSL (2.x), which is not read; write the scenario as"
        " OpenSCENARIO XML 1.0 to 1.3 (.xosc), or let a tool for the language export it so"
    )


def describe_other_xml_format(root: etree._Element) -> str:
    """Return a part of a sentence on an XML format other than OpenSCENARIO 1.x; empty if it is not recognized."""
    tag = str(root.tag).rpartition("}")[2]
    if tag in _OPENPASS_ROOTS:
        return f"<{tag}> {_OPENPASS_ROOTS[tag]}; give the scenario, Scenario.xosc beside it"
    if tag == "OpenSCENARIO" and find_untracked(root, "Entities", "Object"):
        return (
            "is written in a version of OpenSCENARIO before 1.0, whose elements have other names; convert it to 1.0, as"
            " by the stylesheet that ASAM offers with the standard"
        )
    return ""


def record_later_version(root: etree._Element) -> None:
    """Record on the file header if the file has a later version of OpenSCENARIO than those that are supported."""
    minor = later_minor_version(root)
    for header in find_untracked(root, "FileHeader") if minor is not None else ():
        reason = (
            f"is {minor}, a version that is not published yet; the file is read as"
            f" OpenSCENARIO XML 1.{NEWEST_MINOR_VERSION}"
        )
        note_adaptation(header, "revMinor of <FileHeader>", reason, f"revMinor is 0 to {NEWEST_MINOR_VERSION}")


def later_minor_version(root: etree._Element) -> int | None:
    """Return the minor version of a file if it is of OpenSCENARIO XML 1 and later than supported, else None."""
    for header in find_untracked(root, "FileHeader"):
        major, minor = (str(header.attrib.get(name, "")).strip() for name in ("revMajor", "revMinor"))
        if (
            major == "1"
            and minor.isascii()
            and minor.isdigit()
            and len(minor) < 4
            and int(minor) > NEWEST_MINOR_VERSION
        ):
            return int(minor)
    return None
