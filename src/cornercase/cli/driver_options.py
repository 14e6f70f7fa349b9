"""Options ``--sut``, ``--sensor`` and ``--vehicle``, which give entities drivers, sensors and vehicle models."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from cornercase._common.errors import InputError, suggest_name
from cornercase._common.option import Option
from cornercase.cli.parsing import parse_pairs

if TYPE_CHECKING:
    from cornercase._common.registry import Registry

_PANEL: Final = "Simulation"
DRIVER_OPTIONS: Final = {
    option.name: option
    for option in (
        Option(
            "System under test: the same as --driver, or a file with entities, their drivers, sensors and vehicles.",
            flag="--sut",
            metavar="ENTITY=SPEC|FILE.toml",
            panel=_PANEL,
            name="sut",
            annotation="tuple[str, ...]",
            default=(),
        ),
        Option(
            "Sensor between the traffic and a driver, such as radar:fov=60,range=120; repeatable.",
            flag="--sensor",
            metavar="ENTITY=SPEC",
            panel=_PANEL,
            name="sensor",
            annotation="tuple[str, ...]",
            default=(),
        ),
        Option(
            "Vehicle model that turns a driver's decisions into motion, such as single-track:mass=1500.",
            flag="--vehicle",
            metavar="ENTITY=SPEC",
            panel=_PANEL,
            name="vehicle",
            annotation="tuple[str, ...]",
            default=(),
        ),
    )
}
"""Options of all commands that take ``--driver``; Python and studies have one text for driver, sensor and vehicle."""


def combine_drivers(
    drivers: Sequence[str], sut: Sequence[str], sensors: Sequence[str], vehicles: Sequence[str]
) -> dict[str, str]:
    """Combine drivers, sensors and vehicle models into one text per entity: ``DRIVER + SENSOR + VEHICLE``."""
    specs: dict[str, str] = {}
    for option, texts in (("--driver", drivers), ("--sut", sut)):
        for text in texts:
            for entity, spec in _read_drivers(text, option).items():
                if specs.setdefault(entity, spec) != spec:
                    raise InputError(
                        f"{option} {text}: {entity} is driven by '{specs[entity]}' already; give one driver for each"
                        " entity."
                    )
    if not sensors and not vehicles:
        return specs
    from cornercase.drivers import SENSORS, VEHICLES
    from cornercase.drivers._registry import SEPARATOR, split_spec

    for registry, other, texts in ((SENSORS, VEHICLES, sensors), (VEHICLES, SENSORS, vehicles)):
        own, others = ("--sensor", "--vehicle") if registry is SENSORS else ("--vehicle", "--sensor")
        for text in texts:
            ((entity, spec),) = parse_pairs([text], own).items()
            _check_equipment(own, others, text, spec, registry, other)
            if entity not in specs:
                raise InputError(
                    f"{own} {text}: nobody drives {entity}; give its driver, too, as in --sut {entity}=normal."
                )
            parts = [split_spec(specs[entity])[0], *split_spec(specs[entity])[1]]
            if spec in parts[1:]:
                raise InputError(f"{own} {text}: is given twice; give it once.")
            if own == "--vehicle" and (present := _find_vehicle(parts[1:])) is not None:
                raise InputError(f"{own} {text}: {entity} has the vehicle '{present}' already; give only one.")
            specs[entity] = SEPARATOR.join([*parts, spec])
    return specs


def _read_drivers(text: str, option: str) -> Mapping[str, str]:
    """Return the driver of each entity that the text of an option names; for ``--sut``, the text can be a TOML file."""
    if option == "--sut" and "=" not in text and text.endswith(".toml"):
        from cornercase.cli.sut_file import read_sut_file

        return read_sut_file(Path(text))
    return parse_pairs([text], option)


def _find_vehicle(parts: Sequence[str]) -> str | None:
    from cornercase.drivers import VEHICLES

    return next((part for part in parts if part.partition(":")[0] in VEHICLES), None)


def _check_equipment(
    option: str, other_option: str, text: str, spec: str, registry: Registry[Any], other: Registry[Any]
) -> None:
    """Raise InputError unless the text of ``--sensor`` names one sensor, or the text of ``--vehicle`` one vehicle."""
    from cornercase.drivers._registry import SEPARATOR

    name = spec.partition(":")[0].strip()
    if SEPARATOR in spec:
        raise InputError(
            f"{option} {text}: give each sensor or vehicle with an option of its own, not with '{SEPARATOR.strip()}'."
        )
    if name not in registry:
        kind = option.removeprefix("--")
        hint = f"it is a {other_option.removeprefix('--')}; give it with {other_option}." if name in other else None
        raise InputError(
            f"{option} {text}: there is no {kind} '{name}'; {hint or suggest_name(name, registry.names())}"
        )
