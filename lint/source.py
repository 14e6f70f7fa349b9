"""The package's source, parsed once."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "src" / "cornercase"
ROOMS = sorted(path.name for path in PACKAGE.iterdir() if (path / "__init__.py").exists())
# No stub shows anything of these two: the command line is used as a program, and `_common` by the other rooms.
WITHOUT_STUB = ("_common", "cli")

Function = ast.FunctionDef | ast.AsyncFunctionDef


@cache
def modules() -> dict[str, ast.Module]:
    """Parsed modules by their path below the package."""
    paths = sorted(path for path in PACKAGE.rglob("*.py") if "__pycache__" not in path.parts)
    return {path.relative_to(PACKAGE).as_posix(): ast.parse(path.read_text("utf-8")) for path in paths}


def functions() -> Iterator[tuple[str, Function]]:
    """All functions and methods, each with the path of its module."""
    for path, module in modules().items():
        yield from ((path, node) for node in ast.walk(module) if isinstance(node, Function))


def definitions(
    node: ast.AST, prefix: str = ""
) -> Iterator[tuple[str, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef]]:
    """Functions, classes and methods below a node, each with its qualified name."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, Function | ast.ClassDef):
            yield f"{prefix}{child.name}", child
            yield from definitions(child, f"{prefix}{child.name}.")
        else:
            yield from definitions(child, prefix)


def stub_imports(stub: Path) -> Iterator[tuple[str, str]]:
    """The module and the name of everything that a stub shows."""
    for node in ast.parse(stub.read_text("utf-8")).body:
        if isinstance(node, ast.ImportFrom):
            yield from ((str(node.module), alias.name) for alias in node.names)


@cache
def shown_names() -> frozenset[tuple[str, str]]:
    """Path and name of every definition that a page of the API reference shows."""
    found = set()
    for stub in PACKAGE.rglob("__init__.pyi"):
        for module, name in stub_imports(stub):
            path = stub.parent.joinpath(*module.split("."))
            file = path.with_suffix(".py") if path.with_suffix(".py").exists() else path / "__init__.py"
            found.add((file.relative_to(PACKAGE).as_posix(), name))
    return frozenset(found)


def complain(path: str, node: ast.AST | int, text: str) -> str:
    line = node if isinstance(node, int) else node.lineno  # type: ignore[attr-defined]
    return f"src/cornercase/{path}:{line}: {text}"
