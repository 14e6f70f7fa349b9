"""Escape, shorten and wrap texts that come from files or users."""

from __future__ import annotations

import inspect
import json
import math
import re
import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

from cornercase._common.errors import InputError

# Control characters except tab and newline, direction marks, and lone surrogates.
_CONTROL_CHARACTERS: Final = re.compile(
    "[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ufeff\ud800-\udfff]"
)
_SURROGATE: Final = re.compile("[\ud800-\udfff]")
# JSON text that may decode to a lone surrogate.
_POSSIBLE_SURROGATE: Final = re.compile(r"\\u[dD][89a-fA-F]|[\ud800-\udfff]")
# Text that a spreadsheet takes for a formula, perhaps after apostrophes that escape the formula.
_FORMULA_START: Final = re.compile("'*[=+\\-@\t\r\n\uff1d\uff0b\uff0d\uff20]")
# Names without spaces and commas need no quotes in a sentence.
_SINGLE_WORD: Final = re.compile(r"[\w./:#+-]+")
_NUMBER: Final = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d{1,4})?", re.ASCII)


def escape_control_characters(text: str) -> str:
    r"""Escape control characters, which a terminal would execute; tabs and newlines stay.

    >>> print(escape_control_characters("\x1b[2J"))
    \x1b[2J
    """
    return _CONTROL_CHARACTERS.sub(lambda match: match[0].encode("unicode_escape").decode(), text)


def docstring_summary(documented: object) -> str:
    """Return the first line of an object's docstring; an empty text if there is none."""
    return (inspect.getdoc(documented) or "").partition("\n")[0]


def shorten(text: str, max_length: int) -> str:
    """Truncate a text to `max_length` characters, with an ellipsis.

    >>> shorten("pedestrian", 5)
    'pede…'
    """
    return text if len(text) <= max_length else f"{text[: max_length - 1]}…"


def wrap_text(text: str, width: int, max_lines: int) -> str:
    """Wrap a text to at most `max_lines` lines of `width` characters; a longer text ends with an ellipsis.

    A text whose lines already fit is returned unchanged.

    >>> print(wrap_text("Ego yields to Pedestrian", 14, 3))
    Ego yields to
    Pedestrian
    """
    lines_of_text = text.split("\n")
    if len(lines_of_text) <= max_lines and max(map(len, lines_of_text)) <= width:
        return text
    return textwrap.fill(text, width, max_lines=max_lines, placeholder=" …")


def quote_name(name: str) -> str:
    """Put a name in quotes for use in a sentence, unless it is a single word.

    >>> print(quote_name("Ego"), "yields to", quote_name("C, closely"))
    Ego yields to "C, closely"
    """
    return name if _SINGLE_WORD.fullmatch(name) else json.dumps(name, ensure_ascii=False)


# Beginning of an absolute path, and the separators of folders.
_PATH_ROOT: Final = re.compile(r"(?<![\w./\\~])(?:/|[A-Za-z]:[/\\])(?=[^\s/\\])")
_SEPARATOR: Final = re.compile(r"[/\\]")


def remove_folders(text: str) -> str:
    """Remove the folders from absolute paths in a text because they are private; file names stay."""
    parts, position = [], 0
    while root := _PATH_ROOT.search(text, position):
        begin, end = root.start(), root.start()
        # Folder names may contain anything, so their end is found on the disk.
        for separator in _SEPARATOR.finditer(text, root.end()):
            if not _is_folder(text[begin : separator.end()]):
                break
            end = separator.end()
        parts.append(text[position:begin])
        position = end if end > begin else root.end()
        parts.append(text[end:position])
    return "".join(parts) + text[position:]


def _is_folder(path: str) -> bool:
    try:
        return Path(path).is_dir()
    except (OSError, ValueError):
        return False


def format_exception(error: BaseException) -> str:
    """Return the class and the message of an exception in one line, without a full stop.

    >>> format_exception(KeyError("ego"))
    "KeyError: 'ego'"
    """
    return " ".join(f"{type(error).__name__}: {error}".split()).rstrip(".: ")


def escape_csv_cell(text: str) -> str:
    """Put an apostrophe before a CSV cell if a spreadsheet would take the text for a formula.

    >>> escape_csv_cell("=1+1"), escape_csv_cell("-1"), escape_csv_cell("Ego")
    ("'=1+1", '-1', 'Ego')
    """
    return f"'{text}" if _FORMULA_START.match(text) and not _NUMBER.fullmatch(text) else text


def unescape_csv_cell(cell: str) -> str:
    """Undo `escape_csv_cell`.

    >>> unescape_csv_cell("'=1+1")
    '=1+1'
    """
    return cell[1:] if cell.startswith("'") and _FORMULA_START.match(cell) else cell


def format_json(value: object) -> str:
    """Return plain values as indented JSON without control characters; NaN and infinity become null.

    >>> print(format_json({"é": float("nan")}))
    {
      "é": null
    }
    """
    text = json.dumps(_replace_non_finite(value), indent=2, ensure_ascii=False, allow_nan=False)
    return _CONTROL_CHARACTERS.sub(lambda match: f"\\u{ord(match[0]):04x}", text)


def parse_json(text: str) -> Any:
    """Parse JSON. ValueError if it is invalid or contains lone surrogates, RecursionError if it is nested too deep."""
    plain = json.loads(text)
    # Encoding again takes as long as parsing, and studies contain many texts.
    if _POSSIBLE_SURROGATE.search(text):
        check_no_surrogates(json.dumps(plain, ensure_ascii=False))
    return plain


def check_no_surrogates(text: str) -> None:
    r"""Raise ValueError if a text contains a lone surrogate, which cannot be encoded in UTF-8.

    Lone surrogates come from JSON (``"\ud800"``) and from file names that are not in UTF-8.
    """
    if (match := _SURROGATE.search(text)) is not None:
        raise ValueError(
            f"'{escape_control_characters(shorten(text[max(match.start() - 20, 0) :], 40))}' holds half a character"
            " (a lone surrogate)"
        )


def _replace_non_finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(key): _replace_non_finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_replace_non_finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def check_comma_separated(path: Path, header: Sequence[str]) -> None:
    """Raise `InputError` if the header of a CSV file is separated by semicolons or tabs instead of commas.

    `header` is the first row, already split at commas.
    """
    if len(header) == 1:
        for separator, name in ((";", "semicolons"), ("\t", "tabs")):
            if separator in header[0]:
                raise InputError(f"{path}: separates its columns by {name}; use commas, and points in numbers.")
