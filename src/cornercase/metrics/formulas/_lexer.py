"""Lexer of formulas and conditions."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Final, Literal, NoReturn, cast

from cornercase._common.errors import InputError, suggest_name

KEYWORDS: Final = ("not", "and", "or", "always", "eventually", "until", "abs")

# Operators of other languages, and what to write instead.
_FOREIGN_OPERATORS: Final = {
    "&&": "and", "&": "and", "||": "or", "|": "or", "!": "not", "=>": "->", "==": "<= or >=", "=": "<= or >=",
    "!=": "< or >", "≤": "<=", "≥": ">=", "□": "always", "◇": "eventually", "→": "->",
}  # fmt: skip
_OPTION_PATTERN: Final = r"[A-Za-z_]\w*=[^\s()\[\]<>,]+"
_TOKEN_PATTERN: Final = re.compile(
    rf"""(?P<number>[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)
    |(?P<sign>->|<=|>=|<(?!=)|>(?!=)|[()\[\]:,])
    |(?P<name>[A-Za-z_]\w*(?:[-.][A-Za-z_]\w*)*(?::{_OPTION_PATTERN}(?:,{_OPTION_PATTERN})*)?)
    |(?P<unit>[°%][\w/^²]*)
    |(?P<foreign>&&|\|\||==|!=|=>|[&|!=≤≥□◇→])""",
    re.VERBOSE,
)
_UNIT_PATTERN: Final = re.compile(r"[A-Za-z°%][\w/^²°]*")


TokenKind = Literal["number", "sign", "name", "unit", "end"]
"""Kind of a token."""


@dataclass(frozen=True)
class Token:
    """A token and its position in the text: `begin` and `end` as in a slice."""

    kind: TokenKind
    text: str
    begin: int
    end: int


class Lexer:
    """Reads a formula token by token; `language` names it in messages."""

    def __init__(self, text: str, language: str = "formula") -> None:
        self._text, self._language = text, language
        self.next_token = self._scan(0)

    @property
    def is_at_end(self) -> bool:
        """Whether all tokens are read."""
        return self.next_token.kind == "end"

    def read_token(self) -> Token:
        """Read the next token."""
        word = self.next_token
        self.next_token = self._scan(word.end)
        return word

    def read_unit(self) -> Token | None:
        """Read the unit behind a number; None if there is none."""
        # Matched before the token is read as a name, which cannot contain a slash.
        match = _UNIT_PATTERN.match(self._text, self.next_token.begin)
        if match is None or match.group() in KEYWORDS:
            return None
        self.next_token = self._scan(match.end())
        return Token("unit", match.group(), match.start(), match.end())

    def read_if(self, *texts: str) -> bool:
        """Read the next token if it is one of `texts`; return whether it was."""
        if self.next_token.kind not in ("name", "sign") or self.next_token.text not in texts:
            return False
        self.read_token()
        return True

    def raise_error(self, message: str, token: Token | None = None) -> NoReturn:
        """Raise InputError at a token, by default the next one; `message` says what is wrong and what to do."""
        rest = self._text[(token or self.next_token).begin :]
        line = rest.partition("\n")[0]
        position = f"at '{_shorten_formula(line, 20)}'" if rest else "at its end"
        raise InputError(f"The {self._language} '{_shorten_formula(self._text, 120)}', {position}: {message}")

    def raise_expected(self, what: str) -> NoReturn:
        """Raise InputError at the next token, saying what to give instead."""
        self.raise_error(f"give {what}.")

    def _scan(self, start: int) -> Token:
        begin = start + len(self._text[start:]) - len(self._text[start:].lstrip())
        if begin == len(self._text):
            return Token("end", "", begin, begin)
        match = _TOKEN_PATTERN.match(self._text, begin)
        kind = match.lastgroup if match else None
        if match is None or kind is None:
            self.raise_error(f"'{self._text[begin]}' is no part of a {self._language}.", Token("end", "", begin, begin))
        if kind == "foreign":
            self.raise_error(
                f"write {_FOREIGN_OPERATORS[match.group()]} for {match.group()}.", Token("end", "", begin, begin)
            )
        # The groups of the expression have the names of the kinds.
        return Token(cast(TokenKind, kind), match.group(), begin, match.end())


def suggest_operator(name: str) -> str:
    """Suggest the operator that a misspelt word could mean, in a sentence; empty if none is similar."""
    sentence = suggest_name(name.lower(), KEYWORDS)
    return sentence if sentence.startswith("did") else ""


def _shorten_formula(text: str, length: int) -> str:
    return text if len(text) <= length else text[:length] + "…"
