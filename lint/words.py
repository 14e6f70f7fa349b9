"""One word, one meaning: words that the package has given up, and what is said instead."""

from __future__ import annotations

import ast
import io
import re
import tokenize
from collections.abc import Iterator

from lint.source import PACKAGE, complain, definitions, modules

# Parts of identifiers, and what to use instead.
RETIRED = {
    "tell": "describe, format or render; tell and ask belong to optimizers",
    "tells": "describes",
    "told": "observed, given",
    "telling": "describing, example",
    "teller": "event stream",
    "foretold": "predicted",
    "foretell": "predict",
    "foretells": "predicts",
    "unforetold": "not predicted",
    "elsewhere": "source study, warm start, or remote",
    "begun": "warm start, created",
    "beginning": "warm start",
    "alike": "similar, constant",
    "apart": "gap, distance, stride",
    "whereabouts": "road position",
    "exposing": "killing",
    "unexposed": "surviving",
    "doubt": "reason unavailable",
    "dips": "local minima",
    "dip": "local minimum",
    "unseen": "new, deduplicated",
    "beside": "parallel, next to",
    "thinned": "downsampled",
    "thinning": "downsampling",
    "sealed": "with checksum",
    "seal": "checksum",
    "seals": "checksums",
    "ledger": "support table",
    "guardian": "reaper",
    "lifeline": "parent death",
    "kept": "selected, saved, cached",
    "way": "path, distance, direction, order",
    "ways": "paths, branches",
    "place": "sample, position, index, target",
    "places": "samples, positions, embedding, targets",
    "anew": "again",
    "footage": "replay data",
    "salvaged": "recovered",
    "salvaging": "recovery",
    "strangers": "untrusted",
}
# Where a retired word is a term of the field.
TERMS = re.compile(r"right_of_way|gives?_way|giving_way|RightOfWay|GiveWay")
# Pronouns and participles that say nothing as the name of a variable.
EMPTY_NAMES = {"one", "found", "known", "there", "each", "said", "about", "gone", "done_by", "asked", "those", "these"}
# In docstrings and comments.
PHRASES = re.compile(r"\b(foret[eo]ld?s?|unforetold|whom|of which|so many|so much|as of a|elsewhere)\b", re.IGNORECASE)


def check() -> Iterator[str]:
    """List retired words in names, and phrases that have to be read twice."""
    for path, module in modules().items():
        yield from _module_names(path)
        yield from _names(path, module)
        yield from _phrases(path, module)


def _parts(name: str) -> list[str]:
    return [part.lower() for part in re.findall(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])", TERMS.sub("", name))]


def _retired(name: str, path: str) -> str | None:
    optimizer = path.startswith("optimizers/")
    for part in _parts(name):
        if part in RETIRED and not (optimizer and part in ("tell", "told")):
            return f"{name}: instead of {part!r} say {RETIRED[part]}"
    return None


def _module_names(path: str) -> Iterator[str]:
    for part in path.removesuffix(".py").split("/"):
        if complaint := _retired(part, path):
            yield complain(path, 1, complaint)


def _names(path: str, module: ast.Module) -> Iterator[str]:
    for name, node in definitions(module):
        if complaint := _retired(node.name, path):
            yield complain(path, node, complaint)
        decorators = {ast.unparse(decorator) for decorator in node.decorator_list}
        if "classmethod" in decorators and re.match(r"of(_|$)", node.name):
            yield complain(path, node, f"{name}: a constructor is called from_x")
    for binding in ast.walk(module):
        if isinstance(binding, ast.arg):
            name = binding.arg
        elif isinstance(binding, ast.Name) and isinstance(binding.ctx, ast.Store):
            name = binding.id
        elif isinstance(binding, ast.Attribute) and isinstance(binding.ctx, ast.Store):
            name = binding.attr
        else:
            continue
        if complaint := _retired(name, path):
            yield complain(path, binding, complaint)
        elif name in EMPTY_NAMES:
            yield complain(path, binding, f"{name}: name the thing")


def _phrases(path: str, module: ast.Module) -> Iterator[str]:
    texts: list[tuple[int, str]] = []
    for documented in (module, *(node for _, node in definitions(module))):
        text = ast.get_docstring(documented, clean=False)
        if text is not None:
            texts.append((documented.body[0].lineno, text))
    source = io.StringIO((PACKAGE / path).read_text("utf-8"))
    texts += [
        (token.start[0], token.string)
        for token in tokenize.generate_tokens(source.readline)
        if token.type == tokenize.COMMENT
    ]
    for line, text in texts:
        for phrase in PHRASES.findall(text):
            yield complain(path, line, f"{phrase!r} has to be read twice: say it plainly")
