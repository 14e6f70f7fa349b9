"""Sentences on the parameter ranges that were searched, and on what was held fixed."""

from __future__ import annotations

from collections.abc import Iterator

from cornercase.drivers._serialization import format_driver
from cornercase.report._report_data import ReportData
from cornercase.report.text._phrases import append_unit, format_range
from cornercase.study._import_recordings import IMPORTED_SIMULATOR


def describe_tested_space(data: ReportData) -> Iterator[str]:
    """Yield sentences on the ranges that were searched and on what was held fixed; results are valid for these only."""
    meta = data.summary.meta
    searched, single = (
        ", ".join(
            f"{parameter.name} {format_range(parameter)}"
            for parameter in data.parameters
            if (parameter.low == parameter.high) is is_single
        )
        for is_single in (False, True)
    )
    yield f"Searched: {searched}{f', with {single}' if single else ''}. Nothing is said of what lies outside."
    if meta.simulator == IMPORTED_SIMULATOR:
        return
    driver = meta.ego_driver
    fixed = [f"{meta.ego} driven by {format_driver(driver) if driver else 'its controller in the file'}"]
    fixed += [
        f"{entity} driven by {format_driver(other)}" for entity, other in meta.drivers.items() if entity != meta.ego
    ]
    undriven = [entity for entity in meta.others if entity not in meta.drivers]
    fixed += [f"{' and '.join(undriven)} as the file says"] if undriven else []
    step = meta.settings.get("time_step")
    fixed.append(
        f"simulator {meta.simulator}" + (f" with a time step of {append_unit(f'{step:g}', 's')}" if step else "")
    )
    yield f"Held fixed: {', '.join(fixed)}."
    if data.fixed_parameters:
        values = ", ".join(f"{name} {value}" for name, value in data.fixed_parameters.items())
        yield f"Parameters of the file that were not varied: {values}."
