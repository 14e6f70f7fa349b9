"""Layout of a test card on one A4 page: the table rows for which there is room, and the height of the drawings."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from cornercase._common.text.sanitize import shorten

_MAX_PARAMETERS: Final = 7
MAX_PARTIES: Final = 4
_MAX_TRIGGERS: Final = 6
# Rows that stay, however little room there is; the ego and the entity that it meets are the first parties.
_MIN_PARAMETERS: Final = 1
# Further parameters in a line of text, and characters of each.
_MAX_IN_LINE: Final = 12
_SETTING_LENGTH: Final = 30
_MIN_PARTIES: Final = 2
# Heights in mm: lowest and highest drawings, drawings if there is no room, everything that varies from card to card,
# and a line of text.
_DRAWING_HEIGHTS: Final = (30.0, 62.0)
_MIN_DRAWING_HEIGHT: Final = 20.0
_ROOM: Final = 206.0
_LINE_HEIGHT: Final = 3.7
_ROW_MARGIN: Final = 1.1
# Heights in mm of the two columns below the drawings, without their texts and rows.
_RESULTS_HEIGHT: Final = 9.0
_BY_HAND_HEIGHT: Final = 53.0
# Characters on a line: of a text over the whole page, of a bold text, of the note below the results, of a condition.
_LINE: Final = 115
_BOLD_LINE: Final = 98
_RESULTS_LINE: Final = 68
_ACCEPTANCE_LINE: Final = 36
# Characters on a line of each column of a table, as far as its texts differ much in length.
_PARAMETER_CHARACTERS: Final = (20, 26, 22)
_RESULT_CHARACTERS: Final = (20, 24, 24)
_PARTY_LINES: Final = 3
_TRIGGER_CHARACTERS: Final = (13, 66, 40)

Trigger = tuple[str, str, str]


@dataclass(frozen=True)
class CardTexts:
    """All texts and tables of a test card, before rows for which there is no room are left out.

    `lines` are texts as wide as the page. The first line says whether the rounded scenario ends as in the study, and is
    printed bold if `bold` is True. `parties` are the entities, the most important first. The note `below_results`
    stands below the results. `triggers` are events that move entities. `trigger_ranks` has, for each of these events,
    the rank of the most important entity that moves; a lower rank is more important.
    """

    lines: Sequence[str]
    bold: bool
    parameters: Sequence[Sequence[str]]
    parties: Sequence[Mapping[str, str]]
    triggers: Sequence[Trigger]
    trigger_ranks: Sequence[int]
    results: Sequence[Sequence[str]]
    below_results: str
    conditions: Sequence[str]


@dataclass(frozen=True)
class Layout:
    """What fits on a test card: how many parameters and parties (entities), which triggers, and the drawings' height.

    `drawing_height` is in mm.
    """

    n_parameters: int
    n_parties: int
    triggers: Sequence[Trigger]
    drawing_height: float


def format_settings_line(parameters: Sequence[Sequence[str]]) -> str:
    """Format names and rounded values of parameters in one line, for parameters that have no row in the table."""
    texts = [
        f"{shorten(name, _SETTING_LENGTH)} {shorten(value, _SETTING_LENGTH)}"
        for name, _, value, *_ in parameters[:_MAX_IN_LINE]
    ]
    if len(parameters) > _MAX_IN_LINE:
        texts.append(f"and {len(parameters) - _MAX_IN_LINE} more, for which there is no room")
    return ", ".join(texts)


def choose_layout(texts: CardTexts) -> Layout:
    """Choose the rows and the drawing height with which a test card fits on one page."""
    low, high = _DRAWING_HEIGHTS
    n_parameters, n_parties = min(_MAX_PARAMETERS, len(texts.parameters)), min(MAX_PARTIES, len(texts.parties))
    room = _find_height_left(texts, n_parameters, n_parties)
    while room < _MIN_DRAWING_HEIGHT and (n_parties > _MIN_PARTIES or n_parameters > _MIN_PARAMETERS):
        if n_parties > _MIN_PARTIES:
            n_parties -= 1
        else:
            n_parameters -= 1
        room = _find_height_left(texts, n_parameters, n_parties)
    shown: list[int] = []
    for k in sorted(range(len(texts.triggers)), key=lambda k: (texts.trigger_ranks[k], k))[:_MAX_TRIGGERS]:
        height = _row_height(texts.triggers[k], _TRIGGER_CHARACTERS)
        if room - height < low:
            break
        room -= height
        shown.append(k)
    triggers = [texts.triggers[k] for k in sorted(shown)]
    return Layout(n_parameters, n_parties, triggers, round(max(_MIN_DRAWING_HEIGHT, min(high, room)), 1))


def _find_height_left(texts: CardTexts, n_parameters: int, n_parties: int) -> float:
    """Return the height in mm that is left for triggers and drawings, given the numbers of other table rows."""
    line_lengths = [_BOLD_LINE if texts.bold else _LINE, *[_LINE] * (len(texts.lines) - 1)]
    n_lines = sum(_count_lines(text, length) for text, length in zip(texts.lines, line_lengths, strict=True))
    n_lines += _count_lines(format_settings_line(texts.parameters[n_parameters:]), _LINE - 12)
    # Notes that parties or triggers were left out.
    n_lines += (n_parties < len(texts.parties)) + 1
    height = _LINE_HEIGHT * n_lines
    height += sum(_row_height(row, _PARAMETER_CHARACTERS) for row in texts.parameters[:n_parameters])
    for party in texts.parties[:n_parties]:
        height += _ROW_MARGIN + (_PARTY_LINES + bool(party["time"])) * 3.45
    return _ROOM - height - _find_bottom_height(texts)


def _find_bottom_height(texts: CardTexts) -> float:
    """Return the height in mm of the two columns below the drawings."""
    left = _RESULTS_HEIGHT + sum(_row_height(row, _RESULT_CHARACTERS) for row in texts.results)
    left += _LINE_HEIGHT * _count_lines(texts.below_results, _RESULTS_LINE)
    right = _BY_HAND_HEIGHT + _LINE_HEIGHT * sum(_count_lines(text, _ACCEPTANCE_LINE) for text in texts.conditions)
    return max(left, right)


def _row_height(row: Sequence[str], characters: Sequence[int]) -> float:
    n_lines = max(_count_lines(text, length) for text, length in zip(row, characters, strict=False))
    return _ROW_MARGIN + _LINE_HEIGHT * n_lines


def _count_lines(text: str, length: int) -> int:
    return math.ceil(len(text) / length)
