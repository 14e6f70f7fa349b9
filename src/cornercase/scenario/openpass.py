"""Agent profiles of openPASS, which its scenarios name in the place of vehicles."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from lxml import etree

from cornercase._common.ledger import Notice
from cornercase._common.places import line_of
from cornercase._common.recorded_xml import adapt, below

PROFILES_FILE: Final = "ProfilesCatalog.xml"
"""Name of openPASS's file, which lies beside the scenario."""
_RULE: Final = "a CatalogReference names a catalog of OpenSCENARIO and an entry in it"


def profiles_file(catalog: str) -> str:
    """Name of openPASS's file that a scenario names as a catalog; empty where it is one of OpenSCENARIO."""
    return PROFILES_FILE if catalog in (PROFILES_FILE, Path(PROFILES_FILE).stem) else ""


def has_profiles(root: etree._Element) -> bool:
    """Whether an entity of a scenario is an agent profile."""
    return any(profiles_file(str(one.attrib.get("catalogName", ""))) for one in below(root, "CatalogReference"))


def vehicle_models(profiles: etree._Element, name: str) -> list[str] | None:
    """Names of the vehicle models of an agent profile, the most probable first; None where there is no such profile.

    Parameters
    ----------
    profiles : lxml element
        Root of openPASS's file.
    name : str

    Returns
    -------
    list of str or None
    """
    models = {
        _named(one): _named(model)
        for one in profiles.iterfind("VehicleProfiles/VehicleProfile")
        for model in one.iterfind("Model")
    }
    for profile in profiles.iterfind("AgentProfiles/AgentProfile"):
        if _named(profile) == name:
            found = [(_probability(one), models.get(_named(one), "")) for one in profile.iter("VehicleProfile")]
            found += [
                (_probability(one), _named(one) or (one.text or "").strip()) for one in profile.iter("VehicleModel")
            ]
            found.sort(key=lambda one: -one[0])
            return list(dict.fromkeys(model for _, model in found if model))
    return None


def profile_names(profiles: etree._Element) -> list[str]:
    """Names of the agent profiles of openPASS's file."""
    return [_named(one) for one in profiles.iterfind("AgentProfiles/AgentProfile")]


def note_profile(root: etree._Element, entry: str, models: list[str]) -> None:
    """Note on the references to an agent profile what was read in its place.

    Parameters
    ----------
    root : lxml element
        Of the scenario.
    entry : str
        Name of the profile.
    models : list of str
        Vehicle models of the profile; the first is the one that was read.
    """
    drawn = f", the most probable of {len(models)}" if len(models) > 1 else ""
    why = (
        f"names the agent profile '{entry}' of openPASS, a vehicle with a driver and sensors; its vehicle model"
        f" '{models[0]}' is read{drawn}, and nothing else of it"
    )
    for one in below(root, "CatalogReference"):
        if one.attrib.get("entryName") == entry and profiles_file(str(one.attrib.get("catalogName", ""))):
            adapt(one, "<CatalogReference>", why, _RULE)


def profiles_notice(profiles: etree._Element, file: Path) -> Notice:
    """Say what of openPASS's file is read, of which a scenario names agent profiles.

    Parameters
    ----------
    profiles : lxml element
        Root of the file.
    file : Path

    Returns
    -------
    Notice
    """
    why = (
        "of the agent profiles of openPASS only vehicle models are read; drivers, sensors and the traffic that openPASS"
        " adds are not"
    )
    return Notice(("<Profiles>",), why, file, (line_of(profiles),))


def profile_notices(root: etree._Element, file: Path) -> tuple[Notice, ...]:
    """Say which controllers of a scenario are agent profiles of openPASS.

    Parameters
    ----------
    root : lxml element
        Of the scenario.
    file : Path

    Returns
    -------
    tuple of Notice
    """
    found = [one for one in below(root, "Property") if one.attrib.get("name") == "AgentProfile"]
    for one in found:
        # It is read, so that nothing else is said of it.
        one.get("name"), one.get("value")
    why = (
        "names an agent profile of openPASS's ProfilesCatalog.xml, whose driver and sensors are not read; the"
        " storyboard moves the entity, or a driver of cornercase"
    )
    lines = tuple(map(line_of, found))
    return (Notice(("<Property AgentProfile>",), why, file, lines),) if found else ()


def _named(element: etree._Element) -> str:
    return str(element.get("Name") or element.get("name") or "")


def _probability(element: etree._Element) -> float:
    try:
        return float(element.get("Probability") or element.get("probability") or 1.0)
    except ValueError:
        return 0.0
