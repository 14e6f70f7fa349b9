"""Requirements on scenarios."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from typing import Final, Literal

from cornercase._common.errors import InputError
from cornercase._common.text.sanitize import check_no_surrogates, parse_json
from cornercase._common.validation import check_str
from cornercase.metrics import Formula

RequirementKind = Literal[
    "no collision", "no collision with", "no collision at fault", "no collision unless", "reach", "drive", "formula"
]

DEFAULT_RADIUS: Final = 2.0
"""Default radius in m around a position that the ego has to reach."""

_NUMBER_PATTERN: Final = r"([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d{1,3})?)"
_PREFIX_PATTERN: Final = re.compile(r'\s*for\s+(kind\s+)?("(?:[^"\\]|\\.)*"|\S+?)\s*:\s+(.+)', re.DOTALL)
# A pattern that needs no quotes.
_UNQUOTED_PATTERN: Final = re.compile(r'[^\s"]+')
_REACH_PATTERN: Final = re.compile(
    rf"reach\s+{_NUMBER_PATTERN}\s*,\s*{_NUMBER_PATTERN}(?:\s*,\s*{_NUMBER_PATTERN})?\s+within\s+{_NUMBER_PATTERN}\s*(\S*)",
    re.DOTALL,
)
_DRIVE_PATTERN: Final = re.compile(rf"drive\s+{_NUMBER_PATTERN}\s*(\S*)", re.DOTALL)
_UNLESS_PATTERN: Final = re.compile(r"no collision unless (?:reference:)?(\S+) collides", re.IGNORECASE)
_FORMS_TEXT: Final = (
    "'no collision', 'no collision with NAME', 'no collision at fault', 'no collision unless NAME collides', 'reach"
    " X,Y[,R] within T', 'drive D', or a bound such as 'ttc > 1.5'"
)
_MAX_NUMBER: Final = 1e6


@dataclass(frozen=True)
class Requirement:
    """A requirement on a scenario; made from a text with `parse`.

    Attributes
    ----------
    text : str
        Its text in studies and messages.
    kind : str
        One of `Kind`.
    entity : str
        Entity that the ego must not touch; empty if the requirement names none.
    reference : str
        Reference driver that is put in the ego if it collides; empty if the requirement names none.
    position : tuple of three float, or None
        x and y of the position the ego has to reach, and the radius around it, in m.
    time_limit : float
        Time limit for it in s.
    distance : float
        Distance in m that the ego has to drive.
    formula : Formula or None
    pattern : str
        Pattern of the names of files that it applies to, with ``*`` and ``?``; empty for all.
    is_for_clusters : bool
        Whether the pattern is for names of clusters instead of files.
    """

    text: str
    kind: RequirementKind
    entity: str = ""
    position: tuple[float, float, float] | None = None
    time_limit: float = 0.0
    formula: Formula | None = None
    pattern: str = ""
    is_for_clusters: bool = False
    reference: str = ""
    distance: float = 0.0

    def __str__(self) -> str:
        return self.text

    @classmethod
    def parse(cls, requirement: str) -> Requirement:
        """Parse a requirement.

        Parameters
        ----------
        requirement : str
            ``"no collision"`` with any entity, ``"no collision with NAME"``, ``"no collision at fault"``, ``"no
            collision unless NAME collides"`` with the reference driver NAME in the ego, ``"reach X,Y[,R] within T"`` in
            m and s, ``"drive D"`` in m, or a formula as `cornercase.metrics.Formula` reads it, such as ``"ttc > 1.5"``.
            With the prefix ``"for PATTERN: "`` it applies to files of that name only, with ``'for kind "PATTERN": '``
            to scenarios of that cluster; ``*`` stands for any characters and ``?`` for one. A pattern with spaces is
            quoted as in JSON.

        Returns
        -------
        Requirement

        Raises
        ------
        InputError
            The text is not a requirement, a unit does not fit, or it names an unknown metric.

        Examples
        --------
        >>> from cornercase.suite import Requirement
        >>> Requirement.parse("for *-00012.xosc:  reach 60, -1.75 within 20 s").text
        'for *-00012.xosc: reach 60,-1.75,2 within 20'
        """
        normalized = " ".join(check_str("require", requirement).split())
        try:
            check_no_surrogates(normalized)
        except ValueError as error:
            raise InputError(f"`require` {normalized}: {error}.") from error
        prefix = _PREFIX_PATTERN.fullmatch(requirement)
        by_kind, pattern, body = (
            (bool(prefix[1]), _unquote_pattern(prefix[2], normalized), prefix[3]) if prefix else (False, "", normalized)
        )
        body = " ".join(body.split())
        if not prefix and normalized.startswith("for "):
            raise InputError(
                f"`require` {normalized}: has no pattern; write 'for PATTERN: REQUIREMENT', with a space after the"
                " colon."
            )
        parsed = (
            _parse_collision(body) or _parse_position(body) or _parse_distance(body) or _parse_formula(body, normalized)
        )
        full_text = f"{requirement_prefix(pattern, is_for_clusters=by_kind)}{parsed.text}" if pattern else parsed.text
        return replace(parsed, text=full_text, pattern=pattern, is_for_clusters=by_kind)

    def applies_to(self, file: str, kind: str = "") -> bool:
        """Tell whether it applies to a scenario.

        Parameters
        ----------
        file : str
            Name of its file.
        kind : str, default ""
            Name of its cluster; empty if unknown.

        Returns
        -------
        bool
        """
        # Escape brackets, which may occur in names of files and clusters.
        return not self.pattern or fnmatchcase(kind if self.is_for_clusters else file, self.pattern.replace("[", "[[]"))


def requirement_prefix(pattern: str, *, is_for_clusters: bool = False) -> str:
    """Prefix that limits a requirement to files, or clusters, whose name matches a pattern."""
    if is_for_clusters or not _UNQUOTED_PATTERN.fullmatch(pattern):
        return f"for {'kind ' if is_for_clusters else ''}{json.dumps(pattern, ensure_ascii=False)}: "
    return f"for {pattern}: "


def _unquote_pattern(pattern: str, requirement: str) -> str:
    if not pattern.startswith('"'):
        return pattern
    try:
        text_ = str(parse_json(pattern))
    except ValueError:
        text_ = ""
    if not text_.strip():
        raise InputError(f"`require` {requirement}: {pattern} is not a pattern of names; write it as in JSON.")
    return text_


def _parse_collision(body: str) -> Requirement | None:
    words = body.split(" ", 3)
    if words[0].lower() != "no":
        return None
    lowered = body.lower()
    if lowered == "no collision":
        return Requirement(lowered, "no collision")
    if lowered == "no collision at fault":
        return Requirement(lowered, "no collision at fault")
    if lowered.startswith("no collision with ") and len(words) == 4:
        return Requirement(f"no collision with {words[3]}", "no collision with", entity=words[3])
    if (match_ := _UNLESS_PATTERN.fullmatch(body)) is not None:
        return Requirement(f"no collision unless {match_[1]} collides", "no collision unless", reference=match_[1])
    raise InputError(f"`require` {body}: is not a requirement; write {_FORMS_TEXT}.")


def _parse_position(body: str) -> Requirement | None:
    if body.split(" ", 1)[0] != "reach":
        return None
    match_ = _REACH_PATTERN.fullmatch(body)
    if match_ is None:
        raise InputError(f"`require` {body}: is not a position and time; write 'reach X,Y[,R] within T', in m and s.")
    x, y, radius, within = (float(group) if group else DEFAULT_RADIUS for group in match_.groups()[:4])
    if match_[5] not in ("", "s"):
        raise InputError(f"`require` {body}: the unit '{match_[5]}' does not fit; give the time in s.")
    if not (0.0 < radius <= _MAX_NUMBER and 0.0 < within <= _MAX_NUMBER and max(abs(x), abs(y)) <= _MAX_NUMBER):
        raise InputError(f"`require` {body}: give a position within 1000 km, and a positive radius and time.")
    return Requirement(
        f"reach {x:.15g},{y:.15g},{radius:.15g} within {within:.15g}",
        "reach",
        position=(x, y, radius),
        time_limit=within,
    )


def _parse_distance(body: str) -> Requirement | None:
    if body.split(" ", 1)[0] != "drive":
        return None
    match_ = _DRIVE_PATTERN.fullmatch(body)
    if match_ is None or match_[2] not in ("", "m") or not 0.0 < float(match_[1]) <= _MAX_NUMBER:
        raise InputError(f"`require` {body}: is not a distance; write 'drive D', above 0 and at most 1000 km, in m.")
    return Requirement(f"drive {float(match_[1]):.15g}", "drive", distance=float(match_[1]))


def _parse_formula(body: str, requirement: str) -> Requirement:
    try:
        formula = Formula.parse(body)
    except InputError as error:
        reason = str(error)
        raise InputError(reason if body in reason else f"`require` {requirement}: {reason}") from error
    return Requirement(formula.text, "formula", formula=formula)
