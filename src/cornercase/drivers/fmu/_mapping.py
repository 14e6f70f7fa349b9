"""Mapping of an FMU's variables: the quantity that each input is given, and the decision that each output makes."""

from __future__ import annotations

import hashlib
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from cornercase._common.errors import InputError, suggest_name
from cornercase._common.text.sanitize import format_exception
from cornercase._common.typing import FloatArray
from cornercase.drivers.fmu._input_quantities import (
    OUTPUTS,
    InputQuantity,
    Traffic,
    find_object_quantities,
    find_quantity,
    recognize_input,
    recognize_output,
    suggest_quantity,
)
from cornercase.drivers.fmu._model import FmuModel, FmuVariable
from cornercase.drivers.fmu._osmp_map import OsmpMap
from cornercase.drivers.fmu._processes import TableLayout
from cornercase.drivers.fmu._variable_units import KNOWN_UNITS, SI, Unit, has_same_dimension

_PEDALS: Final = ("throttle", "brake")
_INPUT_KEYS: Final = ("from", "none", "unit", "factor")
_OUTPUT_KEYS: Final = ("from", "unit", "factor")


@dataclass(frozen=True)
class MappedVariable:
    """Variable of an FMU, and its use by a driver.

    Attributes
    ----------
    name : str
        Name of the variable in the FMU.
    causality : {"input", "output", "parameter"}
        Role in the FMU; a local variable that a map reads counts as an output.
    unit : str
        Unit that the FMU declares. If it declares none, the unit in the map or an assumed unit for a variable that has
        a quantity or makes a decision, and otherwise empty.
    source : str
        For an input, the quantity or number that cornercase writes to it; for an output, the decision of the driver
        that cornercase reads from it; for a parameter, the value that was given. Empty if the variable is not used.
    remark : str
        Note about the variable, such as the start value that an unused input keeps; may be empty.

    Examples
    --------
    >>> from cornercase.drivers import FmuDriver
    >>> for variable in FmuDriver("aeb.fmu", map="aeb.toml").variables():  # doctest: +SKIP
    ...     print(f"{variable.causality} {variable.name}: {variable.source or 'not used'}, in {variable.unit}")
    """

    name: str
    causality: str
    unit: str
    source: str
    remark: str = ""


@dataclass(frozen=True)
class InputColumn:
    """Value of an FMU input: ``(quantity - offset) * factor``, or `none` in scenarios without the quantity.

    If `quantity` is None, the value is the constant `none`.
    """

    quantity: InputQuantity | None
    factor: float
    offset: float
    none: float

    def compute(self, traffic: Traffic) -> FloatArray | float:
        """Return the value in each scenario, in the unit of the FMU's input."""
        if self.quantity is None:
            return self.none
        values = self.quantity.compute(traffic)
        return np.where(np.isfinite(values), (values - self.offset) * self.factor, self.none)


@dataclass(frozen=True)
class Input:
    """Input of an FMU, with a column for its value, or for each value if the input is an array."""

    variable: FmuVariable
    columns: tuple[InputColumn, ...]


@dataclass(frozen=True)
class Output:
    """Output of an FMU that makes a decision: ``factor * value + offset`` in SI units."""

    variable: FmuVariable
    decision: str
    factor: float
    offset: float


class VariableMap:
    """Map from quantities to an FMU's inputs, and from the FMU's outputs to decisions, as tables for shared memory.

    Each table holds the variables of one FMI type. `messages` are the FMU's OSI messages. If the FMU writes its motion
    as an OSI message, this message decides, unless the map file has outputs.
    """

    def __init__(self, model: FmuModel, path: Path | None) -> None:
        self._model, self._where = model, path or model.path
        document, self.sha256 = _read_map(path) if path is not None else ({}, "")
        self.messages = OsmpMap(model.messages, decides="outputs" not in document)
        has_motion = self.messages.motion is not None
        self.listing: list[MappedVariable] = []
        self.inputs = self._map_inputs(document.get("inputs"))
        self.outputs = self._map_outputs({} if has_motion else document.get("outputs"))
        if not has_motion:
            self._check_decisions()
        for variable, source, remark in self.messages.listing:
            self.listing.append(MappedVariable(variable.name, variable.causality, "", source, remark))
        self._input_kinds = _group_by_type([mapped.variable for mapped in self.inputs])
        self._output_kinds = _group_by_type([mapped.variable for mapped in self.outputs])
        self.input_layouts = [self._layout(self.inputs, members) for members in self._input_kinds]
        self.output_layouts = [self._layout(self.outputs, members) for members in self._output_kinds]

    def fill_inputs(self, traffic: Traffic) -> list[npt.NDArray[Any]]:
        """Compute all inputs of the FMU; return a table for each FMI type, with a row per scenario."""
        n, tables = len(traffic.situation.speed), list[npt.NDArray[Any]]()
        for layout, members in zip(self.input_layouts, self._input_kinds, strict=True):
            values = np.empty((n, layout.width))
            columns = [column for k in members for column in self.inputs[k].columns]
            for k, column in enumerate(columns):
                values[:, k] = column.compute(traffic)
            tables.append(_convert(values, layout))
        return tables

    def read_outputs(self, tables: Sequence[npt.NDArray[Any]]) -> dict[str, FloatArray]:
        """Return the decisions by name in SI units, each of shape (N,) for N scenarios."""
        decisions: dict[str, FloatArray] = {}
        for table, members in zip(tables, self._output_kinds, strict=True):
            for k, member in enumerate(members):
                output = self.outputs[member]
                decisions[output.decision] = output.factor * table[:, k].astype(np.float64) + output.offset
        return decisions

    def _layout(self, mapped: Sequence[Input | Output], members: Sequence[int]) -> TableLayout:
        variables = [mapped[k].variable for k in members]
        return TableLayout(
            variables[0].kind,
            tuple(variable.reference for variable in variables),
            sum(variable.size for variable in variables),
            variables[0].dtype(self._model.version),
        )

    def _map_inputs(self, table: Mapping[str, Any] | None) -> list[Input]:
        """Return the inputs in the table [inputs] of the map, or without this table those with recognized names."""
        variables = self._model.with_causality("input")
        if table is None:
            named = {
                variable.name: recognize_input(variable.name, is_array=variable.size > 1) for variable in variables
            }
            table = {name: source for name, source in named.items() if source is not None}
        inputs = []
        for name, entry in table.items():
            variable = self._find_variable(name, variables, "input")
            inputs.append(self._map_input(variable, entry))
        for variable in variables:
            if variable.name not in table:
                remark = f"keeps its start value {variable.start}" if variable.start else "keeps its start value"
                self.listing.append(MappedVariable(variable.name, "input", variable.unit_name, "", remark))
        return inputs

    def _map_input(self, variable: FmuVariable, entry: object) -> Input:
        where = f"{self._where}: input '{variable.name}'"
        if isinstance(entry, bool | int | float):
            self.listing.append(MappedVariable(variable.name, "input", variable.unit_name, str(entry).lower()))
            return Input(variable, (InputColumn(None, 1.0, 0.0, float(entry)),) * variable.size)
        options = _check_entry(where, entry, _INPUT_KEYS, "leader.gap")
        source = options["from"]
        quantities = find_object_quantities(source, variable.size) if variable.size > 1 else None
        if quantities is None and variable.size == 1 and (quantity := find_quantity(source)) is not None:
            quantities = [quantity]
        if quantities is None:
            if variable.size > 1:
                raise InputError(
                    f"{where} is an array of {variable.size} values, which '{source}' cannot fill; give a quantity of"
                    " all objects, such as 'object.x'."
                )
            raise InputError(f"{where}: there is no quantity '{source}'; {suggest_quantity(source)}")
        unit, remark = self._unit_of(variable, options.get("unit"), quantities[0].unit, where)
        factor = options.get("factor", 1.0)
        columns = []
        for quantity in quantities:
            none = options.get("none", (quantity.none - unit.offset) / unit.factor * factor)
            columns.append(InputColumn(quantity, factor / unit.factor, unit.offset, none))
        name = options.get("unit") or variable.unit_name or quantities[0].unit
        source = source if factor == 1.0 else f"{factor:g} * {source}"
        self.listing.append(MappedVariable(variable.name, "input", name, source, remark))
        return Input(variable, tuple(columns))

    def _map_outputs(self, table: Mapping[str, Any] | None) -> list[Output]:
        variables = self._model.with_causality("output")
        if table is None:
            table = {}
            for variable in variables:
                decision = recognize_output(variable.name) if variable.size == 1 else None
                if decision in table:
                    raise InputError(
                        f"{self._where}: the outputs '{table[decision]}' and '{variable.name}' both seem to be the"
                        f" {decision}; give a map that names one of them, `map=FILE.toml`."
                    )
                if decision is not None:
                    table[decision] = variable.name
        outputs, readable = [], [*variables, *self._model.with_causality("local")]
        for decision, entry in table.items():
            if decision not in OUTPUTS:
                raise InputError(f"{self._where}: there is no decision '{decision}'; {suggest_name(decision, OUTPUTS)}")
            where = f"{self._where}: {decision}"
            options = _check_entry(where, entry, _OUTPUT_KEYS, "a_cmd")
            variable = self._find_variable(options["from"], readable, "output")
            if variable.size > 1:
                raise InputError(f"{where}: '{variable.name}' is an array; name an output with one value.")
            unit, remark = self._unit_of(variable, options.get("unit"), OUTPUTS[decision], where)
            factor = options.get("factor", 1.0)
            name = options.get("unit") or variable.unit_name or OUTPUTS[decision]
            decides = decision if factor == 1.0 else f"{decision} = {factor:g} * it"
            self.listing.append(MappedVariable(variable.name, "output", name, decides, remark))
            outputs.append(Output(variable, decision, unit.factor * factor, unit.offset))
        used = {output.variable.name for output in outputs}
        self.listing += [
            MappedVariable(variable.name, "output", variable.unit_name, "")
            for variable in variables
            if variable.name not in used
        ]
        return outputs

    def _check_decisions(self) -> None:
        given = {output.decision for output in self.outputs}
        has_pedals = not given.isdisjoint(_PEDALS)
        if not given:
            names = ", ".join(variable.name for variable in self._model.with_causality("output")) or "none"
            writes = ", and the FMU writes neither a TrafficUpdate nor a MotionRequest" if self._model.messages else ""
            raise InputError(
                f"{self._where}: none of the outputs ({names}) is recognized as a decision"
                f" ({', '.join(OUTPUTS)}){writes}; say in a map what the outputs decide, `map=FILE.toml`."
            )
        if "acceleration" not in given and not has_pedals:
            raise InputError(
                f"{self._where}: the outputs decide {' and '.join(sorted(given))}, but a driver must also decide the"
                " acceleration, or throttle and brake; say in a map which output does, `map=FILE.toml`."
            )
        if "acceleration" in given and has_pedals:
            raise InputError(
                f"{self._where}: the outputs decide {', '.join(sorted(given))}; a driver decides either the"
                " acceleration, or throttle and brake: choose in a map, `map=FILE.toml`."
            )
        if {"steering", "lane_change"} <= given:
            raise InputError(
                f"{self._where}: the outputs decide both steering and lane changes, but a lane change steers by"
                " itself; leave out one of the two in a map, `map=FILE.toml`."
            )

    def _find_variable(self, name: str, variables: Sequence[FmuVariable], what: str) -> FmuVariable:
        variable = next((variable for variable in variables if variable.name == name), None)
        if variable is None:
            names = [variable.name for variable in variables]
            raise InputError(f"{self._where}: the FMU has no {what} '{name}'; {suggest_name(name, names)}")
        if not variable.is_number:
            raise InputError(f"{self._where}: the {what} '{name}' is a {variable.kind}, not a number; leave it out.")
        return variable

    def _unit_of(self, variable: FmuVariable, given: str | None, symbol: str, where: str) -> tuple[Unit, str]:
        """Return the unit of a variable, and a remark about an assumed unit for `MappedVariable.remark`.

        `given` is the unit in the map file, or None. Raises `InputError` if the unit does not fit the SI unit `symbol`.
        """
        if given is not None:
            if given not in KNOWN_UNITS:
                raise InputError(f"{where} has the unknown unit '{given}'; {suggest_name(given, KNOWN_UNITS)}")
            if variable.unit_name and variable.unit_name != given:
                raise InputError(
                    f"{where} has the unit '{given}', but the FMU says '{variable.unit_name}'; leave out the unit."
                )
            unit: Unit | None = KNOWN_UNITS[given]
        elif not variable.unit_name:
            return SI[symbol], "" if symbol == "1" else f"has no unit: taken as {symbol}"
        else:
            unit = variable.unit
        name = given or variable.unit_name
        if unit is None:
            raise InputError(
                f"{where}: '{variable.name}' has the unit '{name}', which the FMU does not define by m, s and rad;"
                " define the unit in the FMU by these base units."
            )
        if not has_same_dimension(unit, symbol):
            raise InputError(f"{where}: '{variable.name}' has the unit '{name}', which does not fit {symbol}.")
        return unit, ""


def _convert(values: FloatArray, layout: TableLayout) -> npt.NDArray[Any]:
    """Convert values to the type of a table: round and clip for integers; booleans are true unless rounded to 0."""
    dtype = np.dtype(layout.dtype)
    if dtype.kind == "f":
        return values.astype(dtype)
    rounded: FloatArray = np.rint(values)
    if layout.kind == "Boolean":
        is_true: npt.NDArray[np.bool_] = rounded != 0.0
        return is_true.astype(dtype)
    limits = np.iinfo(dtype)
    # The largest 64-bit integer cannot be represented as a float.
    highest = float(limits.max) if dtype.itemsize < 8 else np.nextafter(float(limits.max), 0.0)
    clipped: FloatArray = np.clip(rounded, float(limits.min), highest)
    return clipped.astype(dtype)


def _group_by_type(variables: Sequence[FmuVariable]) -> list[list[int]]:
    """Group variables by FMI type; return their indices, one list per type."""
    kinds: dict[str, list[int]] = {}
    for k, variable in enumerate(variables):
        kinds.setdefault(variable.kind, []).append(k)
    return list(kinds.values())


def _check_entry(where: str, entry: object, keys: Sequence[str], example: str) -> dict[str, Any]:
    """Return an entry of a map file as a dict: a plain text becomes the value of the key ``from``.

    Raises `InputError` for unknown keys and wrong values; `where` says in the message which entry is wrong.
    """
    options = {"from": entry} if isinstance(entry, str) else entry
    if not isinstance(options, dict) or not isinstance(options.get("from"), str):
        raise InputError(f'{where}: give a name, as in "{example}" or {{ from = "{example}" }}.')
    for key, value in options.items():
        if key not in keys:
            raise InputError(f"{where}: has the unknown key '{key}'; {suggest_name(key, keys)}")
        if key in ("none", "factor"):
            if isinstance(value, bool) or not isinstance(value, int | float) or (key == "factor" and not value):
                raise InputError(
                    f"{where}: `{key}` is {value!r}; give a number{' other than 0' if key == 'factor' else ''}."
                )
        elif not isinstance(value, str):
            raise InputError(f"{where}: `{key}` is {value!r}; give a text.")
    return options


def _read_map(path: Path) -> tuple[dict[str, Any], str]:
    """Return the tables of a map file (TOML), and the SHA-256 of the file."""
    try:
        content = path.read_bytes()
        document = tomllib.loads(content.decode())
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error}).") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: is no TOML file ({format_exception(error)}).") from error
    for name, table in document.items():
        if name not in ("inputs", "outputs") or not isinstance(table, dict):
            raise InputError(f"{path}: has '{name}'; a map has only the tables [inputs] and [outputs].")
    return document, hashlib.sha256(content).hexdigest()
