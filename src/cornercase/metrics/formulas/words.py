"""Lexer of formulas and conditions."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Final, Literal, NoReturn, cast

from cornercase._common.errors import InputError, suggestion

KEYWORDS: Final = ("not", "and", "or", "always", "eventually", "until", "abs")

# Operators of other languages, and what to write instead.
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
"""Kind of a token."""


@dataclass(frozen=True)
class Word:
    """A token and its position in the text: `begin` and `end` as in a slice."""

    kind: Kind
    text: str
    begin: int
    end: int


class Words:
    """Reads a formula token by token; `language` names it in messages."""

    def __init__(self, text: str, what: str = "formula") -> None:
        self._text, self._what = text, what
        self.next = self._read(0)

    @property
    def ended(self) -> bool:
        """Whether all tokens are read."""
        return self.next.kind == "end"

    def take(self) -> Word:
        """Read the next token."""
        word = self.next
        self.next = self._read(word.end)
        return word

    def take_unit(self) -> Word | None:
        """Read the unit behind a number; None if there is none."""
        # Matched before the token is read as a name, which cannot contain a slash.
        match = _UNIT.match(self._text, self.next.begin)
        if match is None or match.group() in KEYWORDS:
            return None
        self.next = self._read(match.end())
        return Word("unit", match.group(), match.start(), match.end())

    def take_if(self, *texts: str) -> bool:
        """Read the next token if it is one of `texts`; return whether it was."""
        if self.next.kind not in ("name", "sign") or self.next.text not in texts:
            return False
        self.take()
        return True

    def refuse(self, sentence: str, word: Word | None = None) -> NoReturn:
        """Raise InputError at a token, by default the next one; `message` says what is wrong and what to do."""
        rest = self._text[(word or self.next).begin :]
        line = rest.partition("\n")[0]
        position = f"at '{_shorten(line, 20)}'" if rest else "at its end"
        raise InputError(f"The {self._what} '{_shorten(self._text, 120)}', {position}: {sentence}")

    def expected(self, what: str) -> NoReturn:
        """Raise InputError at the next token, saying what to give instead."""
        self.refuse(f"give {what}.")

    def _read(self, place: int) -> Word:
        begin = place + len(self._text[place:]) - len(self._text[place:].lstrip())
        if begin == len(self._text):
            return Word("end", "", begin, begin)
        match = _WORDS.match(self._text, begin)
        kind = match.lastgroup if match else None
        if match is None or kind is None:
            self.refuse(f"'{self._text[begin]}' is no part of a {self._what}.", Word("end", "", begin, begin))
        if kind == "foreign":
            self.refuse(f"write {_FOREIGN[match.group()]} for {match.group()}.", Word("end", "", begin, begin))
        # The groups of the expression have the names of the kinds.
        return Word(cast(Kind, kind), match.group(), begin, match.end())


def operator_meant(name: str) -> str:
    """Suggest the operator that a misspelt word could mean, in a sentence; empty if none is similar."""
    sentence = suggestion(name.lower(), KEYWORDS)
    return sentence if sentence.startswith("did") else ""


def _shorten(text: str, length: int) -> str:
    return text if len(text) <= length else text[:length] + "…"
