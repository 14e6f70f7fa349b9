"""Texts of unknown origin, made harmless for where they are shown."""

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

# Control characters but for tab and newline, marks that turn the direction of writing, and halves of characters.
_ORDERS: Final = re.compile(
    "[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ufeff\ud800-\udfff]"
)
_HALF: Final = re.compile("[\ud800-\udfff]")
# What can become one as JSON is read.
_MAY_BE_HALF: Final = re.compile(r"\\u[dD][89a-fA-F]|[\ud800-\udfff]")
# What a spreadsheet takes for a formula, and what was escaped already.
_FORMULA: Final = re.compile("'*[=+\\-@\t\r\n\uff1d\uff0b\uff0d\uff20]")
# A name of such characters alone cannot be taken for the words around it.
_ONE_WORD: Final = re.compile(r"[\w./:#+-]+")
_NUMBER: Final = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d{1,4})?", re.ASCII)


def plain_text(text: str) -> str:
    r"""Return a text without what a terminal takes for orders.

    Parameters
    ----------
    text : str

    Returns
    -------
    str
        With control characters written out; tabs and newlines stay.

    Examples
    --------
    >>> print(plain_text("\x1b[2J"))
    \x1b[2J
    """
    return _ORDERS.sub(lambda found: found[0].encode("unicode_escape").decode(), text)


def first_line(what: object) -> str:
    """Return the first line of what is said of something in its docstring.

    Parameters
    ----------
    what : object

    Returns
    -------
    str
        Empty where nothing is said.
    """
    return (inspect.getdoc(what) or "").partition("\n")[0]


def shorten(text: str, longest: int) -> str:
    """Cut a text that is too long for its place.

    Parameters
    ----------
    text : str
    longest : int
        Characters.

    Returns
    -------
    str
        With an ellipsis where it was cut.

    Examples
    --------
    >>> shorten("pedestrian", 5)
    'pede…'
    """
    return text if len(text) <= longest else f"{text[: longest - 1]}…"


def wrapped(text: str, width: int, lines: int) -> str:
    """Break a text that is too wide for its place into lines.

    Parameters
    ----------
    text : str
        Lines in it that are not too wide stay.
    width : int
        Characters of a line.
    lines : int
        What is longer is cut.

    Returns
    -------
    str
        With an ellipsis where it was cut.

    Examples
    --------
    >>> print(wrapped("Ego yields to Pedestrian", 14, 3))
    Ego yields to
    Pedestrian
    """
    found = text.split("\n")
    if len(found) <= lines and max(map(len, found)) <= width:
        return text
    return textwrap.fill(text, width, max_lines=lines, placeholder=" …")


def quoted_name(name: str) -> str:
    """Return a name as it stands in a sentence.

    Parameters
    ----------
    name : str

    Returns
    -------
    str
        Between quotation marks unless it is one word.

    Examples
    --------
    >>> print(quoted_name("Ego"), "yields to", quoted_name("C, closely"))
    Ego yields to "C, closely"
    """
    return name if _ONE_WORD.fullmatch(name) else json.dumps(name, ensure_ascii=False)


# Where an absolute path may begin, and what ends the name of a folder.
_ROOT: Final = re.compile(r"(?<![\w./\\~])(?:/|[A-Za-z]:[/\\])(?=[^\s/\\])")
_SEPARATOR: Final = re.compile(r"[/\\]")


def without_folders(text: str) -> str:
    """Leave out the folders of files that a text names by absolute paths: where they lie is nobody else's concern.

    Parameters
    ----------
    text : str

    Returns
    -------
    str
        The names of the files stay.
    """
    parts, at = [], 0
    while root := _ROOT.search(text, at):
        begin, end = root.start(), root.start()
        # A folder's name may hold anything; where it ends is known as it is there.
        for separator in _SEPARATOR.finditer(text, root.end()):
            if not _is_folder(text[begin : separator.end()]):
                break
            end = separator.end()
        parts.append(text[at:begin])
        at = end if end > begin else root.end()
        parts.append(text[end:at])
    return "".join(parts) + text[at:]


def _is_folder(path: str) -> bool:
    try:
        return Path(path).is_dir()
    except (OSError, ValueError):
        return False


def in_one_line(error: BaseException) -> str:
    """Say in a line what went wrong in code of another package.

    Parameters
    ----------
    error : BaseException

    Returns
    -------
    str
        Its class and its message, without a full stop.

    Examples
    --------
    >>> in_one_line(KeyError("ego"))
    "KeyError: 'ego'"
    """
    return " ".join(f"{type(error).__name__}: {error}".split()).rstrip(".: ")


def cell_text(text: str) -> str:
    """Return a text as the cell of a CSV table, such that no spreadsheet takes it for a formula.

    Parameters
    ----------
    text : str

    Returns
    -------
    str
        With an apostrophe before it where it begins like a formula and is no number.

    See Also
    --------
    text_of_cell : The way back.

    Examples
    --------
    >>> cell_text("=1+1"), cell_text("-1"), cell_text("Ego")
    ("'=1+1", '-1', 'Ego')
    """
    return f"'{text}" if _FORMULA.match(text) and not _NUMBER.fullmatch(text) else text


def text_of_cell(cell: str) -> str:
    """Return the text that `cell_text` made a cell of.

    Parameters
    ----------
    cell : str

    Returns
    -------
    str

    Examples
    --------
    >>> text_of_cell("'=1+1")
    '=1+1'
    """
    return cell[1:] if cell.startswith("'") and _FORMULA.match(cell) else cell


def json_text(value: object) -> str:
    r"""Return a value as JSON that every program reads and that gives a terminal no orders.

    Parameters
    ----------
    value : object
        Dictionaries, lists, texts, numbers. What is not finite, which JSON cannot say, becomes null.

    Returns
    -------
    str
        Indented; letters of all alphabets stay.

    Examples
    --------
    >>> print(json_text({"é": float("nan")}))
    {
      "é": null
    }
    """
    text = json.dumps(_finite(value), indent=2, ensure_ascii=False, allow_nan=False)
    return _ORDERS.sub(lambda found: f"\\u{ord(found[0]):04x}", text)


def loaded_json(text: str) -> Any:
    """Read JSON, whose texts can all be written and shown.

    Parameters
    ----------
    text : str

    Returns
    -------
    object
        Plain values.

    Raises
    ------
    ValueError
        It is none, or a text in it holds half a character, which JSON can say but no file can hold.
    RecursionError
        It is nested too deep.
    """
    plain = json.loads(text)
    # To write it again takes as long as to read it, and studies have many.
    if _MAY_BE_HALF.search(text):
        require_whole(json.dumps(plain, ensure_ascii=False))
    return plain


def require_whole(text: str) -> None:
    r"""Refuse a text that no file can hold.

    Parameters
    ----------
    text : str

    Raises
    ------
    ValueError
        It holds half a character: of JSON (``"\ud800"``), or of a name of a file that is not in UTF-8.
    """
    if (found := _HALF.search(text)) is not None:
        raise ValueError(f"'{plain_text(shorten(text[max(found.start() - 20, 0) :], 40))}' holds half a character")


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(key): _finite(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(one) for one in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def require_commas(path: Path, names: Sequence[str]) -> None:
    """Refuse a table whose columns are separated otherwise, as spreadsheets of some languages do.

    Parameters
    ----------
    path : Path
        For the message.
    names : sequence of str
        The header, as read with commas.

    Raises
    ------
    InputError
        It is a single name that holds other separators.
    """
    if len(names) == 1:
        for sign, words in ((";", "semicolons"), ("\t", "tabs")):
            if sign in names[0]:
                raise InputError(f"{path}: separates its columns by {words}; write commas, and points in numbers.")
