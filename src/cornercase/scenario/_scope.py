"""Parameter values of a batch of concrete scenarios, for the evaluation of attributes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from lxml import etree

from cornercase._common.errors import InputError, suggest_name
from cornercase._common.text.element_locations import (
    add_location_to_input_errors,
    file_name_of_element,
    format_location,
)
from cornercase._common.text.parse_number import parse_number
from cornercase._common.typing import BoolArray, FloatArray
from cornercase.scenario._attributes import AttributeReader
from cornercase.scenario._batch_split import BatchSplitError
from cornercase.scenario._constraints import ParameterDeclaration, find_constraint_violations, read_declarations
from cornercase.scenario._expressions import evaluate_expression
from cornercase.scenario._left_handed_axes import MIRRORED_ATTRIBUTES, find_left_handed_header
from cornercase.scenario._parameter import Value
from cornercase.scenario._types import (
    INTEGER_TYPES,
    NUMERIC_TYPES,
    convert_numbers_to_type,
    convert_to_type,
    format_value,
)

CatalogLookup = Callable[[str, str], etree._Element]
"""Returns a catalog entry by the names of catalog and entry."""

_MAX_REFERENCE_DEPTH = 20


class Scope(AttributeReader):
    """Reader of attributes that knows the parameter values of N concrete scenarios.

    `catalog_lookup` takes the name of a catalog and the name of an entry, and returns the entry. If `left_handed` is
    set, positions are in left-handed axes; reading mirrors them, so that they are in the axes of the road file.
    """

    def __init__(
        self,
        file_name: str,
        n_scenarios: int,
        parameter_values: Mapping[str, Any],
        origin_parameters: Mapping[str, set[str]],
        catalog_lookup: CatalogLookup | None = None,
        left_handed: bool = False,
    ) -> None:
        super().__init__(file_name, n_scenarios, parameter_values, origin_parameters)
        self._left_handed = left_handed
        self._catalog_lookup = catalog_lookup
        self._reference_depth = 0

    @classmethod
    def from_file(
        cls,
        file_name: str,
        root: etree._Element,
        scenario_values: Sequence[Mapping[str, Value]],
        catalog_lookup: CatalogLookup | None = None,
    ) -> Scope:
        """Create the scope of a scenario file; `scenario_values` has the values that differ from the defaults.

        Raises `InputError` for undeclared parameters and for values that cannot be evaluated. Raises `BatchSplitError`
        if a parameter that is not numeric has different values in the scenarios.
        """
        scope = cls.from_declarations(file_name, read_declarations(root, file_name), scenario_values, catalog_lookup)
        scope._left_handed = find_left_handed_header(root) is not None
        return scope

    def read_numbers(self, element: etree._Element, attribute: str, default: float | None = None) -> FloatArray:
        """Read an attribute as a number for each scenario, in the axes of the road file, shape (N,)."""
        values = super().read_numbers(element, attribute, default)
        return (
            0.0 - values if self._left_handed and attribute in MIRRORED_ATTRIBUTES.get(str(element.tag), ()) else values
        )

    @classmethod
    def from_declarations(
        cls,
        file_name: str,
        declarations: Sequence[ParameterDeclaration],
        scenario_values: Sequence[Mapping[str, Value]],
        catalog_lookup: CatalogLookup | None = None,
    ) -> Scope:
        """Create the scope of declared parameters; `scenario_values` has the values that differ from the defaults.

        Raises `InputError` for undeclared parameters and for values that cannot be evaluated. Raises `BatchSplitError`
        if a parameter that is not numeric has different values in the scenarios.
        """
        scope = cls(file_name, len(scenario_values), {}, {}, catalog_lookup)
        names = {name for values in scenario_values for name in values}
        for declaration in declarations:
            name = declaration.name
            if name not in names:
                scope._add_declaration(declaration)
                continue
            names.discard(name)
            given = {i: values[name] for i, values in enumerate(scenario_values) if name in values}
            origins = (
                {name}
                if len(given) == len(scenario_values)
                else {name} | scope.find_origin_parameters(declaration.value)
            )
            if declaration.type_name in NUMERIC_TYPES:
                scope.parameter_values[name] = scope._numeric_values(declaration, given)
            else:
                scope.parameter_values[name] = scope._common_text(declaration, given, origins)
                scope.split_parameters |= origins
            scope._origin_parameters[name] = origins
        if names:
            name = min(names)
            raise InputError(
                f"{file_name}: declares no parameter '{name}'; {suggest_name(name, scope.parameter_values)}"
            )
        return scope

    def _numeric_values(self, declaration: ParameterDeclaration, assigned: Mapping[int, Value]) -> FloatArray:
        """Return the values of a numeric parameter, shape (N,).

        `assigned` has values by index of the scenario. All other scenarios get the declared value.
        """
        result = np.full(self.n_scenarios, np.nan)
        if (
            len(assigned) == self.n_scenarios
            and (numbers := convert_numbers_to_type([*assigned.values()], declaration.type_name)) is not None
        ):
            return numbers
        if len(assigned) < self.n_scenarios:
            default = self._convert_to_type(self._evaluate(declaration.value, declaration), declaration)
            result[:] = np.nan if isinstance(default, str) else default
        for i, value in assigned.items():
            number = self._evaluate(value, declaration) if isinstance(value, str) else value
            number = number[i] if isinstance(number, np.ndarray) else number
            result[i] = float(self._convert_scalar_to_type(number, declaration))
        return result

    def _common_text(
        self, declaration: ParameterDeclaration, assigned: Mapping[int, Value], origin_parameters: set[str]
    ) -> Any:
        """Return the value of a parameter that is not numeric; it must be the same in all scenarios.

        Raises `BatchSplitError` if the scenarios have different values.
        """
        texts = {str(self._convert_scalar_to_type(value, declaration)) for value in assigned.values()}
        if len(assigned) < self.n_scenarios:
            defaults = np.unique(
                np.asarray(self._convert_to_type(self._evaluate(declaration.value, declaration), declaration))
            )
            texts |= {format_value(default) for default in defaults.tolist()}
        if len(texts) > 1:
            raise BatchSplitError(origin_parameters)
        return self._convert_to_type(texts.pop(), declaration)

    def nested_scope(self, element: etree._Element, assignments: etree._Element | None = None) -> Scope:
        """Create the scope of a nested element, such as a catalog entry or a maneuver.

        The new scope has the parameters of this scope, and those that the nested element declares. The latter have
        their declared values, or the values in `assignments`, which can refer to parameters of this scope.
        """
        source = file_name_of_element(element, self.file_name)
        inner = Scope(
            source,
            self.n_scenarios,
            self.parameter_values,
            self._origin_parameters,
            self._catalog_lookup,
            self._left_handed,
        )
        inner._reference_depth, inner.split_parameters, inner._invalid_values = (
            self._reference_depth,
            self.split_parameters,
            self._invalid_values,
        )
        for declaration in read_declarations(element, source):
            inner._add_declaration(declaration)
        if assignments is not None:
            for assignment in assignments.iterfind("ParameterAssignment"):
                name = assignment.get("parameterRef", "").lstrip("$")
                text = assignment.get("value", "")
                inner.parameter_values[name] = self._evaluate(text, assignment)
                inner._origin_parameters[name] = self.find_origin_parameters(text)
        return inner

    def read_declared_values(self, root: etree._Element, path: str, type_attribute: str) -> dict[str, Any]:
        """Read the initial values of variables or similar items; return an array of shape (N,) by name.

        `path` leads from `root` to the elements that declare them. `type_attribute` is the attribute with the type.
        """
        values: dict[str, Any] = {}
        for declaration in root.iterfind(path):
            if (name := declaration.get("name", "")) in values:
                raise InputError(
                    f"{format_location(declaration, self.file_name)}: <{declaration.tag}>: '{name}' is declared twice;"
                    " keep one of them."
                )
            numeric = declaration.get(type_attribute, "string") in NUMERIC_TYPES
            if numeric:
                values[name] = self.read_numbers(declaration, "value")
            else:
                text = self.read_text(declaration, "value")
                text = (
                    {"1": "true", "0": "false"}.get(text, text)
                    if declaration.get(type_attribute) == "boolean"
                    else text
                )
                values[name] = np.full(self.n_scenarios, text)
        return values

    def find_violations_in(self, root: etree._Element) -> dict[str, BoolArray]:
        """Return a mask of the violating scenarios, shape (N,), for each parameter whose constraints are violated.

        `root` is the element that declares the parameters.
        """
        return self.find_violations(read_declarations(root, self.file_name))

    def find_violations(self, declarations: Sequence[ParameterDeclaration]) -> dict[str, BoolArray]:
        """Return a mask of the violating scenarios, shape (N,), for each parameter whose constraints are violated."""
        masks: dict[str, BoolArray] = {}
        for declaration in declarations:
            with add_location_to_input_errors(declaration, self.file_name):
                masks |= find_constraint_violations(
                    [declaration], self.n_scenarios, self.parameter_values.__getitem__, self._evaluate_bound
                )
        return masks

    def _evaluate_bound(self, text: str) -> Any:
        text = text.strip()
        if text.startswith("${"):
            return evaluate_expression(text[2:-1], self.parameter_values)
        return evaluate_expression(text, self.parameter_values) if text.startswith("$") else text

    def resolve_element_or_reference(self, parent: etree._Element, tag: str) -> tuple[etree._Element, Scope]:
        """Return the child of `parent` with the tag `tag`, and the scope to read the child's attributes.

        If `parent` has a ``CatalogReference`` instead, return the catalog entry and its scope.
        """
        element = parent.find(tag)
        if element is not None:
            return element, self.nested_scope(element)
        reference = parent.find("CatalogReference")
        if reference is None or self._catalog_lookup is None:
            raise InputError(
                f"{self.file_name}, line {parent.sourceline}: <{parent.tag}> holds neither a <{tag}> nor a"
                " <CatalogReference>."
            )
        return self.resolve_catalog_reference(reference, tag)

    def resolve_catalog_reference(self, reference: etree._Element, *allowed_tags: str) -> tuple[etree._Element, Scope]:
        """Return the catalog entry that a ``CatalogReference`` names, and the scope to read the entry's attributes."""
        assert self._catalog_lookup is not None
        if self._reference_depth > _MAX_REFERENCE_DEPTH:
            raise InputError(
                f"{self.file_name}, line {reference.sourceline}: references between catalog entries are more than"
                f" {_MAX_REFERENCE_DEPTH} deep, or circular."
            )
        names = self.read_text(reference, "catalogName"), self.read_text(reference, "entryName")
        with add_location_to_input_errors(reference, self.file_name):
            element = self._catalog_lookup(*names)
        if allowed_tags and element.tag not in allowed_tags:
            raise InputError(
                f"{self.file_name}, line {reference.sourceline}: the catalog entry"
                f" '{self.read_text(reference, 'entryName')}'"
                f" is a <{element.tag}>; use a <{allowed_tags[0]}>."
            )
        inner = self.nested_scope(element, reference.find("ParameterAssignments"))
        inner._reference_depth += 1
        return element, inner

    def _add_declaration(self, declaration: ParameterDeclaration) -> None:
        self.parameter_values[declaration.name] = self._convert_to_type(
            self._evaluate(declaration.value, declaration), declaration
        )
        self._origin_parameters[declaration.name] = self.find_origin_parameters(declaration.value)

    def _convert_to_type(self, value: Any, declaration: ParameterDeclaration) -> Any:
        """Convert a scalar to the declared type of a parameter.

        An array (one number per scenario) is returned unchanged; for integer types, other numbers are recorded as
        invalid.
        """
        if isinstance(value, np.ndarray):
            if declaration.type_name in INTEGER_TYPES:
                broken = np.isfinite(value) & (np.abs(value - np.round(value)) > 1e-6)
                self.mark_invalid(
                    declaration, "value", f"is '{declaration.value}', which is not a whole number", broken
                )
            return value
        if not isinstance(value, str) and declaration.type_name not in INTEGER_TYPES:
            return value
        # The declaration may be for other tools only; invalid numbers are refused when they are used.
        if declaration.type_name in NUMERIC_TYPES and not _is_finite_number(value):
            return value
        converted = self._convert_scalar_to_type(value, declaration)
        if declaration.type_name == "boolean":
            return converted == "true"
        return converted if isinstance(converted, str) else float(converted)

    def _convert_scalar_to_type(self, value: Any, declaration: ParameterDeclaration) -> Value:
        try:
            return convert_to_type(value, declaration.type_name)
        except ValueError as why:
            raise self._error(declaration, "value", f"is '{value}', {why}") from None


def _is_finite_number(value: Any) -> bool:
    try:
        return bool(np.isfinite(parse_number(value)))
    except ValueError:
        return False


def fulfils_constraints(
    declarations: Sequence[ParameterDeclaration],
    scenario_values: Sequence[Mapping[str, Value]],
    file_name: str = "the scenario",
) -> BoolArray:
    """Return a mask of the scenarios whose parameter values fulfil all constraints, shape (n,)."""
    result = np.ones(len(scenario_values), dtype=np.bool_)
    try:
        scope = Scope.from_declarations(file_name, declarations, scenario_values)
    except BatchSplitError as error:
        # Parameters that are not numbers have one value per batch: evaluate each combination of them separately.
        names = sorted(error.parameter_names)
        batches: dict[tuple[str, ...], list[int]] = {}
        for i, scenario in enumerate(scenario_values):
            batches.setdefault(tuple(str(scenario.get(name)) for name in names), []).append(i)
        for rows in batches.values():
            result[rows] = fulfils_constraints(declarations, [scenario_values[i] for i in rows], file_name)
        return result
    for broken in scope.find_violations(declarations).values():
        result &= ~broken
    return result
