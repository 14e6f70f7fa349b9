"""Model description of an FMU: the variables and properties that a driver needs."""

from __future__ import annotations

import hashlib
import io
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any, Final

from cornercase._common.errors import InputError
from cornercase._common.optional_packages import describe_install
from cornercase._common.text.sanitize import format_exception, shorten
from cornercase.drivers.fmu._instance import FmuSource
from cornercase.drivers.fmu._osmp_variables import MessageVariable, read_message_variables
from cornercase.drivers.fmu._variable_units import KNOWN_UNITS, Unit

_LOG_CATEGORIES: Final = ("logStatusWarning", "logStatusDiscard", "logStatusError", "logStatusFatal")
# dtypes of the values of each FMI type, as in shared memory.
_DTYPES: Final = {
    "Real": "f8", "Integer": "i4", "Float32": "f4", "Float64": "f8", "Int8": "i1", "UInt8": "u1", "Int16": "i2",
    "UInt16": "u2", "Int32": "i4", "UInt32": "u4", "Int64": "i8", "UInt64": "u8",
}  # fmt: skip


@dataclass(frozen=True)
class FmuVariable:
    """Variable of an FMU.

    `kind` is the type in the names of the C functions that set and get the variable, such as ``"Real"``. `size` is the
    number of values, more than one for an array of FMI 3.0. `unit_name` is the unit as written in the file, and `unit`
    its definition; None if it is unknown. `items` are the numbers of an enumeration, by name.
    """

    name: str
    reference: int
    kind: str
    causality: str
    size: int
    unit_name: str
    unit: Unit | None
    start: str
    items: Mapping[str, int]

    @property
    def is_number(self) -> bool:
        """True if the values are numbers or booleans."""
        return self.kind in _DTYPES or self.kind == "Boolean"

    def dtype(self, version: int) -> str:
        """Return the NumPy type of the values, such as ``"f8"``; `version` is the major version of FMI."""
        return _DTYPES.get(self.kind, "i4" if version == 2 else "?")


@dataclass(frozen=True, eq=False)
class FmuModel:
    """Description of an FMU for co-simulation, read from its file.

    `messages` are the OSI messages that the FMU reads and writes; integers that hold messages are not in `variables`.
    """

    path: Path
    sha256: str
    name: str
    fmi_version: str
    token: str
    identifier: str
    once_per_process: bool
    step_size: float | None
    can_vary_step: bool
    variables: tuple[FmuVariable, ...]
    log_categories: tuple[str, ...]
    messages: tuple[MessageVariable, ...] = ()

    @property
    def version(self) -> int:
        """Major version of FMI."""
        return int(self.fmi_version[0])

    @cached_property
    def by_name(self) -> dict[str, FmuVariable]:
        """Variables of the FMU by name."""
        return {variable.name: variable for variable in self.variables}

    def with_causality(self, causality: str) -> list[FmuVariable]:
        """Return the variables with a causality, such as ``"input"``."""
        return [variable for variable in self.variables if variable.causality == causality]

    def unpack(self, folder: Path) -> FmuSource:
        """Unpack the FMU into a folder; `InputError` if the file has changed, or has no library for this platform."""
        import fmpy

        content = _read(self.path)
        if hashlib.sha256(content).hexdigest() != self.sha256:
            raise InputError(f"{self.path}: the file has changed since the command started; run the command again.")
        try:
            fmpy.extract(io.BytesIO(content), str(folder))
        except Exception as error:
            raise InputError(f"{self.path}: cannot be unpacked ({format_exception(error)}).") from error
        platform = fmpy.platform if self.version == 2 else fmpy.platform_tuple
        library = folder / "binaries" / platform / f"{self.identifier}{fmpy.sharedLibraryExtension}"
        if not library.is_file():
            with_library = sorted(entry.name for entry in folder.glob("binaries/*") if entry.is_dir())
            has = f"only for {', '.join(with_library)}" if with_library else "nor for another platform"
            raise InputError(
                f"{self.path}: has no library for {platform}, {has}; export or compile it for this platform."
            )
        proxy = Path(fmpy.__file__).parent / "logging" / fmpy.platform / f"logging{fmpy.sharedLibraryExtension}"
        return FmuSource(
            self.version,
            str(folder),
            str(library),
            self.token,
            self.log_categories,
            str(proxy) if self.version == 2 and proxy.is_file() else "",
        )


def read_fmu(path: Path) -> FmuModel:
    """Read the description of an FMU; `InputError` if the file is not an FMU for co-simulation with FMI 2.0 or 3.0."""
    try:
        status = path.stat()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error}); give the file of an FMU.") from error
    return _read_fmu(path, status.st_mtime_ns, status.st_size)


@lru_cache(maxsize=8)
def _read_fmu(path: Path, modified: int, size: int) -> FmuModel:
    try:
        import fmpy
    except ModuleNotFoundError as error:
        raise InputError(f"{path}: an FMU needs FMPy; {describe_install('fmu')}.") from error
    content = _read(path)
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            xml = archive.read("modelDescription.xml")
    except (zipfile.BadZipFile, KeyError) as error:
        raise InputError(f"{path}: is not an FMU, which is a zip file with a modelDescription.xml.") from error
    try:
        description = fmpy.read_model_description(io.BytesIO(content), validate=False)
    except Exception as error:
        reason = shorten(format_exception(error), 200)
        raise InputError(f"{path}: its modelDescription.xml cannot be read ({reason}).") from error
    version = str(description.fmiVersion)
    if not version.startswith(("2.", "3.")):
        raise InputError(f"{path}: is of FMI {version}; export it for co-simulation with FMI 2.0 or 3.0.")
    interface = description.coSimulation
    if interface is None:
        raise InputError(f"{path}: is not for co-simulation, but for model exchange; export it for co-simulation.")
    experiment = description.defaultExperiment
    step_size = interface.fixedInternalStepSize or (experiment.stepSize if experiment is not None else None)
    units = {unit.name: unit.baseUnit for unit in description.unitDefinitions}
    variables = [_make_variable(variable, units, int(version[0])) for variable in description.modelVariables]
    messages, parts = read_message_variables(
        xml, {variable.name: variable for variable in variables}, lambda sentence: InputError(f"{path}: {sentence}")
    )
    return FmuModel(
        path=path,
        sha256=hashlib.sha256(content).hexdigest(),
        name=str(description.modelName),
        fmi_version=version,
        token=str(description.guid),
        identifier=str(interface.modelIdentifier),
        once_per_process=bool(interface.canBeInstantiatedOnlyOncePerProcess),
        can_vary_step=bool(interface.canHandleVariableCommunicationStepSize),
        step_size=None if step_size is None else float(step_size),
        variables=tuple(variable for variable in variables if variable.name not in parts),
        log_categories=_select_log_categories(xml, str(description.generationTool)),
        messages=messages,
    )


def _select_log_categories(xml: bytes, tool: str) -> tuple[str, ...]:
    """Return the log categories for errors and warnings that an FMU declares in its model description."""
    declared = tuple(name for name in _LOG_CATEGORIES if f'name="{name}"'.encode() in xml)
    # PythonFMU logs Python exceptions with an empty category, and leaves out categories that are not requested.
    return (*declared, "") if declared and tool.startswith("PythonFMU") else declared


def _read(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error}).") from error


def _make_variable(variable: Any, units: Mapping[str, Any], version: int) -> FmuVariable:
    declared, kind = variable.declaredType, str(variable.type)
    if kind == "Enumeration":
        kind = "Integer" if version == 2 else "Int64"
    size = 1
    for length in variable.shape:
        size *= length
    unit_name = str(variable.unit or (declared.unit if declared is not None else None) or "")
    items = () if declared is None else declared.items
    return FmuVariable(
        name=str(variable.name),
        reference=int(variable.valueReference),
        kind=kind,
        causality=str(variable.causality),
        size=size,
        unit_name=unit_name,
        unit=_read_unit(units.get(unit_name), unit_name),
        start="" if variable.start is None else str(variable.start),
        items={str(item.name): int(item.value or k) for k, item in enumerate(items, 1)},
    )


def _read_unit(base: Any, name: str) -> Unit | None:
    """Return a unit from its definition in the FMU, or else from its name; None if the unit is unknown."""
    if base is None:
        return KNOWN_UNITS.get(name)
    if any((base.kg, base.A, base.K, base.mol, base.cd)):
        return None
    return Unit(float(base.factor), (int(base.m), int(base.s), int(base.rad)), float(base.offset))
