"""Parameter values of a batch of concrete scenarios, in which attributes are evaluated."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from lxml import etree

from cornercase._common.errors import InputError, suggestion
from cornercase._common.numbers import number_of
from cornercase._common.places import file_of, place_of, placed
from cornercase._common.typing import BoolArray, FloatArray
from cornercase.scenario.attributes import Attributes
from cornercase.scenario.axes import TURNED, left_handed_header
from cornercase.scenario.constraints import Declaration, read_declarations, violations
from cornercase.scenario.declared_types import INTEGERS, NUMERIC, typed_numbers, typed_value, value_text
from cornercase.scenario.expressions import evaluate
from cornercase.scenario.parameter import Value
from cornercase.scenario.varies import VariesError

Catalogs = Callable[[str, str], etree._Element]
"""Returns a catalog entry by the names of catalog and entry."""

_DEEPEST = 20


class Scope(Attributes):
    """Values of parameters for N concrete scenarios.

    `catalog_lookup` returns a catalog entry by the names of catalog and entry. If `left_handed`, positions that are
    read are mirrored to the axes of the road file.
    """

    def __init__(
        self,
        source: str,
        scenarios: int,
        values: Mapping[str, Any],
        origins: Mapping[str, set[str]],
        catalogs: Catalogs | None = None,
        left_handed: bool = False,
    ) -> None:
        super().__init__(source, scenarios, values, origins)
        self._left_handed = left_handed
        self._catalogs = catalogs
        self._depth = 0

    @classmethod
    def of_file(
        cls,
        source: str,
        root: etree._Element,
        concretes: Sequence[Mapping[str, Value]],
        catalogs: Catalogs | None = None,
    ) -> Scope:
        """Create the scope of a scenario file for N concrete scenarios, as `from_declarations` does."""
        scope = cls.of_declarations(source, read_declarations(root, source), concretes, catalogs)
        scope._left_handed = left_handed_header(root) is not None
        return scope

    def number(self, element: etree._Element, attribute: str, default: float | None = None) -> FloatArray:
        """Read an attribute as a number for each scenario, in the axes of the road file, shape (N,)."""
        values = super().number(element, attribute, default)
        return 0.0 - values if self._left_handed and attribute in TURNED.get(str(element.tag), ()) else values

    @classmethod
    def of_declarations(
        cls,
        source: str,
        declarations: Sequence[Declaration],
        concretes: Sequence[Mapping[str, Value]],
        catalogs: Catalogs | None = None,
    ) -> Scope:
        """Create the scope of declared parameters; `scenario_values` has the values that differ from them.

        Raises `InputError` for undeclared parameters and values that cannot be evaluated, `BatchSplitError` if a
        parameter that is not a number has several values.
        """
        scope = cls(source, len(concretes), {}, {}, catalogs)
        names = {name for values in concretes for name in values}
        for declaration in declarations:
            name = declaration.name
            if name not in names:
                scope._declare(declaration)
                continue
            names.discard(name)
            given = {i: values[name] for i, values in enumerate(concretes) if name in values}
            origins = {name} if len(given) == len(concretes) else {name} | scope.origins(declaration.value)
            if declaration.kind in NUMERIC:
                scope.values[name] = scope._numbers(declaration, given)
            else:
                scope.values[name] = scope._one_text(declaration, given, origins)
                scope.used |= origins
            scope._origins[name] = origins
        if names:
            name = min(names)
            raise InputError(f"{source}: declares no parameter '{name}'; {suggestion(name, scope.values)}")
        return scope

    def _numbers(self, declaration: Declaration, given: Mapping[int, Value]) -> FloatArray:
        """Return the values of a numeric parameter, by default the declared one, shape (N,)."""
        result = np.full(self.scenarios, np.nan)
        if len(given) == self.scenarios and (numbers := typed_numbers([*given.values()], declaration.kind)) is not None:
            return numbers
        if len(given) < self.scenarios:
            default = self._typed(self._value(declaration.value, declaration), declaration)
            result[:] = np.nan if isinstance(default, str) else default
        for i, value in given.items():
            number = self._value(value, declaration) if isinstance(value, str) else value
            number = number[i] if isinstance(number, np.ndarray) else number
            result[i] = float(self._typed_one(number, declaration))
        return result

    def _one_text(self, declaration: Declaration, given: Mapping[int, Value], origins: set[str]) -> Any:
        """Return the common value of a parameter that is not a number."""
        texts = {str(self._typed_one(value, declaration)) for value in given.values()}
        if len(given) < self.scenarios:
            defaults = np.unique(np.asarray(self._typed(self._value(declaration.value, declaration), declaration)))
            texts |= {value_text(default) for default in defaults.tolist()}
        if len(texts) > 1:
            raise VariesError(origins)
        return self._typed(texts.pop(), declaration)

    def within(self, element: etree._Element, assignments: etree._Element | None = None) -> Scope:
        """Create the scope of a catalog entry or maneuver.

        Its own declarations come first; `assignments`, evaluated in this scope, override them.
        """
        source = file_of(element, self.source)
        inner = Scope(source, self.scenarios, self.values, self._origins, self._catalogs, self._left_handed)
        inner._depth, inner.used, inner._refused = self._depth, self.used, self._refused
        for declaration in read_declarations(element, source):
            inner._declare(declaration)
        if assignments is not None:
            for assignment in assignments.iterfind("ParameterAssignment"):
                name = assignment.get("parameterRef", "").lstrip("$")
                text = assignment.get("value", "")
                inner.values[name] = self._value(text, assignment)
                inner._origins[name] = self.origins(text)
        return inner

    def declared(self, root: etree._Element, path: str, kind: str) -> dict[str, Any]:
        """Read the values of declarations such as variables, shape (N,), by name.

        `path` leads to the declarations; `type_attribute` holds their type.
        """
        values: dict[str, Any] = {}
        for declaration in root.iterfind(path):
            if (name := declaration.get("name", "")) in values:
                raise InputError(
                    f"{place_of(declaration, self.source)}: <{declaration.tag}>: '{name}' is declared twice;"
                    " keep one of them."
                )
            numeric = declaration.get(kind, "string") in NUMERIC
            if numeric:
                values[name] = self.number(declaration, "value")
            else:
                text = self.text(declaration, "value")
                text = {"1": "true", "0": "false"}.get(text, text) if declaration.get(kind) == "boolean" else text
                values[name] = np.full(self.scenarios, text)
        return values

    def violations(self, root: etree._Element) -> dict[str, BoolArray]:
        """Return masks of shape (N,) of the scenarios that violate constraints of a file, by parameter."""
        return self.broken(read_declarations(root, self.source))

    def broken(self, declarations: Sequence[Declaration]) -> dict[str, BoolArray]:
        """Return masks of shape (N,) of the scenarios that violate constraints, by parameter; only if there are any."""
        masks: dict[str, BoolArray] = {}
        for declaration in declarations:
            with placed(declaration, self.source):
                masks |= violations([declaration], self.scenarios, self.values.__getitem__, self._bound)
        return masks

    def _bound(self, text: str) -> Any:
        text = text.strip()
        if text.startswith("${"):
            return evaluate(text[2:-1], self.values)
        return evaluate(text, self.values) if text.startswith("$") else text

    def referred(self, holder: etree._Element, tag: str) -> tuple[etree._Element, Scope]:
        """Return a child element, or the catalog entry that is referenced instead, and the scope to read it in."""
        element = holder.find(tag)
        if element is not None:
            return element, self.within(element)
        reference = holder.find("CatalogReference")
        if reference is None or self._catalogs is None:
            raise InputError(
                f"{self.source}, line {holder.sourceline}: <{holder.tag}> holds neither a <{tag}> nor a"
                " <CatalogReference>."
            )
        return self.from_catalog(reference, tag)

    def from_catalog(self, reference: etree._Element, *tags: str) -> tuple[etree._Element, Scope]:
        """Return the entry of a ``CatalogReference``, and the scope to read it in."""
        assert self._catalogs is not None
        if self._depth > _DEEPEST:
            raise InputError(
                f"{self.source}, line {reference.sourceline}: references between catalog entries are more than"
                f" {_DEEPEST} deep, or circular."
            )
        names = self.text(reference, "catalogName"), self.text(reference, "entryName")
        with placed(reference, self.source):
            element = self._catalogs(*names)
        if tags and element.tag not in tags:
            raise InputError(
                f"{self.source}, line {reference.sourceline}: the catalog entry '{self.text(reference, 'entryName')}'"
                f" is a <{element.tag}>; use a <{tags[0]}>."
            )
        inner = self.within(element, reference.find("ParameterAssignments"))
        inner._depth += 1
        return element, inner

    def _declare(self, declaration: Declaration) -> None:
        self.values[declaration.name] = self._typed(self._value(declaration.value, declaration), declaration)
        self._origins[declaration.name] = self.origins(declaration.value)

    def _typed(self, value: Any, declaration: Declaration) -> Any:
        """Convert a declared value, or the result of an expression for each scenario, to its type."""
        if isinstance(value, np.ndarray):
            if declaration.kind in INTEGERS:
                broken = np.isfinite(value) & (np.abs(value - np.round(value)) > 1e-6)
                self.refuse(declaration, "value", f"is '{declaration.value}', which is not a whole number", broken)
            return value
        if not isinstance(value, str) and declaration.kind not in INTEGERS:
            return value
        # The declaration may be for other tools only; invalid numbers are refused when they are used.
        if declaration.kind in NUMERIC and not _is_number(value):
            return value
        converted = self._typed_one(value, declaration)
        if declaration.kind == "boolean":
            return converted == "true"
        return converted if isinstance(converted, str) else float(converted)

    def _typed_one(self, value: Any, declaration: Declaration) -> Value:
        try:
            return typed_value(value, declaration.kind)
        except ValueError as why:
            raise self._error(declaration, "value", f"is '{value}', {why}") from None


def _is_number(value: Any) -> bool:
    try:
        return bool(np.isfinite(number_of(value)))
    except ValueError:
        return False


def admitted(
    declarations: Sequence[Declaration], values: Sequence[Mapping[str, Value]], source: str = "the scenario"
) -> BoolArray:
    """Return which concrete scenarios fulfil the constraints of their parameters, shape (n,)."""
    result = np.ones(len(values), dtype=np.bool_)
    try:
        scope = Scope.of_declarations(source, declarations, values)
    except VariesError as error:
        # Parameters that are not numbers have one value per batch: evaluate each combination of them separately.
        names = sorted(error.names)
        batches: dict[tuple[str, ...], list[int]] = {}
        for i, scenario in enumerate(values):
            batches.setdefault(tuple(str(scenario.get(name)) for name in names), []).append(i)
        for rows in batches.values():
            result[rows] = admitted(declarations, [values[i] for i in rows], source)
        return result
    for broken in scope.broken(declarations).values():
        result &= ~broken
    return result
