"""What a scenario has to fulfil."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from typing import Final, Literal

from cornercase._common.arguments import text
from cornercase._common.errors import InputError
from cornercase._common.texts import loaded_json, require_whole
from cornercase.metrics import Formula

Kind = Literal[
    "no collision", "no collision with", "no collision at fault", "no collision unless", "reach", "drive", "formula"
]

REACHED: Final = 2.0
"""How near in m the ego has to come to a place, unless the requirement says it."""

_NUMBER: Final = r"([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d{1,3})?)"
_FOR: Final = re.compile(r'\s*for\s+(kind\s+)?("(?:[^"\\]|\\.)*"|\S+?)\s*:\s+(.+)', re.DOTALL)
# A pattern that needs no quotation marks.
_PLAIN: Final = re.compile(r'[^\s"]+')
_REACH: Final = re.compile(
    rf"reach\s+{_NUMBER}\s*,\s*{_NUMBER}(?:\s*,\s*{_NUMBER})?\s+within\s+{_NUMBER}\s*(\S*)", re.DOTALL
)
_DRIVE: Final = re.compile(rf"drive\s+{_NUMBER}\s*(\S*)", re.DOTALL)
_UNLESS: Final = re.compile(r"no collision unless (?:reference:)?(\S+) collides", re.IGNORECASE)
_FORMS: Final = (
    "'no collision', 'no collision with NAME', 'no collision at fault', 'no collision unless NAME collides', 'reach"
    " X,Y[,R] within T', 'drive D', or a bound such as 'ttc > 1.5'"
)
_LARGEST: Final = 1e6


@dataclass(frozen=True)
class Requirement:
    """What a scenario has to fulfil; made of a text with `parse`.

    Attributes
    ----------
    text : str
        As it stands in studies and messages.
    kind : str
        As in `Kind`.
    entity : str
        Whom the ego must not touch; empty where the requirement names nobody.
    reference : str
        Driver that is put at the wheel of the ego where that collides; empty where the requirement names none.
    place : tuple of three float, or None
        x and y in m of where the ego has to come, and how near in m.
    within : float
        s that the ego has for it.
    distance : float
        m that the ego has to drive.
    formula : Formula or None
    pattern : str
        Which files it is for, with ``*`` and ``?``; empty for all.
    by_kind : bool
        Whether the pattern is one of the names of kinds, in place of those of files.
    """

    text: str
    kind: Kind
    entity: str = ""
    place: tuple[float, float, float] | None = None
    within: float = 0.0
    formula: Formula | None = None
    pattern: str = ""
    by_kind: bool = False
    reference: str = ""
    distance: float = 0.0

    def __str__(self) -> str:
        return self.text

    @classmethod
    def parse(cls, requirement: str) -> Requirement:
        """Read a requirement.

        Parameters
        ----------
        requirement : str
            ``"no collision"`` with anybody, ``"no collision with NAME"``, ``"no collision at fault"``, ``"no
            collision unless NAME collides"`` with the driver NAME at the wheel of the ego, ``"reach X,Y[,R] within T"``
            in m and s, ``"drive D"`` in m, or a formula as `cornercase.metrics.Formula` reads it, such as ``"ttc >
            1.5"``. After ``"for PATTERN: "`` it is one of the files of that name only, after ``'for kind "PATTERN": '``
            one of the scenarios of that kind; ``*`` stands for any characters and ``?`` for one. A pattern with spaces
            stands between quotation marks, as JSON has them.

        Returns
        -------
        Requirement

        Raises
        ------
        InputError
            It is none, a unit does not fit, or it names a metric that there is not.

        Examples
        --------
        >>> from cornercase.suite import Requirement
        >>> Requirement.parse("for *-00012.xosc:  reach 60, -1.75 within 20 s").text
        'for *-00012.xosc: reach 60,-1.75,2 within 20'
        """
        given = " ".join(text("require", requirement).split())
        try:
            require_whole(given)
        except ValueError as error:
            raise InputError(f"`require` {given}: {error}, which no file can hold.") from error
        found = _FOR.fullmatch(requirement)
        by_kind, pattern, body = (bool(found[1]), _unquoted(found[2], given), found[3]) if found else (False, "", given)
        body = " ".join(body.split())
        if not found and given.startswith("for "):
            raise InputError(
                f"`require` {given}: names no pattern; write 'for PATTERN: REQUIREMENT', with a space after the colon."
            )
        one = _collision(body) or _place(body) or _distance(body) or _formula(body, given)
        shown = f"{prefix_for(pattern, by_kind=by_kind)}{one.text}" if pattern else one.text
        return replace(one, text=shown, pattern=pattern, by_kind=by_kind)

    def concerns(self, file: str, kind: str = "") -> bool:
        """Tell whether it is one of a scenario.

        Parameters
        ----------
        file : str
            Name of its file.
        kind : str, default ""
            What kind it is of, in words; empty where it is not known.

        Returns
        -------
        bool
        """
        # Brackets mean nothing here, as names of files and kinds may have some.
        return not self.pattern or fnmatchcase(kind if self.by_kind else file, self.pattern.replace("[", "[[]"))


def prefix_for(pattern: str, *, by_kind: bool = False) -> str:
    """Write what makes a requirement one of some scenarios only.

    Parameters
    ----------
    pattern : str
        Of names, with ``*`` and ``?``.
    by_kind : bool, default False
        Whether these are of kinds, in place of files.

    Returns
    -------
    str
        What stands before the requirement.
    """
    if by_kind or not _PLAIN.fullmatch(pattern):
        return f"for {'kind ' if by_kind else ''}{json.dumps(pattern, ensure_ascii=False)}: "
    return f"for {pattern}: "


def _unquoted(pattern: str, given: str) -> str:
    if not pattern.startswith('"'):
        return pattern
    try:
        found = str(loaded_json(pattern))
    except ValueError:
        found = ""
    if not found.strip():
        raise InputError(f"`require` {given}: {pattern} is not a pattern of names; write it as in JSON.")
    return found


def _collision(body: str) -> Requirement | None:
    words = body.split(" ", 3)
    if words[0].lower() != "no":
        return None
    plain = body.lower()
    if plain == "no collision":
        return Requirement(plain, "no collision")
    if plain == "no collision at fault":
        return Requirement(plain, "no collision at fault")
    if plain.startswith("no collision with ") and len(words) == 4:
        return Requirement(f"no collision with {words[3]}", "no collision with", entity=words[3])
    if (found := _UNLESS.fullmatch(body)) is not None:
        return Requirement(f"no collision unless {found[1]} collides", "no collision unless", reference=found[1])
    raise InputError(f"`require` {body}: is not a requirement; write {_FORMS}.")


def _place(body: str) -> Requirement | None:
    if body.split(" ", 1)[0] != "reach":
        return None
    found = _REACH.fullmatch(body)
    if found is None:
        raise InputError(f"`require` {body}: is not a place and time; write 'reach X,Y[,R] within T', in m and s.")
    x, y, radius, within = (float(one) if one else REACHED for one in found.groups()[:4])
    if found[5] not in ("", "s"):
        raise InputError(f"`require` {body}: the unit '{found[5]}' does not fit; give the time in s.")
    if not (0.0 < radius <= _LARGEST and 0.0 < within <= _LARGEST and max(abs(x), abs(y)) <= _LARGEST):
        raise InputError(f"`require` {body}: give a place within 1000 km, and a radius and a time above 0.")
    return Requirement(
        f"reach {x:.15g},{y:.15g},{radius:.15g} within {within:.15g}", "reach", place=(x, y, radius), within=within
    )


def _distance(body: str) -> Requirement | None:
    if body.split(" ", 1)[0] != "drive":
        return None
    found = _DRIVE.fullmatch(body)
    if found is None or found[2] not in ("", "m") or not 0.0 < float(found[1]) <= _LARGEST:
        raise InputError(f"`require` {body}: is not a distance; write 'drive D', above 0 and at most 1000 km, in m.")
    return Requirement(f"drive {float(found[1]):.15g}", "drive", distance=float(found[1]))


def _formula(body: str, given: str) -> Requirement:
    try:
        formula = Formula.parse(body)
    except InputError as error:
        why = str(error)
        raise InputError(why if body in why else f"`require` {given}: {why}") from error
    return Requirement(formula.text, "formula", formula=formula)
