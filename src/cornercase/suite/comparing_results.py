"""What a comparison of two versions says, as plain values."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, Final, Literal

from cornercase.evidence import Estimate, SetDifference
from cornercase.scenario import Value
from cornercase.suite.verdict import Verdict

LEVEL: Final = 0.05
"""Probability that two runs of one version are said to differ by any of the tests, at most."""

Run = Literal["the same", "within rounding", "otherwise", "not in one", "in neither"]


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
    """

    about: str
    method: str
    old: int
    new: int
    differ: int | None
    p: float
    corrected: float


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
    """What changed between two versions; `bool` says whether anything did.

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
        return f"<Comparison of {self.names[0]} and {self.names[1]}: {self.reason}>"

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
