"""Lexer of expressions, and the error that marks a place in one."""

from __future__ import annotations

import re
import unicodedata
from dataclasses import dataclass
from typing import Final, Literal, NoReturn, cast

from cornercase._common.errors import ExpressionError, suggest_name
from cornercase._common.text.sanitize import escape_control_characters

KEYWORDS: Final = ("not", "and", "or", "always", "eventually", "until", "abs", "score", "no", "collision", "within")
MAX_LENGTH: Final = 10_000

# Operators of other languages, and what to write instead.
_FOREIGN_OPERATORS: Final = {
    "&&": "and", "&": "and", "||": "or", "|": "or", "!": "not", "=>": "->", "==": "<= or >=", "=": "<= or >=",
    "!=": "< or >", "≤": "<=", "≥": ">=", "□": "always", "◇": "eventually", "→": "->", "−": "-", "–": "-",
}  # fmt: skip
_OPTION_PATTERN: Final = r"[A-Za-z_]\w*=[^\s()\[\]<>,]+"
_TOKEN_PATTERN: Final = re.compile(
    rf"""(?P<number>[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?)
    |(?P<sign>->|<=|>=|<(?!=)|>(?!=)|[()\[\]:,])
    |(?P<name>[A-Za-z_]\w*(?:[-.][A-Za-z_]\w*)*(?::{_OPTION_PATTERN}(?:,{_OPTION_PATTERN})*)?)
    |(?P<unit>[°%][\w/^²]*)
    |(?P<foreign>&&|\|\||==|!=|=>|[&|!=≤≥□◇→−–])""",
    re.VERBOSE,
)
_UNIT_PATTERN: Final = re.compile(r"[A-Za-z°%][\w/^²°]*")
# Characters shown before and after the marked place.
_SHOWN_BEFORE, _SHOWN_AFTER = 50, 30

TokenKind = Literal["number", "sign", "name", "unit", "end"]


@dataclass(frozen=True)
class Token:
    """A token and its position in the text: `begin` and `end` as in a slice."""

    kind: TokenKind
    text: str
    begin: int
    end: int


class Lexer:
    """Reads an expression token by token; `language` names it in messages."""

    def __init__(self, text: str, language: str) -> None:
        self.text, self._language = text, language
        if len(text) > MAX_LENGTH:
            end = Token("end", "", MAX_LENGTH, MAX_LENGTH)
            self.raise_error(f"it has {len(text)} characters; give {MAX_LENGTH} at most.", end)
        self.next_token = self._scan(0)

    @property
    def is_at_end(self) -> bool:
        """Whether all tokens are read."""
        return self.next_token.kind == "end"

    def read_token(self) -> Token:
        """Read the next token."""
        token = self.next_token
        self.next_token = self._scan(token.end)
        return token

    def read_unit(self) -> Token | None:
        """Read the unit behind a number; None if there is none."""
        # Matched before the token is read as a name, which cannot contain a slash.
        match = _UNIT_PATTERN.match(self.text, self.next_token.begin)
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

    def read_word(self, word: str) -> bool:
        """Read the next token if it is a word in any case; return whether it was."""
        return self.next_token.text.lower() == word and self.read_if(self.next_token.text)

    def read_pattern(self, pattern: re.Pattern[str], expected: str) -> re.Match[str]:
        """Read what matches a pattern, whatever tokens it has."""
        match = pattern.match(self.text, self.next_token.begin)
        if match is None:
            self.raise_expected(expected)
        self.next_token = self._scan(match.end())
        return match

    def raise_error(self, message: str, token: Token | None = None) -> NoReturn:
        """Raise at a token, by default the next one; `message` says what is wrong and what to do."""
        raise ExpressionError(
            f"The {self._language} cannot be read: {message}",
            _mark_place(self.text, (token or self.next_token).begin),
        )

    def raise_expected(self, what: str) -> NoReturn:
        """Raise at the next token, saying what to give instead."""
        self.raise_error(f"give {what}.")

    def _scan(self, start: int) -> Token:
        begin = start + len(self.text[start:]) - len(self.text[start:].lstrip())
        end = Token("end", "", begin, begin)
        if begin == len(self.text):
            return end
        match = _TOKEN_PATTERN.match(self.text, begin)
        kind = match.lastgroup if match else None
        if match is None or kind is None:
            self.raise_error(f"{_describe_character(self.text[begin])} has no meaning here.", end)
        if kind == "foreign":
            self.raise_error(f"write {_FOREIGN_OPERATORS[match.group()]} for {match.group()}.", end)
        # The groups of the pattern have the names of the kinds.
        return Token(cast(TokenKind, kind), match.group(), begin, match.end())


def suggest_operator(name: str) -> str:
    """Suggest the operator that a misspelt word could mean, in a sentence; empty if none is similar."""
    sentence = suggest_name(name.lower(), KEYWORDS)
    return sentence if sentence.startswith("did") else ""


def _mark_place(text: str, begin: int) -> str:
    """The text around a place, in one line, and below it a caret at the place."""
    from rich.cells import cell_len

    first, last = max(0, begin - _SHOWN_BEFORE), begin + _SHOWN_AFTER
    before, after = (
        escape_control_characters(re.sub(r"\s", " ", part)) for part in (text[first:begin], text[begin:last])
    )
    before = f"{'…' if first else ''}{before}"
    return f"    {before}{after}{'…' if last < len(text) else ''}\n    {' ' * cell_len(before)}^"


def _describe_character(character: str) -> str:
    shown = escape_control_characters(character)
    if character.isascii():
        return f"'{shown}'"
    return f"'{shown}' ({unicodedata.name(character, f'U+{ord(character):04X}')})"
