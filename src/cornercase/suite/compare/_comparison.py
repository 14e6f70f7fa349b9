"""Result of a comparison of two versions of a system under test."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any, Final, Literal

from cornercase._common.text.notebook_html import render_html_table
from cornercase.evidence import CriticalSetDifference, Estimate
from cornercase.metrics import Metric
from cornercase.scenario import Value
from cornercase.suite._verdict import Verdict

if TYPE_CHECKING:
    import pandas as pd

ALPHA: Final = 0.05
"""Significance level: the probability that any of the tests finds a difference if nothing has changed."""

CRITICAL_SETS_METHOD: Final = "critical sets"
"""Method of the test that compares draws of the critical sets of both studies."""

RunComparison = Literal["the same", "within rounding", "otherwise", "not in one", "in neither"]

ComparisonVerdict = Literal["better", "worse", "mixed", "the same", "cannot say"]
"""Verdict of a comparison."""

ChangeDirection = Literal["worse", "better"]
"""Direction of a change."""

FindingKind = Literal["collision", "requirement", "run", "critical", "score"]
"""Subject of a finding."""

# Limits of scenarios named in a finding, and of findings in a sentence.
_MAX_NAMED_SCENARIOS: Final = 5
_MAX_LISTED_FINDINGS: Final = 4


@dataclass(frozen=True)
class ScenarioPair:
    """One concrete scenario that both studies ran, even if it failed; in each pair of values the old one comes first.

    Attributes
    ----------
    ids : tuple of (int, int)
        Id in each study.
    values : mapping of str to float or str
        Parameter values.
    point : tuple of float, length d
        Point in the unit cube.
    run : {"the same", "within rounding", "otherwise", "not in one", "in neither"}
        Whether the recordings are identical, differ by at most 1e-6 (in m, s, rad, m/s or m/s²), or differ by more.
        "not in one" means that the scenario failed in one study, "in neither" that it failed in both.
    is_score_independent : bool
        Whether both studies chose the scenario without regard to scores of earlier scenarios.
    errors : tuple of (str or None, str or None)
        Why the scenario failed in each study; None if it did not fail.
    scores : mapping of str to tuple of (float, float)
        Old and new score of each metric. If a run failed, this and all following attributes are empty, False or None.
    outcomes : tuple of (str, str)
        How the scenario ended, in words.
    collides : tuple of (bool, bool)
        Whether the ego collides with any entity.
    is_critical : tuple of (bool, bool) or None
        Whether the scenario is critical; None without a threshold.
    verdicts : tuple of (tuple of Verdict, tuple of Verdict)
        Verdicts on the requirements that both studies have; empty without such requirements.
    margins : mapping of str to tuple of (float, float)
        Margins of the requirements whose verdict changed between passed and failed; a negative margin means violated.
        Collisions have no margin.
    criticality_scores : mapping of str to tuple of (float, float)
        Old and new score of each metric that decides whether the scenario is critical; empty without a threshold.
    faults : tuple of (str, str)
        Who is at fault in the ego's first collision, such as ``"Ego at fault"`` or ``"fault undecided"``. Empty without
        a collision, and in studies of early versions, which did not store faults.

    Examples
    --------
    >>> import cornercase as cc
    >>> pairs = cc.compare("old.db", "new.db").pairs  # doctest: +SKIP
    >>> newly_hit = [pair for pair in pairs if pair.collides == (False, True)]  # doctest: +SKIP
    >>> newly_hit[0].ids, newly_hit[0].scores["wttc"]  # doctest: +SKIP
    ((5, 5), (0.767917308935819, 0.0))
    """

    ids: tuple[int, int]
    values: Mapping[str, Value]
    point: tuple[float, ...]
    run: RunComparison
    is_score_independent: bool
    errors: tuple[str | None, str | None] = (None, None)
    scores: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    outcomes: tuple[str, str] = ("", "")
    collides: tuple[bool, bool] = (False, False)
    is_critical: tuple[bool, bool] | None = None
    verdicts: tuple[tuple[Verdict, ...], tuple[Verdict, ...]] = ((), ())
    margins: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    criticality_scores: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    faults: tuple[str, str] = ("", "")

    @property
    def both_ran(self) -> bool:
        """True if the scenario ran without failing in both studies."""
        return bool(self.scores)

    @property
    def changed_verdicts(self) -> tuple[tuple[Verdict, Verdict], ...]:
        """Old and new verdict on each requirement whose state changed."""
        return tuple(
            (before, after) for before, after in zip(*self.verdicts, strict=True) if before.state != after.state
        )


@dataclass(frozen=True)
class ScoreChanges:
    """Changes of the score of one metric between the versions.

    Attributes
    ----------
    metric, unit : str
    pairs, moved : int
        Number of pairs that ran in both studies, and number of pairs whose score changed.
    worse, better : int
        Number of pairs whose score became more critical, and less critical.
    median : float
        Median of all changes other than 0, new minus old, in the unit; 0 if no score changed.
    largest : float
        Change with the largest absolute value, new minus old, in the unit.
    ids : tuple of (int, int) or None
        Ids of the pair with the largest change.

    Examples
    --------
    >>> import cornercase as cc
    >>> for change in cc.compare("old.db", "new.db").scores:  # doctest: +SKIP
    ...     print(f"{change.metric}: {change.worse} worse, {change.better} better, by up to {abs(change.largest):.2f}")
    wttc: 77 worse, 8 better, by up to 0.91
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
        What is tested: the scores of a metric, such as ``"wttc"``, or how many scenarios are ``"critical"``, have a
        ``"collision"``, have a ``"failed verdict"``, or failed to run (``"not run"``).
    method : str
        ``"Wilcoxon signed-rank"``, ``"exact McNemar"``, ``"Mann-Whitney"``, ``"exact Fisher"`` or
        ``"critical sets"``. The last one estimates the critical part of the space from each study, and compares random
        draws from both estimates.
    old, new : int
        Number of scenarios from each study; for paired tests both are the number of pairs.
    differ : int or None
        Number of pairs that differ; None for unpaired tests.
    p, corrected : float
        p-value, and p-value after Holm's correction for the number of tests.
    direction : {"worse", "better"} or None
        Whether the new version tends to be better or worse, even if the test is not significant; None for a tie.
    shift : float
        Mean score of the new version minus mean score of the old version, in the metric's unit. If scenarios are
        counted instead: proportion with the new version minus proportion with the old version.

    Examples
    --------
    >>> import cornercase as cc
    >>> for test in cc.compare("old.db", "new.db").tests:  # doctest: +SKIP
    ...     print(f"{test.about}: {test.direction} by {test.method}, p = {test.corrected:.1g}")
    wttc: worse by Wilcoxon signed-rank, p = 9e-14
    collision: worse by exact McNemar, p = 5e-06
    critical: worse by exact McNemar, p = 1e-10
    """

    about: str
    method: str
    old: int
    new: int
    differ: int | None
    p: float
    corrected: float
    direction: ChangeDirection | None
    shift: float


@dataclass(frozen=True, repr=False)
class Finding:
    """A kind of change with the new version, and the scenarios that show it; `str` returns a description.

    Attributes
    ----------
    kind : {"collision", "requirement", "run", "critical", "score"}
    about : str
        For the kind "score" the name of the metric, for "requirement" the requirement. Empty for other kinds, and if a
        test of all requirements together found the change.
    direction : {"worse", "better"}
        Whether the change makes the new version worse or better.
    ids : tuple of (int, int)
        Ids of the scenarios with this change, in the old and in the new study. Empty if a test of unpaired scenarios
        found the change.
    n_opposite : int, default 0
        Number of scenarios with the opposite change; 0 if no test found the change.
    largest_change : float or None, default None
        For the kind "score", the score change with the largest absolute value, new minus old.
    unit : str, default ""
        Unit of the score.
    test : ChangeTest or None, default None
        The significance test that found the change. None if no test was needed: when runs are deterministic, any
        scenario with different runs shows a change.

    Examples
    --------
    >>> import cornercase as cc
    >>> finding = cc.compare("old.db", "new.db").worse[0]  # doctest: +SKIP
    >>> finding.kind, finding.direction, finding.ids[0]  # doctest: +SKIP
    ('collision', 'worse', (5, 5))
    >>> print(finding)  # doctest: +SKIP
    37 new collisions (5, 10, 21, 25, 37 and 32 more)
    """

    kind: FindingKind
    about: str
    direction: ChangeDirection
    ids: tuple[tuple[int, int], ...]
    n_opposite: int = 0
    largest_change: float | None = None
    unit: str = ""
    test: ChangeTest | None = None

    def __str__(self) -> str:
        return self.text

    def __repr__(self) -> str:
        return f"<Finding: {self.direction}, {self.text}>"

    @property
    def change_text(self) -> str:
        """Describe the change, with the number of scenarios."""
        count, worse = len(self.ids), self.direction == "worse"
        if self.test is not None and self.test.method == CRITICAL_SETS_METHOD:
            return f"{'more' if worse else 'less'} of the space is critical, by {abs(self.test.shift):.1%} of it"
        if self.test is not None and not self.ids:
            return f"{self._describe_trend(worse)} among the space-filling scenarios"
        scenarios = f"{count} scenario{'' if count == 1 else 's'}"
        if self.kind == "collision":
            collisions = f"collision{'' if count == 1 else 's'}"
            return f"{count} new {collisions}" if worse else f"{count} {collisions} gone"
        if self.kind == "run":
            return f"{scenarios} can {'no longer be run' if worse else 'be run now'}"
        if self.kind == "critical":
            return f"{scenarios} {'newly' if worse else 'no longer'} critical"
        if self.kind == "requirement":
            requirement = f"'{self.about}'" if self.about else "a requirement"
            return f"{scenarios} {'newly' if worse else 'no longer'} fail{'s' if count == 1 else ''} {requirement}"
        size = "" if self.largest_change is None else f", by up to {abs(self.largest_change):.3g}"
        unit = f" {self.unit}" if size and self.unit not in ("", "1") else ""
        return f"{scenarios} {'more' if worse else 'less'} critical by {self.about}{size}{unit}"

    def _describe_trend(self, is_worse: bool) -> str:
        if self.kind == "score":
            return f"scores by {self.about} {'more' if is_worse else 'less'} critical"
        subject = {"collision": "collisions", "critical": "critical scenarios"}[self.kind]
        return f"{'more' if is_worse else 'fewer'} {subject}"

    def format_scenario_ids(self, limit: int = _MAX_NAMED_SCENARIOS) -> str:
        """List the ids of the scenarios, at most `limit`.

        Parameters
        ----------
        limit : int, default 5
            Largest number of scenarios that are named; the others are only counted.

        Returns
        -------
        str
            Ids such as ``"4, 9 and 3 more"``. ``"4→7"`` stands for a scenario with the id 4 in the old study and 7 in
            the new study.
        """
        n_more = len(self.ids) - limit
        return ", ".join(map(format_pair_ids, self.ids[:limit])) + (f" and {n_more} more" if n_more > 0 else "")

    def describe_test(self) -> str:
        """Describe the significance test that found the change, and how many scenarios changed the other way.

        Returns
        -------
        str
            Empty if no test was needed to find the change.
        """
        if self.test is None:
            return ""
        opposing = f"{self.n_opposite} the other way, " if self.ids else ""
        return f"{opposing}{self.test.method}, p = {self.test.corrected:.2g} corrected"

    @property
    def text(self) -> str:
        """Describe the change, with the ids of the first scenarios."""
        details = "; ".join(filter(None, (self.format_scenario_ids(), self.describe_test())))
        return f"{self.change_text} ({details})" if details else self.change_text


@dataclass(frozen=True)
class ClusterChange:
    """Numbers of pairs that belong to one cluster with the old and with the new version.

    Attributes
    ----------
    cluster : int
        Number of the cluster in the old study; -1 for noise, the scenarios outside all clusters.
    label : str
        Name of the cluster. It describes the old study, and may not be true of runs of the new version.
    old, new : int
        Number of pairs with each version.
    old_outcomes, new_outcomes : mapping of str to int
        How many of the cluster's scenarios end in each way, with each version; the most frequent ending comes first.
    ids : tuple of (int, int)
        Ids of the pairs that are in the cluster with one version only.

    Examples
    --------
    >>> import cornercase as cc
    >>> for kind in cc.compare("old.db", "new.db").clusters["interaction"]:  # doctest: +SKIP
    ...     print(f"{kind.label}: {kind.old} before, {kind.new} now")
    Ego passes after Pedestrian or is hit by Pedestrian while it stands; 10 of 146 collide: 146 before, 117 now
    Ego passes before Pedestrian: 54 before, 83 now
    """

    cluster: int
    label: str
    old: int
    new: int
    old_outcomes: Mapping[str, int] = field(default_factory=dict)
    new_outcomes: Mapping[str, int] = field(default_factory=dict)
    ids: tuple[tuple[int, int], ...] = ()


@dataclass(frozen=True)
class UnpairedScenarios:
    """Scenarios of one study whose parameter values the other study did not run.

    Attributes
    ----------
    count : int
        Number of these scenarios.
    chosen_by_scores : int
        Number of scenarios that the search of this study chose because of scores of earlier scenarios.
    critical : int or None
        Number of critical scenarios; None without a threshold.
    collisions : int
        Number of scenarios in which the ego collides.

    Examples
    --------
    >>> import cornercase as cc
    >>> only_old, only_new = cc.compare("old.db", "extended.db").unpaired  # doctest: +SKIP
    >>> only_new.count, only_new.chosen_by_scores, only_new.collisions  # doctest: +SKIP
    (10, 0, 1)
    """

    count: int
    chosen_by_scores: int
    critical: int | None
    collisions: int


@dataclass(frozen=True)
class SpaceChange:
    """Change of the critical part of the parameter space.

    Attributes
    ----------
    pairs : int
        Number of pairs that ran with both versions, and that both searches chose without regard to scores.
    gained, lost : Estimate or None
        Fraction of the space that is critical with the new version only, and with the old version only. Both are
        estimated from the pairs that `pairs` counts; None if there are fewer than 20.
    pairs_doubt : str
        Why `gained` and `lost` are None; empty if they are not.
    sets : CriticalSetDifference or None
        Change of the critical set (the critical part of the space), estimated from all scenarios of both studies. None
        if it cannot be estimated, or if both studies hold the same results.
    sets_doubt : str
        Why `sets` is None; empty if it is not.
    parameters, units : tuple of str
        Names and units of the coordinates of `sets.middles`.
    shares : tuple of (Estimate, Estimate) or None
        Critical share of the space with each version, estimated from scenarios that were chosen without regard to
        scores. None if there are fewer than 20 of them.
    change : Estimate or None
        Change of the critical share, new minus old, with an interval of at least 90 % confidence. None if `shares` is
        None.
    counts : tuple of (int, int)
        Number of scenarios of each study from which `shares` is estimated. If pairs are used, both numbers are equal.

    Examples
    --------
    >>> import cornercase as cc
    >>> space = cc.compare("old.db", "new.db").space  # doctest: +SKIP
    >>> old, new = space.shares  # doctest: +SKIP
    >>> f"{old.value:.0%} of the space was critical, {new.value:.0%} is now"  # doctest: +SKIP
    '12% of the space was critical, 30% is now'
    """

    pairs: int
    gained: Estimate | None
    lost: Estimate | None
    pairs_doubt: str
    sets: CriticalSetDifference | None
    sets_doubt: str
    parameters: tuple[str, ...]
    units: tuple[str, ...]
    shares: tuple[Estimate, Estimate] | None = None
    change: Estimate | None = None
    counts: tuple[int, int] = (0, 0)


@dataclass(frozen=True)
class Example:
    """An example scenario that shows a change.

    Attributes
    ----------
    pair : ScenarioPair
    reason : str
        What changed, in one sentence without a period.

    Examples
    --------
    >>> import cornercase as cc
    >>> for example in cc.compare("old.db", "new.db").examples:  # doctest: +SKIP
    ...     print(example.pair.ids, example.reason)
    (190, 190) Pedestrian first; now Ego and Pedestrian collide
    (93, 93) Pedestrian first; now Ego and Pedestrian collide
    (109, 109) Pedestrian first; now Ego and Pedestrian collide
    (42, 42) Pedestrian first; now Ego and Pedestrian collide
    (105, 105) Pedestrian first; now Ego and Pedestrian collide
    """

    pair: ScenarioPair
    reason: str


@dataclass(frozen=True)
class Comparison:
    """Result of a comparison of two versions of a system under test; as a bool, True if anything changed.

    Attributes
    ----------
    names : tuple of (str, str)
        File names of the old and the new study.
    title : str
        Name of the scenario.
    differences : tuple of str
        Differences between the settings of both studies, in words.
    changed : bool
        Whether the versions differ.
    reason : str
        Reason for `changed`, in one sentence.
    verdict : {"better", "worse", "mixed", "the same", "cannot say"}
        Verdict on the new version: mixed if some findings are worse and some better. Without findings, ``"the same"``,
        or ``"cannot say"`` if runs are not deterministic and there are too few scenarios for a significant test.
    verdict_reason : str
        Reason for the verdict.
    worse, better : tuple of Finding
        Findings for each direction, the most important first.
    within_tolerance : tuple of Finding
        Changes that do not count: a verdict on a requirement changed, or a scenario became critical or stopped being
        critical, but the scores behind it changed by no more than the tolerances.
    tolerances : mapping of str to float
        Largest change of a score that does not count, by metric.
    is_deterministic : bool
        Whether the runs of both studies are deterministic. If they are, any difference between recordings shows that
        the versions differ.
    pairs : tuple of ScenarioPair
        Scenarios with the same parameters, in the order of the old study.
    n_unmatched : tuple of (int, int)
        Number of scenarios in each study that the other study lacks.
    scores : tuple of ScoreChanges
        Score changes of each compared metric; empty if no pair ran with both versions.
    tests : tuple of ChangeTest
        All significance tests, also those without a significant result.
    outcomes : mapping of tuple of (str, str) to int
        Number of pairs by old and new outcome.
    verdicts : mapping of tuple of (str, str, str) to int
        Number of pairs by requirement, old and new state.
    clusters : mapping of str to tuple of ClusterChange
        Changes of clusters, by aspect. An aspect is what the scenarios of the old study were clustered by, such as
        "interaction".
    space : SpaceChange or None
        Change of the critical part of the space. None without a threshold, or if the scenarios of a study were not
        chosen by an optimizer.
    examples : tuple of Example
        At most five examples.
    metrics : mapping of str to Metric
        Metrics by name: the compared metrics, the metrics that decide which scenarios are critical, and the metrics in
        requirements.
    critical : float or None
        Threshold that was given for the comparison; None if each study's own threshold is used.
    unpaired : tuple of (UnpairedScenarios, UnpairedScenarios) or None
        Scenarios of each study that the other study lacks.
    same_search : bool
        Whether both studies were made by the same search with the same seed.
    main_aspect : str
        The aspect of `clusters` that says most about how scenarios end; empty without clusters.

    Examples
    --------
    >>> import cornercase as cc
    >>> comparison = cc.compare("old.db", "new.db")  # doctest: +SKIP
    >>> comparison.verdict, comparison.count_pairs("the same")  # doctest: +SKIP
    ('mixed', 102)
    >>> [finding.change_text for finding in comparison.worse]  # doctest: +SKIP
    ['37 new collisions', '35 scenarios newly critical', '62 scenarios more critical by wttc, by up to 0.912 s']
    """

    names: tuple[str, str]
    title: str
    differences: tuple[str, ...]
    changed: bool
    reason: str
    verdict: ComparisonVerdict
    verdict_reason: str
    worse: tuple[Finding, ...]
    better: tuple[Finding, ...]
    within_tolerance: tuple[Finding, ...]
    tolerances: Mapping[str, float]
    is_deterministic: bool
    pairs: tuple[ScenarioPair, ...]
    n_unmatched: tuple[int, int]
    scores: tuple[ScoreChanges, ...]
    tests: tuple[ChangeTest, ...]
    outcomes: Mapping[tuple[str, str], int]
    verdicts: Mapping[tuple[str, str, str], int]
    clusters: Mapping[str, tuple[ClusterChange, ...]]
    space: SpaceChange | None
    examples: tuple[Example, ...]
    metrics: Mapping[str, Metric]
    critical: float | None = None
    unpaired: tuple[UnpairedScenarios, UnpairedScenarios] | None = None
    same_search: bool = True
    main_aspect: str = ""

    def __bool__(self) -> bool:
        return self.changed

    def table(self) -> pd.DataFrame:
        """Make a table of the scenarios that both studies ran, even if they failed.

        Returns
        -------
        DataFrame
            One row per pair, indexed by ``old`` and ``new``, the ids in both studies. The columns are the parameters
            and ``run`` (whether the recordings are the same). Each metric, ``outcome`` and ``critical`` have two
            columns, one for each version, such as ``old outcome`` and ``new outcome``. If a run failed, the cells of
            these columns are empty. Without a threshold there are no columns for ``critical``.
        """
        import pandas as pd

        rows = []
        for pair in self.pairs:
            row: dict[str, Any] = {"old": pair.ids[0], "new": pair.ids[1]} | dict(pair.values) | {"run": pair.run}
            both: dict[str, tuple[Any, Any]] = dict(pair.scores)
            if pair.both_ran:
                both["outcome"] = pair.outcomes
            if pair.is_critical is not None:
                both["critical"] = pair.is_critical
            for name, values in both.items():
                row |= dict(zip((f"old {name}", f"new {name}"), values, strict=True))
            rows.append(row)
        return pd.DataFrame(rows).set_index(["old", "new"]) if rows else pd.DataFrame()

    def _repr_html_(self) -> str:
        """The verdict, and a table of the pairs that differ, for notebooks."""
        table = self.table()
        return render_html_table(repr(self), table[table["run"] != "the same"] if len(table) else table)

    def __repr__(self) -> str:
        changes = f"; {', '.join(self.differences)}" if self.differences else ""
        return f"<Comparison of {self.names[0]} and {self.names[1]}: {self.headline}{changes}>"

    @property
    def headline(self) -> str:
        """The verdict and its reason, without a period."""
        return f"{self.verdict.capitalize()}{'.' if self.verdict == 'mixed' else ':'} {self.verdict_reason}"

    def count_pairs(self, run_comparison: RunComparison) -> int:
        """Count the pairs whose recordings compare in a given way.

        Parameters
        ----------
        run_comparison : {"the same", "within rounding", "otherwise", "not in one", "in neither"}
            Value of `ScenarioPair.run`.

        Returns
        -------
        int
        """
        return sum(pair.run == run_comparison for pair in self.pairs)

    def to_json(self) -> dict[str, Any]:
        """Return the comparison as values that JSON can store.

        Returns
        -------
        dict of str to object
            ``changed_pairs`` has only the pairs whose recordings are not identical.
        """
        space = self.space
        return {
            "format": 1,
            "old": self.names[0],
            "new": self.names[1],
            "scenario": self.title,
            "verdict": self.verdict,
            "verdict_reason": self.verdict_reason,
            "worse": [_finding_to_json(item) for item in self.worse],
            "better": [_finding_to_json(item) for item in self.better],
            "within_tolerance": [_finding_to_json(item) for item in self.within_tolerance],
            "tolerances": dict(self.tolerances),
            "changed": self.changed,
            "reason": self.reason,
            "level": ALPHA,
            "repeatable": self.is_deterministic,
            "differences": list(self.differences),
            "critical": self.critical,
            "pairs": {
                "count": len(self.pairs),
                "same": self.count_pairs("the same"),
                "within_rounding": self.count_pairs("within rounding"),
                "otherwise": self.count_pairs("otherwise"),
                "not_in_one": self.count_pairs("not in one"),
                "in_neither": self.count_pairs("in neither"),
                "old_alone": self.n_unmatched[0],
                "new_alone": self.n_unmatched[1],
            },
            "unpaired": None if self.unpaired is None else [asdict(item) for item in self.unpaired],
            "scores": [asdict(item) for item in self.scores],
            "tests": [asdict(item) for item in self.tests],
            "outcomes": [{"old": a, "new": b, "count": n} for (a, b), n in sorted(self.outcomes.items())],
            "verdicts": [
                {"requirement": name, "old": a, "new": b, "count": n}
                for (name, a, b), n in sorted(self.verdicts.items())
            ],
            "kinds": {by: [asdict(item) for item in kinds] for by, kinds in self.clusters.items()},
            "space": None if space is None else asdict(space),
            "telling": [_pair_to_json(item.pair) | {"why": item.reason} for item in self.examples],
            "changed_pairs": [_pair_to_json(item) for item in self.pairs if item.run != "the same"],
        }


def format_pair_ids(ids: tuple[int, int]) -> str:
    """Return the ids of a scenario in both studies as text: `"4"`, or `"4→7"` if they differ."""
    return str(ids[0]) if ids[0] == ids[1] else f"{ids[0]}→{ids[1]}"


def describe_findings(findings: Sequence[Finding]) -> str:
    """Describe the first four findings in one line, and say how many more there are."""
    n_more = len(findings) - _MAX_LISTED_FINDINGS
    return ", ".join(finding.text for finding in findings[:_MAX_LISTED_FINDINGS]) + (
        f", and {n_more} more" if n_more > 0 else ""
    )


def _finding_to_json(finding: Finding) -> dict[str, Any]:
    return {
        "kind": finding.kind,
        "about": finding.about,
        "direction": finding.direction,
        "count": len(finding.ids),
        "against": finding.n_opposite,
        "largest": finding.largest_change,
        "text": finding.text,
        "pairs": [list(ids) for ids in finding.ids],
    }


def _pair_to_json(pair: ScenarioPair) -> dict[str, Any]:
    return {
        "old": pair.ids[0],
        "new": pair.ids[1],
        "values": dict(pair.values),
        "run": pair.run,
        "scores": {name: list(values) for name, values in pair.scores.items()},
        "outcomes": list(pair.outcomes),
        "faults": list(pair.faults),
        "critical": None if pair.is_critical is None else list(pair.is_critical),
        "verdicts": [[old.requirement, old.state, new.state] for old, new in pair.changed_verdicts],
        "errors": list(pair.errors),
    }
