"""Requirements on scenarios."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from fnmatch import fnmatchcase
from typing import Final

from cornercase._common.errors import InputError
from cornercase._common.text.sanitize import check_no_surrogates, parse_json
from cornercase._common.validation import check_str
from cornercase.metrics import Expression

_PREFIX_PATTERN: Final = re.compile(r'\s*for\s+(kind\s+)?("(?:[^"\\]|\\.)*"|\S+?)\s*:\s+(.+)', re.DOTALL)
# A pattern that needs no quotes.
_UNQUOTED_PATTERN: Final = re.compile(r'[^\s"]+')


@dataclass(frozen=True)
class Requirement:
    """A requirement on a scenario; made from a text with `parse`.

    Attributes
    ----------
    text : str
        Text of the requirement, as in studies and messages.
    expression : Expression
        Condition that has to hold.
    pattern : str
        Pattern of the file names that the requirement applies to, with ``*`` and ``?``; empty for all files.
    is_for_clusters : bool
        Whether the pattern is for cluster names instead of file names.

    Examples
    --------
    >>> from cornercase.suite import Requirement
    >>> requirement = Requirement.parse("for cut_in-*: ttc > 1.5 s")
    >>> requirement.applies_to("cut_in-00012.xosc"), requirement.applies_to("cut_out-00001.xosc")
    (True, False)
    """

    text: str
    expression: Expression
    pattern: str = ""
    is_for_clusters: bool = False

    def __str__(self) -> str:
        return self.text

    @classmethod
    def parse(cls, requirement: str) -> Requirement:
        """Parse a requirement.

        Parameters
        ----------
        requirement : str
            An expression for `cornercase.metrics.Expression`, such as ``"no collision"``, ``"reach X,Y[,R] within T"``
            in m and s, ``"ttc > 1.5"``, or ``"no collision and eventually(ego.speed < 1)"``. The prefix ``"for PATTERN:
            "`` limits the requirement to files with matching names, and ``'for kind "PATTERN": '`` to scenarios of
            matching clusters. ``*`` stands for any characters and ``?`` for one. A pattern with spaces is quoted as in
            JSON.

        Returns
        -------
        Requirement

        Raises
        ------
        InputError
            The text is not a requirement, a unit does not fit, or the text names an unknown metric.

        Examples
        --------
        >>> from cornercase.suite import Requirement
        >>> Requirement.parse("for *-00012.xosc:  reach 60, -1.75 within 20 s").text
        'for *-00012.xosc: reach 60,-1.75,2 within 20'
        """
        check_str("require", requirement)
        shown = " ".join(requirement.split())[:200]
        try:
            check_no_surrogates(requirement)
        except ValueError as error:
            raise InputError(f"`require` {shown}: {error}.") from error
        prefix = _PREFIX_PATTERN.fullmatch(requirement)
        if prefix is None:
            if shown.startswith("for "):
                raise InputError(
                    f"`require` {shown}: has no pattern; write 'for PATTERN: REQUIREMENT', with a space after the"
                    " colon."
                )
            expression = Expression.parse(requirement, "requirement")
            return cls(expression.text, expression)
        by_kind, pattern = bool(prefix[1]), _unquote_pattern(prefix[2], shown)
        expression = Expression.parse(prefix[3], "requirement")
        text = f"{requirement_prefix(pattern, is_for_clusters=by_kind)}{expression.text}"
        return cls(text, expression, pattern, by_kind)

    def applies_to(self, file: str, kind: str = "") -> bool:
        """Tell whether the requirement applies to a scenario.

        Parameters
        ----------
        file : str
            Name of the scenario file.
        kind : str, default ""
            Name of the cluster; empty if unknown.

        Returns
        -------
        bool
        """
        # Escape brackets, which may occur in names of files and clusters.
        return not self.pattern or fnmatchcase(kind if self.is_for_clusters else file, self.pattern.replace("[", "[[]"))


def parse_requirement_from(source: str, text: str) -> Requirement:
    """Parse a requirement from a file; an error message begins with `source` instead of naming an argument."""
    try:
        return Requirement.parse(text)
    except InputError as error:
        raise InputError(f"{source}{str(error).removeprefix('`require` ')}") from error


def requirement_prefix(pattern: str, *, is_for_clusters: bool = False) -> str:
    """Return the prefix that limits a requirement to files, or clusters, with matching names: ``"for PATTERN: "``."""
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
        raise InputError(f"`require` {requirement}: the pattern {pattern} is empty or not quoted as in JSON.")
    return text_
