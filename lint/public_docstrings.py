"""Public docstrings say what is taken and returned, in which shapes, and what is raised."""

from __future__ import annotations

import ast
import dataclasses
import importlib
import inspect
import re
import textwrap
from collections.abc import Callable, Iterator
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

from numpydoc.docscrape import NumpyDocString
from numpydoc.validate import validate

import cornercase
from cornercase._common.registry import Registry

PACKAGE = Path(cornercase.__file__).parent
# Codes of numpydoc: unknown and misplaced sections, no docstring; parameters that are missing, unknown, in another
# order or without a type; nothing about what is returned or yielded. Where name and type say it all, no more is asked.
STRUCTURE = {"GL06", "GL07", "GL08"}
CALLED = STRUCTURE | {"PR01", "PR02", "PR03", "PR04", "RT01", "YD01"}


class Public(NamedTuple):
    """Something that is shown, by the name under which numpydoc finds it."""

    name: str
    value: Any
    owner: type | None = None

    @property
    def inherited(self) -> Any:
        """What a base class has under the same name."""
        bases = self.owner.__mro__[1:] if self.owner is not None else ()
        return next((vars(base)[self.value_name] for base in bases if self.value_name in vars(base)), None)

    @property
    def value_name(self) -> str:
        """The last part of the name."""
        return self.name.rpartition(".")[2]


def shown() -> Iterator[Any]:
    """What the package and its rooms show."""
    for file in sorted(PACKAGE.rglob("__init__.pyi")):
        module = importlib.import_module(".".join(["cornercase", *file.parent.relative_to(PACKAGE).parts]))
        for node in ast.parse(file.read_text("utf-8")).body:
            assert isinstance(node, ast.ImportFrom)
            yield from (getattr(module, name.name) for name in node.names)
    yield Registry


def public() -> Iterator[Public]:
    """Functions and classes that are shown, and their methods and properties."""
    seen: set[Any] = set()
    for value in shown():
        if not (inspect.isclass(value) or inspect.isroutine(value)) or value in seen:
            continue
        seen.add(value)
        yield Public(f"{value.__module__}.{value.__qualname__}", value)
        for owner in value.__mro__ if inspect.isclass(value) else ():
            for name, member in vars(owner).items():
                which = (owner, name)
                # Not what scikit-learn adds to each estimator.
                documented = inspect.isfunction(function_of(member))
                if documented and not name.startswith("_") and owner.__module__.startswith("cornercase"):
                    if which not in seen:
                        yield Public(f"{owner.__module__}.{owner.__qualname__}.{name}", member, owner)
                    seen.add(which)


def function_of(value: Any) -> Callable[..., Any] | None:
    """What is called when a function, method or class is."""
    if inspect.isclass(value):
        constructor = vars(value).get("__init__")
        return constructor if inspect.isfunction(constructor) and not dataclasses.is_dataclass(value) else None
    if isinstance(value, property):
        return value.fget
    function: Callable[..., Any] = getattr(value, "func", getattr(value, "__func__", value))
    return function


def documentation(item: Public) -> NumpyDocString:
    """The docstring, or that of the method that it overrides where it has only a summary."""
    own = NumpyDocString(inspect.getdoc(item.value) or "")
    if item.inherited is not None and not (own["Parameters"] or own["Returns"] or own["Raises"]):
        return NumpyDocString(inspect.getdoc(item.inherited) or "")
    return own


def names(document: NumpyDocString, *sections: str) -> set[str]:
    return {
        name.strip().lstrip("*") for section in sections for item in document[section] for name in item.name.split(",")
    }


def raised(function: Callable[..., Any]) -> set[str]:
    """Classes of what a function raises by itself and does not catch."""
    (tree,) = ast.parse(textwrap.dedent(inspect.getsource(function))).body
    found = set()

    def visit(node: ast.AST, caught: frozenset[str]) -> None:
        if isinstance(node, (ast.FunctionDef, ast.Lambda)) and node is not tree:
            return
        if isinstance(node, ast.Raise) and isinstance(node.exc, ast.Call):
            kind = ast.unparse(node.exc.func).rpartition(".")[2]
            if kind[0].isupper() and kind not in caught and kind != "NotImplementedError":
                found.add(kind)
        here = caught
        if isinstance(node, ast.Try):
            here |= {
                name.id
                for item in node.handlers
                if item.type
                for name in ast.walk(item.type)
                if isinstance(name, ast.Name)
            }
        for child in ast.iter_child_nodes(node):
            visit(child, here if isinstance(node, ast.Try) and child in node.body else caught)

    visit(tree, frozenset())
    return found


def check() -> Iterator[str]:
    """List what public docstrings lack."""
    for item in public():
        for lack in undocumented(item):
            yield f"{item.name}: {lack}"
        for name in () if is_property(item.value) else sorted(unnamed_errors(item)):
            yield f"{item.name}: raises {name} without saying so"
        for name in arrays_without_shape(item):
            yield f"{item.name}: {name}: an array without a shape"


def is_property(value: Any) -> bool:
    return isinstance(value, (property, cached_property))


def undocumented(item: Public) -> list[str]:
    """What a docstring lacks."""
    if not inspect.getdoc(item.value):
        return ["it has no docstring"]
    if item.inherited is not None or is_property(item.value):
        return []
    record = inspect.isclass(item.value) and (dataclasses.is_dataclass(item.value) or hasattr(item.value, "_fields"))
    asked = STRUCTURE if record or (inspect.isclass(item.value) and function_of(item.value) is None) else CALLED
    keywords = keyword_names(item)
    found = [
        text
        for code, text in validate(item.name)["errors"]
        if code in asked and not (code == "PR02" and set(re.findall(r"'(\w+)'", text)) == keywords)
    ]
    if record:
        fields = {name for name in inspect.signature(item.value).parameters if not name.startswith("_")}
        # Those of its base class are described there.
        for base in item.value.__mro__[1:]:
            fields -= getattr(base, "__dataclass_fields__", {}).keys()
        found += sorted(fields - names(documentation(item), "Parameters", "Attributes"))
    return found


def keyword_names(item: Public) -> set[str]:
    """Names that ``**options: Unpack[X]`` stands for: they are documented as other parameters."""
    function = function_of(item.value)
    packed = [str(kind) for kind in (function.__annotations__ if function else {}).values() if "Unpack[" in str(kind)]
    return {
        name
        for kind in packed
        for name in function.__globals__[kind[len("Unpack[") : -1]].__annotations__  # type: ignore[union-attr]
    }


def unnamed_errors(item: Public) -> set[str]:
    """What a function raises without a word of it in its docstring."""
    function = function_of(item.value)
    if function is None or not (found := raised(function)):
        return set()
    return found - {
        name.strip() for part in documentation(item)["Raises"] for name in f"{part.name},{part.type}".split(",")
    }


def arrays_without_shape(item: Public) -> list[str]:
    """Arrays that it takes, gives or has, of which it does not say the shape."""
    document = documentation(item)
    found = [
        f"{part.name} : {part.type}"
        for part in (*document["Parameters"], *document["Attributes"], *document["Returns"], *document["Yields"])
        if ("ndarray" in part.type or "array_like" in part.type) and "shape" not in part.type
    ]
    function = function_of(item.value)
    if function is None or inspect.isclass(item.value):
        return found
    given = function.__annotations__
    if is_property(item.value):
        unsaid = "Array" in str(given.get("return")) and "shape" not in str(inspect.getdoc(item.value))
        return [*found, *(["what it is"] if unsaid else [])]
    for section, name in (("Returns", "return"), *(("Parameters", name) for name in given if name != "return")):
        if "Array" in str(given.get(name)) and document[section]:
            types = [part.type for part in document[section] if section == "Returns" or name in part.name.split(", ")]
            if not any("shape" in text for text in types):
                found.append(name)
    return found
