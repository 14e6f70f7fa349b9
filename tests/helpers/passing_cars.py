"""A scenario for what stands in for CARLA's ScenarioRunner: a car drives past a parked van."""

from __future__ import annotations

from cornercase.testing._small_scenarios import write_small_scenarios


def write_passing_cars(folder):
    """Write the scenario, of 1 s, in which the van T00 begins at `start`, and its road; return its path."""
    path = write_small_scenarios(folder, "two that pass each other")["two that pass each other"].path
    text = path.read_text(encoding="utf-8").replace('x="140"', 'x="$start"')
    text = text.replace('value="8.0" rule', 'value="1.0" rule')
    text = text.replace(
        "<CatalogLocations/>",
        '<ParameterDeclarations><ParameterDeclaration name="start" parameterType="double" value="140"/>'
        "</ParameterDeclarations><CatalogLocations/>",
    )
    path.write_text(text, encoding="utf-8")
    return path
