"""The parameters of a batch: each attribute of the file is one value for every concrete scenario."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from lxml import etree

from cornercase._common.errors import InputError, suggestion
from cornercase._common.typing import BoolArray, FloatArray
from cornercase.scenario.constraints import Declaration, read_declarations, violations
from cornercase.scenario.expressions import NUMERIC, evaluate, names_in, rounded, typed
from cornercase.scenario.parameter import Value
from cornercase.scenario.varies import VariesError

Catalogs = Callable[[str, str], etree._Element]
"""Name of a catalog and of an entry to the entry."""

_Placed = etree._Element | Declaration
"""What has a line in the file."""

_DEEPEST = 20


class Scope:
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
    """

    def __init__(
        self,
        source: str,
        scenarios: int,
        values: Mapping[str, Any],
        origins: Mapping[str, set[str]],
        catalogs: Catalogs | None = None,
    ) -> None:
        self.source = source
        self.scenarios = scenarios
        self.values = dict(values)
        self._origins = dict(origins)
        self._catalogs = catalogs
        self._depth = 0
        self._undefined = np.zeros(scenarios, dtype=np.bool_)

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
        return cls.of_declarations(source, read_declarations(root, source), concretes, catalogs)

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
            texts = [values.get(name, declaration.value) for values in concretes]
            if declaration.kind in NUMERIC:
                scope.values[name] = np.array([scope._number(text, declaration) for text in texts])
            else:
                different = {str(text) for text in texts}
                if len(different) > 1:
                    raise VariesError({name})
                scope.values[name] = typed(different.pop(), declaration.kind)
            scope._origins[name] = {name}
            names.discard(name)
        if names:
            name = min(names)
            raise InputError(f"{source}: declares no parameter '{name}'; {suggestion(name, scope.values)}")
        return scope

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
        inner = Scope(self.source, self.scenarios, self.values, self._origins, self._catalogs)
        inner._depth, inner._undefined = self._depth, self._undefined
        for declaration in read_declarations(element, self.source):
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
            numeric = declaration.get(kind, "string") in NUMERIC
            if numeric:
                values[declaration.get("name", "")] = self.number(declaration, "value")
            else:
                text = self.text(declaration, "value")
                text = {"1": "true", "0": "false"}.get(text, text) if declaration.get(kind) == "boolean" else text
                values[declaration.get("name", "")] = np.full(self.scenarios, text)
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
        return violations(declarations, self.scenarios, self.values.__getitem__, self._bound)

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
        element = self._catalogs(self.text(reference, "catalogName"), self.text(reference, "entryName"))
        if tags and element.tag not in tags:
            raise InputError(
                f"{self.source}, line {reference.sourceline}: the catalog entry '{self.text(reference, 'entryName')}'"
                f" is a <{element.tag}>, where a <{tags[0]}> is needed."
            )
        inner = self.within(element, reference.find("ParameterAssignments"))
        inner._depth += 1
        return element, inner

    def origins(self, text: str) -> set[str]:
        """Return the parameters of the logical scenario that an attribute depends on.

        Parameters
        ----------
        text : str
            Of the attribute.

        Returns
        -------
        set of str
        """
        return {origin for name in names_in(text) for origin in self._origins.get(name, set())}

    def number(self, element: etree._Element, attribute: str, default: float | None = None) -> FloatArray:
        """Read an attribute as a number for each scenario.

        Parameters
        ----------
        element : lxml element
        attribute : str
        default : float, optional
            Where the attribute is missing; by default it must not be.

        Returns
        -------
        ndarray of float64, shape (N,)
            Not finite where an expression has no value; `without_value` then tells so.

        Raises
        ------
        InputError
            It is missing, no number, or has no finite value in any scenario.
        """
        text = element.get(attribute)
        if text is None:
            if default is None:
                raise self._error(element, attribute, "is missing")
            return np.full(self.scenarios, float(default))
        value = self._value(text, element, attribute)
        if isinstance(value, str):
            value = self._float(value, element, attribute)
        elif isinstance(value, np.ndarray | np.floating | float):
            broken = ~np.isfinite(value)
            if broken.all():
                raise self._error(element, attribute, f"is '{text[:60]}', which has no finite value")
            self._undefined |= broken
        return np.broadcast_to(np.asarray(value, dtype=np.float64), (self.scenarios,)).copy()

    def without_value(self) -> BoolArray:
        """Tell in which scenarios a number that was read is not finite.

        Returns
        -------
        ndarray of bool, shape (N,)
        """
        return self._undefined.copy()

    def one_number(self, element: etree._Element, attribute: str, default: float | None = None) -> float:
        """Read an attribute as one number.

        Parameters
        ----------
        element : lxml element
        attribute : str
        default : float, optional
            Where the attribute is missing; by default it must not be.

        Returns
        -------
        float

        Raises
        ------
        InputError
            It is missing or no number.
        VariesError
            It is not the same for all scenarios.
        """
        values = self.number(element, attribute, default)
        if (values != values[0]).any():
            raise VariesError(self.origins(element.get(attribute, "")))
        return float(values[0])

    def text(self, element: etree._Element, attribute: str, default: str | None = None) -> str:
        """Read an attribute as one text.

        Parameters
        ----------
        element : lxml element
        attribute : str
        default : str, optional
            Where the attribute is missing; by default it must not be.

        Returns
        -------
        str
            Numbers and booleans as they would be written.

        Raises
        ------
        InputError
            It is missing.
        VariesError
            It is not the same for all scenarios.
        """
        text = element.get(attribute)
        if text is None:
            if default is None:
                raise self._error(element, attribute, "is missing")
            return default
        value = self._value(text, element, attribute)
        if isinstance(value, np.ndarray):
            if (value != value.flat[0]).any():
                raise VariesError(self.origins(text))
            value = value.flat[0].item()
        if isinstance(value, bool | np.bool_):
            return "true" if value else "false"
        if isinstance(value, float):
            # NumPy's own numbers are written as 'np.float64(8.33)'.
            return str(int(value)) if value.is_integer() else repr(float(value))
        return str(value)

    def flag(self, element: etree._Element, attribute: str, default: bool) -> bool:
        """Read an attribute as a boolean.

        Parameters
        ----------
        element : lxml element
        attribute : str
        default : bool
            Where the attribute is missing.

        Returns
        -------
        bool

        Raises
        ------
        InputError
            It is neither true nor false.
        VariesError
            It is not the same for all scenarios.
        """
        text = self.text(element, attribute, "true" if default else "false")
        if text not in ("true", "false", "1", "0"):
            raise self._error(element, attribute, f"is '{text}', not true or false")
        return text in ("true", "1")

    def _declare(self, declaration: Declaration) -> None:
        value = self._value(declaration.value, declaration)
        self.values[declaration.name] = typed(value, declaration.kind) if isinstance(value, str) else value
        self._origins[declaration.name] = self.origins(declaration.value)

    def _value(self, text: str, element: _Placed, attribute: str = "value") -> Any:
        text = text.strip()
        try:
            if text.startswith("${") and text.endswith("}"):
                return rounded(evaluate(text[2:-1], self.values))
            if text.startswith("$"):
                return evaluate(text, self.values)
        except InputError as error:
            raise self._error(element, attribute, f"cannot be evaluated. {error}") from None
        return text

    def _number(self, value: Value, element: _Placed) -> float:
        """Value given for a parameter, which may be an expression itself."""
        return self._float(self._value(value, element) if isinstance(value, str) else value, element)

    def _float(self, text: Value, element: _Placed, attribute: str = "value") -> float:
        try:
            return float(text)
        except ValueError:
            raise self._error(element, attribute, f"is '{text}', which is not a number") from None

    def _error(self, element: _Placed, attribute: str, why: str) -> InputError:
        line = f", line {element.sourceline}" if element.sourceline else ""
        return InputError(f"{self.source}{line}: {attribute} of <{element.tag}> {why}.")
