"""The parameters of a batch: each attribute of the file is one value for every concrete scenario."""

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
"""Name of a catalog and of an entry to the entry."""

_DEEPEST = 20


class Scope(Attributes):
    """Values of parameters for N concrete scenarios.

    Parameters
    ----------
    source : str
        Name of the file, for messages.
    scenarios : int
        N.
    values : mapping of str to float, bool, str or ndarray of shape (N,)
    origins : mapping of str to set of str
        For each parameter, the parameters of the logical scenario that its value depends on.
    catalogs : callable, optional
        Gives the entry of a catalog, by the names of both.
    left_handed : bool, default False
        Whether the file's positions are in left-handed axes; what is read of them is turned.
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
        """Make the scope of a scenario file's parameter declarations.

        Parameters
        ----------
        source : str
            Name of the file, for messages.
        root : lxml element
        concretes : sequence of mapping of str to float or str, length N
        catalogs : callable, optional

        Returns
        -------
        Scope
            As in `of_declarations`.
        """
        scope = cls.of_declarations(source, read_declarations(root, source), concretes, catalogs)
        scope._left_handed = left_handed_header(root) is not None
        return scope

    def number(self, element: etree._Element, attribute: str, default: float | None = None) -> FloatArray:
        """Read an attribute as a number for each scenario, in the axes of the road file; as `Attributes.number`."""
        found = super().number(element, attribute, default)
        return 0.0 - found if self._left_handed and attribute in TURNED.get(str(element.tag), ()) else found

    @classmethod
    def of_declarations(
        cls,
        source: str,
        declarations: Sequence[Declaration],
        concretes: Sequence[Mapping[str, Value]],
        catalogs: Catalogs | None = None,
    ) -> Scope:
        """Make the scope of declared parameters.

        Parameters
        ----------
        source : str
            Name of the file, for messages.
        declarations : sequence of Declaration
        concretes : sequence of mapping of str to float or str, length N
            Values that differ from the declared ones, for each concrete scenario.
        catalogs : callable, optional
            Gives the entry of a catalog, by the names of both.

        Returns
        -------
        Scope

        Raises
        ------
        InputError
            A value is given for a parameter that is not declared, or cannot be evaluated.
        VariesError
            A parameter that is no number has several values.
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
        """Values of a numeric parameter, its own where none is given, shape (N,)."""
        result = np.full(self.scenarios, np.nan)
        if len(given) == self.scenarios and (numbers := typed_numbers([*given.values()], declaration.kind)) is not None:
            return numbers
        if len(given) < self.scenarios:
            own = self._typed(self._value(declaration.value, declaration), declaration)
            result[:] = np.nan if isinstance(own, str) else own
        for i, value in given.items():
            one = self._value(value, declaration) if isinstance(value, str) else value
            one = one[i] if isinstance(one, np.ndarray) else one
            result[i] = float(self._typed_one(one, declaration))
        return result

    def _one_text(self, declaration: Declaration, given: Mapping[int, Value], origins: set[str]) -> Any:
        """Value of a parameter that is no number, the same for all."""
        found = {str(self._typed_one(value, declaration)) for value in given.values()}
        if len(given) < self.scenarios:
            own = np.unique(np.asarray(self._typed(self._value(declaration.value, declaration), declaration)))
            found |= {value_text(one) for one in own.tolist()}
        if len(found) > 1:
            raise VariesError(origins)
        return self._typed(found.pop(), declaration)

    def within(self, element: etree._Element, assignments: etree._Element | None = None) -> Scope:
        """Make the scope of a catalog entry or maneuver.

        Parameters
        ----------
        element : lxml element
            Its own declarations come first.
        assignments : lxml element, optional
            Overwrite them; their values are read in this scope.

        Returns
        -------
        Scope

        Raises
        ------
        InputError
            A value cannot be evaluated.
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
        """Read the values of declarations such as those of variables.

        Parameters
        ----------
        root : lxml element
        path : str
            To the declarations.
        kind : str
            Attribute that holds the type.

        Returns
        -------
        dict of str to ndarray of float64 or str, shape (N,)
            By name.

        Raises
        ------
        InputError
            A value is missing or cannot be evaluated.
        """
        values: dict[str, Any] = {}
        for declaration in root.iterfind(path):
            if (name := declaration.get("name", "")) in values:
                raise InputError(
                    f"{place_of(declaration, self.source)}: <{declaration.tag}>: '{name}' is declared a second time;"
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
        """Find where parameters break the constraints of their declarations in a file.

        Parameters
        ----------
        root : lxml element

        Returns
        -------
        dict of str to ndarray of bool, shape (N,)
            By parameter, without those that never do.

        Raises
        ------
        InputError
            A bound cannot be evaluated.
        """
        return self.broken(read_declarations(root, self.source))

    def broken(self, declarations: Sequence[Declaration]) -> dict[str, BoolArray]:
        """Find where parameters break the constraints of declarations.

        Parameters
        ----------
        declarations : sequence of Declaration

        Returns
        -------
        dict of str to ndarray of bool, shape (N,)
            By parameter, without those that never do.

        Raises
        ------
        InputError
            A bound cannot be evaluated.
        """
        found: dict[str, BoolArray] = {}
        for declaration in declarations:
            with placed(declaration, self.source):
                found |= violations([declaration], self.scenarios, self.values.__getitem__, self._bound)
        return found

    def _bound(self, text: str) -> Any:
        text = text.strip()
        if text.startswith("${"):
            return evaluate(text[2:-1], self.values)
        return evaluate(text, self.values) if text.startswith("$") else text

    def referred(self, holder: etree._Element, tag: str) -> tuple[etree._Element, Scope]:
        """Find an element that stands in a holder, or in a catalog that the holder refers to.

        Parameters
        ----------
        holder : lxml element
        tag : str

        Returns
        -------
        lxml element
        Scope
            To read it in.

        Raises
        ------
        InputError
            There is neither.
        """
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
        """Find the entry that a ``CatalogReference`` names.

        Parameters
        ----------
        reference : lxml element
        *tags : str
            Kinds of entry that are allowed; by default all.

        Returns
        -------
        lxml element
        Scope
            To read it in.

        Raises
        ------
        InputError
            There is no such entry, or it is of another kind.
        """
        assert self._catalogs is not None
        if self._depth > _DEEPEST:
            raise InputError(
                f"{self.source}, line {reference.sourceline}: catalog entries refer to each other more than {_DEEPEST}"
                " deep, or in a circle."
            )
        names = self.text(reference, "catalogName"), self.text(reference, "entryName")
        with placed(reference, self.source):
            element = self._catalogs(*names)
        if tags and element.tag not in tags:
            raise InputError(
                f"{self.source}, line {reference.sourceline}: the catalog entry '{self.text(reference, 'entryName')}'"
                f" is a <{element.tag}>, where a <{tags[0]}> is needed."
            )
        inner = self.within(element, reference.find("ParameterAssignments"))
        inner._depth += 1
        return element, inner

    def _declare(self, declaration: Declaration) -> None:
        self.values[declaration.name] = self._typed(self._value(declaration.value, declaration), declaration)
        self._origins[declaration.name] = self.origins(declaration.value)

    def _typed(self, value: Any, declaration: Declaration) -> Any:
        """Give a declared value its type; it may be the result of an expression, one for each scenario."""
        if isinstance(value, np.ndarray):
            if declaration.kind in INTEGERS:
                broken = np.isfinite(value) & (np.abs(value - np.round(value)) > 1e-6)
                self.refuse(declaration, "value", f"is '{declaration.value}', which is not a whole number", broken)
            return value
        if not isinstance(value, str) and declaration.kind not in INTEGERS:
            return value
        # A declaration may be there for other tools only: what is no number is refused where it is used.
        if declaration.kind in NUMERIC and not _is_number(value):
            return value
        one = self._typed_one(value, declaration)
        if declaration.kind == "boolean":
            return one == "true"
        return one if isinstance(one, str) else float(one)

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
