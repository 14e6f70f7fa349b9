"""Scenarios whose catalogs, and agent profiles of openPASS, lie beside them."""

from __future__ import annotations

from pathlib import Path

from conftest import moving, scenario_file

MODEL = """<OpenSCENARIO><FileHeader/><Catalog name="Cars"><Vehicle name="m" vehicleCategory="car">
<BoundingBox><Center x="1" y="0" z="0.7"/><Dimensions width="2" length="4" height="1.5"/></BoundingBox>
<Performance maxSpeed="60" maxAcceleration="9" maxDeceleration="9"/><Axles>
<FrontAxle maxSteering="0.5" wheelDiameter="0.6" trackWidth="1.7" positionX="2.5" positionZ="0.3"/>
<RearAxle maxSteering="0" wheelDiameter="0.6" trackWidth="1.7" positionX="0" positionZ="0.3"/></Axles>
<Properties/></Vehicle></Catalog></OpenSCENARIO>"""
PROFILES = """<Profiles><AgentProfiles><AgentProfile Name="A" Type="Static"><VehicleModel Name="m"/></AgentProfile>
</AgentProfiles></Profiles>"""


def of_openpass(folder: Path, beside: bool = True) -> Path:
    """A scenario whose catalogs lie beside it, with an agent profile of openPASS or a vehicle."""
    folder.mkdir()
    catalog = "ProfilesCatalog.xml" if beside else "Cars"
    entity = f'<CatalogReference catalogName="{catalog}" entryName="{"A" if beside else "m"}"/>'
    path: Path = scenario_file(
        folder, init=moving("10"), entities=f'<ScenarioObject name="Ego">{entity}</ScenarioObject>'
    )
    where = '<CatalogLocations><VehicleCatalog><Directory path=""/></VehicleCatalog></CatalogLocations>'
    path.write_text(path.read_text().replace("<CatalogLocations/>", where))
    (folder / "cars.xosc").write_text(MODEL)
    if beside:
        (folder / "ProfilesCatalog.xml").write_text(PROFILES)
    return path
