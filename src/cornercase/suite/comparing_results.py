"""What a comparison of two versions says, as plain values."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, Final, Literal

from cornercase.evidence import Estimate, SetDifference
from cornercase.scenario import Value
from cornercase.suite.verdict import Verdict

LEVEL: Final = 0.05
"""Probability that two runs of one version are said to differ by any of the tests, at most."""

Run = Literal["the same", "within rounding", "otherwise", "not in one", "in neither"]

Answer = Literal["better", "worse", "mixed", "the same", "cannot say"]
"""What a comparison comes to."""

Direction = Literal["worse", "better"]
"""Which way a change goes."""

# Scenarios that a finding names in a sentence, and findings that one sentence names.
_NAMED: Final = 5
_TOLD: Final = 4


@dataclass(frozen=True)
class Pair:
    """One concrete scenario that was run with both versions; of each pair of values the old one comes first.

    Attributes
    ----------
    ids : tuple of (int, int)
        In each study.
    values : mapping of str to float or str
        Of the scenario's parameters.
    point : tuple of float, length d
        In the unit cube.
    run : {"the same", "within rounding", "otherwise", "not in one", "in neither"}
        Whether both recordings are the same bytes, differ by a millionth of a unit at most, or by more; or whether the
        scenario could be run in one study only, or in none.
    unselected : bool
        Whether neither study chose the scenario by scores.
    errors : tuple of (str or None, str or None)
        Why it could not be run.
    scores : mapping of str to tuple of (float, float)
        By metric, in its unit; empty where one was not run, as with all that follow.
    outcomes : tuple of (str, str)
        In words.
    collides : tuple of (bool, bool)
        Whether the ego collides, with anyone.
    critical : tuple of (bool, bool) or None
        None where nothing says it.
    verdicts : tuple of (tuple of Verdict, tuple of Verdict)
        On the requirements that both studies have; empty without any.
    margins : mapping of str to tuple of (float, float)
        By requirement that turned from passed to failed or back: how far it holds, negative if it is violated. Only
        for bounds, formulas and places; whether there is a collision is not a matter of degree.
    deciding : mapping of str to tuple of (float, float)
        Scores that decide whether the scenario is critical, by metric; empty where nothing does.
    """

    ids: tuple[int, int]
    values: Mapping[str, Value]
    point: tuple[float, ...]
    run: Run
    unselected: bool
    errors: tuple[str | None, str | None] = (None, None)
    scores: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    outcomes: tuple[str, str] = ("", "")
    collides: tuple[bool, bool] = (False, False)
    critical: tuple[bool, bool] | None = None
    verdicts: tuple[tuple[Verdict, ...], tuple[Verdict, ...]] = ((), ())
    margins: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    deciding: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    @property
    def ran(self) -> bool:
        """Whether it was run in both studies."""
        return bool(self.scores)

    @property
    def turned(self) -> tuple[tuple[Verdict, Verdict], ...]:
        """Verdicts of which the state changed, old and new."""
        return tuple((old, new) for old, new in zip(*self.verdicts, strict=True) if old.state != new.state)


@dataclass(frozen=True)
class ScoreChange:
    """How far the score of one metric moved between the versions.

    Attributes
    ----------
    metric, unit : str
    pairs, moved : int
        Pairs that were run in both studies, and those of them in which the score moved.
    worse, better : int
        In how many it became more critical, and less.
    median : float
        Of the changes of those that moved, new less old, in the unit; 0 where none did.
    largest : float
        Largest of them, with its sign.
    ids : tuple of (int, int) or None
        Pair of the largest change.
    """

    metric: str
    unit: str
    pairs: int
    moved: int
    worse: int
    better: int
    median: float
    largest: float
    ids: tuple[int, int] | None


@dataclass(frozen=True)
class ChangeTest:
    """One test of whether the versions differ.

    Attributes
    ----------
    about : str
        What is tested: ``"wttc"``, ``"critical"``, ``"collision"``, ``"failed verdict"`` or ``"not run"``.
    method : str
        ``"Wilcoxon signed-rank"``, ``"exact McNemar"``, ``"Mann-Whitney"`` or ``"exact Fisher"``.
    old, new : int
        Scenarios of each study that it looked at; the same number where these are pairs.
    differ : int or None
        Pairs that differ; None where there are no pairs.
    p, corrected : float
        Probability of what was found, or more, where the versions are the same: by itself, and by Holm's correction
        for all tests that were made.
    direction : {"worse", "better"} or None
        Where the new version lies, whether or not the test is significant; None where neither is ahead.
    shift : float
        Mean score of the new version less that of the old one, in the metric's unit; of what is so or not, the
        difference of the shares.
    """

    about: str
    method: str
    old: int
    new: int
    differ: int | None
    p: float
    corrected: float
    direction: Direction | None
    shift: float


@dataclass(frozen=True)
class Finding:
    """What became worse or better with the new version, or changed within the tolerances.

    Attributes
    ----------
    kind : {"collision", "requirement", "run", "critical", "score"}
    about : str
        The requirement, or the metric of the score; empty for other kinds, and where a test looks at all requirements.
    direction : {"worse", "better"}
    ids : tuple of (int, int)
        Scenarios in which that happened, in the old and in the new study; empty where a test found it in scenarios
        that are not the same.
    against : int, default 0
        Scenarios in which the opposite happened; counted where a test decides.
    largest : float or None, default None
        Largest move of a score, with its sign.
    unit : str, default ""
        Of the score.
    test : ChangeTest or None, default None
        What decided it; None where the scenarios themselves show it.
    """

    kind: Literal["collision", "requirement", "run", "critical", "score"]
    about: str
    direction: Direction
    ids: tuple[tuple[int, int], ...]
    against: int = 0
    largest: float | None = None
    unit: str = ""
    test: ChangeTest | None = None

    @property
    def what(self) -> str:
        """In words, with the number of scenarios."""
        count, worse = len(self.ids), self.direction == "worse"
        if self.test is not None and not self.ids:
            return f"{self._trend(worse)} among the scenarios that fill the space"
        scenarios = f"{count} scenario{'' if count == 1 else 's'}"
        if self.kind == "collision":
            collisions = f"collision{'' if count == 1 else 's'}"
            return f"{count} new {collisions}" if worse else f"{count} {collisions} gone"
        if self.kind == "run":
            return f"{scenarios} can {'no longer be run' if worse else 'be run now'}"
        if self.kind == "critical":
            return f"{scenarios} {'newly' if worse else 'no longer'} critical"
        if self.kind == "requirement":
            which = f"'{self.about}'" if self.about else "a requirement"
            return f"{scenarios} {'newly' if worse else 'no longer'} fail{'s' if count == 1 else ''} {which}"
        moved = "" if self.largest is None else f", by up to {abs(self.largest):.3g}"
        unit = f" {self.unit}" if moved and self.unit not in ("", "1") else ""
        return f"{scenarios} {'more' if worse else 'less'} critical by {self.about}{moved}{unit}"

    def _trend(self, worse: bool) -> str:
        if self.kind == "score":
            return f"scores by {self.about} {'more' if worse else 'less'} critical"
        what = {"collision": "collisions", "critical": "critical scenarios"}[self.kind]
        return f"{'more' if worse else 'fewer'} {what}"

    def name_scenarios(self, most: int = _NAMED) -> str:
        """Name the scenarios.

        Parameters
        ----------
        most : int, default 5
            The others are counted.

        Returns
        -------
        str
            ``"4, 9 and 3 more"``; a scenario that has another number in the new study as ``"4→7"``.
        """
        more = len(self.ids) - most
        return ", ".join(map(name_pair, self.ids[:most])) + (f" and {more} more" if more > 0 else "")

    def tell_test(self) -> str:
        """Say which test decided, and how many scenarios went the other way.

        Returns
        -------
        str
            Empty if the scenarios themselves decide.
        """
        if self.test is None:
            return ""
        opposite = f"{self.against} the other way, " if self.ids else ""
        return f"{opposite}{self.test.method}, p = {self.test.corrected:.2g} corrected"

    @property
    def text(self) -> str:
        """In words, with the numbers of the first scenarios."""
        inside = "; ".join(filter(None, (self.name_scenarios(), self.tell_test())))
        return f"{self.what} ({inside})" if inside else self.what


@dataclass(frozen=True)
class KindChange:
    """How one kind grew or shrank, among the same scenarios.

    Attributes
    ----------
    cluster : int
        In the old study; -1 for noise.
    label : str
        What it is called.
    old, new : int
        Its scenarios with each version.
    """

    cluster: int
    label: str
    old: int
    new: int


@dataclass(frozen=True)
class SpaceChange:
    """How the critical part of the space changed.

    Attributes
    ----------
    pairs : int
        Pairs that neither study chose by scores, and that fill the space.
    gained, lost : Estimate or None
        Shares of the space that are critical with the new version only, and with the old one only, by those pairs
        alone; None where there are fewer than 20.
    pairs_doubt : str
        Why these cannot be given; empty where they can.
    sets : SetDifference or None
        What is known by all scenarios of both studies; None where there is no interval.
    sets_doubt : str
        Why there is none; empty where there is.
    parameters, units : tuple of str
        What `sets.middles` is about.
    """

    pairs: int
    gained: Estimate | None
    lost: Estimate | None
    pairs_doubt: str
    sets: SetDifference | None
    sets_doubt: str
    parameters: tuple[str, ...]
    units: tuple[str, ...]


@dataclass(frozen=True)
class Telling:
    """A scenario that tells the versions apart.

    Attributes
    ----------
    pair : Pair
    why : str
        What changed, in one sentence without a full stop.
    """

    pair: Pair
    why: str


@dataclass(frozen=True)
class Comparison:
    """What changed between two versions, and whether it is for the worse; `bool` says whether anything changed.

    Attributes
    ----------
    names : tuple of (str, str)
        Of the old and the new study's file.
    title : str
        Of the scenario.
    differences : tuple of str
        What the studies were made with, where they differ, in words.
    changed : bool
        Whether the versions differ.
    reason : str
        Why that is said, in one sentence.
    verdict : {"better", "worse", "mixed", "the same", "cannot say"}
        Of the new version; mixed where some is worse and some better, the same where neither is.
    verdict_reason : str
        Why that is said.
    worse, better : tuple of Finding
        What speaks for it, what matters most first.
    within : tuple of Finding
        Requirements and thresholds that were crossed within the tolerances, so that they do not count.
    tolerances : mapping of str to float
        By metric: by how much its score may move and still count as the same.
    certain : bool
        Whether both simulators repeat themselves, so that every difference of a pair is one of the versions.
    pairs : tuple of Pair
        Scenarios of the same parameters, in the order of the old study.
    alone : tuple of (int, int)
        Scenarios of each study that have no partner.
    scores : tuple of ScoreChange
        One for each metric; empty without pairs.
    tests : tuple of ChangeTest
    outcomes : mapping of tuple of (str, str) to int
        How many pairs went from which outcome to which.
    verdicts : mapping of tuple of (str, str, str) to int
        How many pairs went, by requirement, from which state to which.
    kinds : mapping of str to tuple of KindChange
        By aspect that the old study was analysed by.
    space : SpaceChange or None
        None where nothing says what is critical.
    telling : tuple of Telling
        At most five.
    critical : float or None
        Threshold that was given for the comparison; None where the studies' own holds.
    """

    names: tuple[str, str]
    title: str
    differences: tuple[str, ...]
    changed: bool
    reason: str
    verdict: Answer
    verdict_reason: str
    worse: tuple[Finding, ...]
    better: tuple[Finding, ...]
    within: tuple[Finding, ...]
    tolerances: Mapping[str, float]
    certain: bool
    pairs: tuple[Pair, ...]
    alone: tuple[int, int]
    scores: tuple[ScoreChange, ...]
    tests: tuple[ChangeTest, ...]
    outcomes: Mapping[tuple[str, str], int]
    verdicts: Mapping[tuple[str, str, str], int]
    kinds: Mapping[str, tuple[KindChange, ...]]
    space: SpaceChange | None
    telling: tuple[Telling, ...]
    critical: float | None = None

    def __bool__(self) -> bool:
        return self.changed

    def __repr__(self) -> str:
        return f"<Comparison of {self.names[0]} and {self.names[1]}: {self.headline}>"

    @property
    def headline(self) -> str:
        """The verdict and why, without a full stop."""
        return f"{self.verdict.capitalize()}{'.' if self.verdict == 'mixed' else ':'} {self.verdict_reason}"

    def count(self, run: Run) -> int:
        """Count pairs by how they ran.

        Parameters
        ----------
        run : {"the same", "within rounding", "otherwise", "not in one", "in neither"}

        Returns
        -------
        int
        """
        return sum(one.run == run for one in self.pairs)

    def to_json(self) -> dict[str, Any]:
        """Return plain values.

        Returns
        -------
        dict of str to object
            Of the pairs only those that are not the same.
        """
        space = self.space
        return {
            "format": 1,
            "old": self.names[0],
            "new": self.names[1],
            "scenario": self.title,
            "verdict": self.verdict,
            "verdict_reason": self.verdict_reason,
            "worse": [_plain_finding(one) for one in self.worse],
            "better": [_plain_finding(one) for one in self.better],
            "within_tolerance": [_plain_finding(one) for one in self.within],
            "tolerances": dict(self.tolerances),
            "changed": self.changed,
            "reason": self.reason,
            "level": LEVEL,
            "repeatable": self.certain,
            "differences": list(self.differences),
            "critical": self.critical,
            "pairs": {
                "count": len(self.pairs),
                "same": self.count("the same"),
                "within_rounding": self.count("within rounding"),
                "otherwise": self.count("otherwise"),
                "not_in_one": self.count("not in one"),
                "in_neither": self.count("in neither"),
                "old_alone": self.alone[0],
                "new_alone": self.alone[1],
            },
            "scores": [asdict(one) for one in self.scores],
            "tests": [asdict(one) for one in self.tests],
            "outcomes": [{"old": a, "new": b, "count": n} for (a, b), n in sorted(self.outcomes.items())],
            "verdicts": [
                {"requirement": name, "old": a, "new": b, "count": n}
                for (name, a, b), n in sorted(self.verdicts.items())
            ],
            "kinds": {by: [asdict(one) for one in kinds] for by, kinds in self.kinds.items()},
            "space": None if space is None else asdict(space),
            "telling": [_plain_pair(one.pair) | {"why": one.why} for one in self.telling],
            "changed_pairs": [_plain_pair(one) for one in self.pairs if one.run != "the same"],
        }


def name_pair(ids: tuple[int, int]) -> str:
    """Name a scenario by its number in both studies.

    Parameters
    ----------
    ids : tuple of (int, int)

    Returns
    -------
    str
        ``"4"``, or ``"4→7"`` if it has another number in the new study.
    """
    return str(ids[0]) if ids[0] == ids[1] else f"{ids[0]}→{ids[1]}"


def tell_findings(findings: Sequence[Finding]) -> str:
    """Put findings in one line.

    Parameters
    ----------
    findings : sequence of Finding

    Returns
    -------
    str
        The first four of them; the others are counted.
    """
    more = len(findings) - _TOLD
    return ", ".join(one.text for one in findings[:_TOLD]) + (f", and {more} more" if more > 0 else "")


def _plain_finding(finding: Finding) -> dict[str, Any]:
    return {
        "kind": finding.kind,
        "about": finding.about,
        "direction": finding.direction,
        "count": len(finding.ids),
        "against": finding.against,
        "largest": finding.largest,
        "text": finding.text,
        "pairs": [list(one) for one in finding.ids],
    }


def _plain_pair(pair: Pair) -> dict[str, Any]:
    return {
        "old": pair.ids[0],
        "new": pair.ids[1],
        "values": dict(pair.values),
        "run": pair.run,
        "scores": {name: list(both) for name, both in pair.scores.items()},
        "outcomes": list(pair.outcomes),
        "critical": None if pair.critical is None else list(pair.critical),
        "verdicts": [[old.requirement, old.state, new.state] for old, new in pair.turned],
        "errors": list(pair.errors),
    }
