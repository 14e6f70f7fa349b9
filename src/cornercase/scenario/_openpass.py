"""Agent profiles of openPASS, which openPASS scenarios use instead of vehicles."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from lxml import etree

from cornercase._common.io.support_table import Notice
from cornercase._common.io.tracked_xml import iter_descendants_untracked, note_adaptation
from cornercase._common.text.element_locations import line_number

PROFILES_FILE: Final = "ProfilesCatalog.xml"
"""Name of openPASS's profiles file, next to the scenario."""
_CATALOG_REFERENCE_RULE: Final = "a CatalogReference names a catalog of OpenSCENARIO and an entry in it"


def profiles_file_name(catalog_name: str) -> str:
    """Return the name of openPASS's profiles file if `catalog_name` refers to this file; otherwise an empty text."""
    return PROFILES_FILE if catalog_name in (PROFILES_FILE, Path(PROFILES_FILE).stem) else ""


def uses_agent_profiles(root: etree._Element) -> bool:
    """Return whether a scenario refers to agent profiles of openPASS."""
    return any(
        profiles_file_name(str(reference.attrib.get("catalogName", "")))
        for reference in iter_descendants_untracked(root, "CatalogReference")
    )


def vehicle_models_of_profile(profiles: etree._Element, profile_name: str) -> list[str] | None:
    """Return the vehicle models of an agent profile, the most probable first; None if there is no such profile."""
    models = {
        _name_attribute(element): _name_attribute(model)
        for element in profiles.iterfind("VehicleProfiles/VehicleProfile")
        for model in element.iterfind("Model")
    }
    for profile in profiles.iterfind("AgentProfiles/AgentProfile"):
        if _name_attribute(profile) == profile_name:
            candidates = [
                (_probability_attribute(element), models.get(_name_attribute(element), ""))
                for element in profile.iter("VehicleProfile")
            ]
            candidates += [
                (_probability_attribute(element), _name_attribute(element) or (element.text or "").strip())
                for element in profile.iter("VehicleModel")
            ]
            candidates.sort(key=lambda candidate: -candidate[0])
            return list(dict.fromkeys(model for _, model in candidates if model))
    return None


def agent_profile_names(profiles: etree._Element) -> list[str]:
    """Return the names of the agent profiles in openPASS's profiles file."""
    return [_name_attribute(profile) for profile in profiles.iterfind("AgentProfiles/AgentProfile")]


def record_profile_replacement(root: etree._Element, profile_name: str, models: list[str]) -> None:
    """Record on each element that refers to an agent profile: the first of `models` replaces the profile."""
    choice = f", the most probable of {len(models)}" if len(models) > 1 else ""
    reason = (
        f"names the agent profile '{profile_name}' of openPASS, a vehicle with a driver and sensors; only its vehicle"
        f" model '{models[0]}' is used{choice}"
    )
    for reference in iter_descendants_untracked(root, "CatalogReference"):
        if reference.attrib.get("entryName") == profile_name and profiles_file_name(
            str(reference.attrib.get("catalogName", ""))
        ):
            note_adaptation(reference, "<CatalogReference>", reason, _CATALOG_REFERENCE_RULE)


def profiles_file_notice(profiles: etree._Element, file: Path) -> Notice:
    """Return a notice that says what is read from the profiles file of openPASS."""
    reason = (
        "only the vehicle models of openPASS's agent profiles are read; drivers, sensors and the traffic that openPASS"
        " adds are ignored"
    )
    return Notice(("<Profiles>",), reason, file, (line_number(profiles),))


def profile_controller_notices(root: etree._Element, file: Path) -> tuple[Notice, ...]:
    """Return a notice if controllers in a scenario refer to agent profiles of openPASS; otherwise empty."""
    properties = [
        item for item in iter_descendants_untracked(root, "Property") if item.attrib.get("name") == "AgentProfile"
    ]
    for item in properties:
        # Mark as used, so that the support table does not report it again.
        item.get("name"), item.get("value")
    reason = (
        "refers to an agent profile in openPASS's ProfilesCatalog.xml, whose driver and sensors are ignored; the"
        " storyboard or a driver of cornercase moves the entity"
    )
    lines = tuple(map(line_number, properties))
    return (Notice(("<Property AgentProfile>",), reason, file, lines),) if properties else ()


def _name_attribute(element: etree._Element) -> str:
    return str(element.get("Name") or element.get("name") or "")


def _probability_attribute(element: etree._Element) -> float:
    try:
        return float(element.get("Probability") or element.get("probability") or 1.0)
    except ValueError:
        return 0.0
