"""The words of a formula, with the place of each."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Final, Literal, NoReturn, cast

from cornercase._common.errors import InputError, suggestion

KEYWORDS: Final = ("not", "and", "or", "always", "eventually", "until", "abs")

# What people write who know the operators of other languages.
_FOREIGN: Final = {
    "&&": "and", "&": "and", "||": "or", "|": "or", "!": "not", "=>": "->", "==": "<= or >=", "=": "<= or >=",
    "!=": "< or >", "≤": "<=", "≥": ">=", "□": "always", "◇": "eventually", "→": "->",
}  # fmt: skip
_OPTION: Final = r"[A-Za-z_]\w*=[^\s()\[\]<>,]+"
_WORDS: Final = re.compile(
    rf"""(?P<number>[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)
    |(?P<sign>->|<=|>=|<(?!=)|>(?!=)|[()\[\]:,])
    |(?P<name>[A-Za-z_]\w*(?:[-.][A-Za-z_]\w*)*(?::{_OPTION}(?:,{_OPTION})*)?)
    |(?P<unit>[°%][\w/^²]*)
    |(?P<foreign>&&|\|\||==|!=|=>|[&|!=≤≥□◇→])""",
    re.VERBOSE,
)
_UNIT: Final = re.compile(r"[A-Za-z°%][\w/^²°]*")


Kind = Literal["number", "sign", "name", "unit", "end"]
"""Kind of a word."""


@dataclass(frozen=True)
class Word:
    """A word and its place.

    Attributes
    ----------
    kind : {"number", "sign", "name", "unit", "end"}
    text : str
    begin, end : int
        Where it begins and where what follows it does, from 0.
    """

    kind: Kind
    text: str
    begin: int
    end: int


class Words:
    """Reads a formula word by word.

    Parameters
    ----------
    text : str
    what : str, default "formula"
        What it is, for messages.
    """

    def __init__(self, text: str, what: str = "formula") -> None:
        self._text, self._what = text, what
        self.next = self._read(0)

    @property
    def ended(self) -> bool:
        """Whether nothing is left."""
        return self.next.kind == "end"

    def take(self) -> Word:
        """Take the next word.

        Returns
        -------
        Word
        """
        taken = self.next
        self.next = self._read(taken.end)
        return taken

    def take_unit(self) -> Word | None:
        """Take the unit behind a number.

        Returns
        -------
        Word or None
            None where something else follows.
        """
        # It is looked for before it is read as a name, which has no slash.
        found = _UNIT.match(self._text, self.next.begin)
        if found is None or found.group() in KEYWORDS:
            return None
        self.next = self._read(found.end())
        return Word("unit", found.group(), found.start(), found.end())

    def take_if(self, *texts: str) -> bool:
        """Take the next word if it is one of these.

        Parameters
        ----------
        *texts : str

        Returns
        -------
        bool
            Whether it was.
        """
        if self.next.kind not in ("name", "sign") or self.next.text not in texts:
            return False
        self.take()
        return True

    def refuse(self, sentence: str, word: Word | None = None) -> NoReturn:
        """Refuse the formula at a word.

        Parameters
        ----------
        sentence : str
            What is wrong and what helps, with its full stop or question mark.
        word : Word, optional
            By default the next one.

        Raises
        ------
        InputError
            Always.
        """
        place = (word or self.next).begin
        where = "at its end" if place >= len(self._text) else f"at '{_excerpt(self._text, place)}'"
        raise InputError(f"The {self._what} '{_shown(self._text)}', {where}: {sentence}")

    def expected(self, what: str) -> NoReturn:
        """Refuse the next word, since something else has to stand there.

        Parameters
        ----------
        what : str

        Raises
        ------
        InputError
            Always.
        """
        self.refuse(f"give {what}.")

    def _read(self, place: int) -> Word:
        begin = place + len(self._text[place:]) - len(self._text[place:].lstrip())
        if begin == len(self._text):
            return Word("end", "", begin, begin)
        found = _WORDS.match(self._text, begin)
        kind = found.lastgroup if found else None
        if found is None or kind is None:
            self.refuse(f"'{self._text[begin]}' is no part of a {self._what}.", Word("end", "", begin, begin))
        if kind == "foreign":
            self.refuse(f"write {_FOREIGN[found.group()]} for {found.group()}.", Word("end", "", begin, begin))
        # The groups are called as the kinds are.
        return Word(cast(Kind, kind), found.group(), begin, found.end())


def operator_meant(name: str) -> str:
    """Say which operator could be meant by a word.

    Parameters
    ----------
    name : str

    Returns
    -------
    str
        A sentence; empty where none is near.
    """
    found = suggestion(name.lower(), KEYWORDS)
    return found if found.startswith("did") else ""


def _excerpt(text: str, place: int) -> str:
    rest = text[place:].split("\n")[0]
    return rest if len(rest) <= 20 else rest[:20] + "…"


def _shown(text: str) -> str:
    return text if len(text) <= 120 else text[:120] + "…"
