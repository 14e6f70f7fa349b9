"""Docstrings as long as their reader needs: sections for what the API reference shows, a line for the rest."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator

from lint.source import Function, complain, definitions, modules, shown_names

_SECTION = re.compile(
    r"^\s*(Parameters|Returns|Yields|Raises|Attributes|Notes|Examples|See Also|References)\n\s*-{3,}", re.M
)
# What users meet, although no stub shows where it is defined.
ALSO_SHOWN = {
    ("_common/registry.py", "Registry"),
    ("_common/errors.py", "ExpressionError"),
    ("_common/errors.py", "UserCodeError"),
}


def check() -> Iterator[str]:
    """List sections in docstrings that no page shows."""
    shown = shown_names() | ALSO_SHOWN
    bases = _bases(shown)
    for path, module in modules().items():
        for name, node in definitions(module):
            text = ast.get_docstring(node)
            if text is None or not _SECTION.search(text):
                continue
            first, *rest = name.split(".")
            public = ((path, first) in shown or (path, first) in bases) and not any(
                part.startswith("_") for part in (first, *rest)
            )
            if not public or (rest and isinstance(node, Function) and len(rest) > 1):
                yield complain(path, node, f"{name} is on no page: one plain line instead of sections")


def _bases(shown: frozenset[tuple[str, str]] | set[tuple[str, str]]) -> set[tuple[str, str]]:
    """Base classes of what is shown: their methods are on the pages of the classes that inherit them."""
    classes = {
        node.name: (path, {ast.unparse(base).split("[")[0].rpartition(".")[2] for base in node.bases})
        for path, module in modules().items()
        for node in module.body
        if isinstance(node, ast.ClassDef)
    }
    found: set[tuple[str, str]] = set()
    todo = [name for path, name in shown if name in classes and classes[name][0] == path]
    while todo:
        for base in classes[todo.pop()][1]:
            if base in classes and (classes[base][0], base) not in found:
                found.add((classes[base][0], base))
                todo.append(base)
    return found
