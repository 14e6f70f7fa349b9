"""Sentences about the scenarios and kinds of a study that a suite made from the study does not test."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator, Mapping
from typing import Any, Final

from cornercase._common.text.sanitize import quote_name
from cornercase.clustering import read_analyses
from cornercase.study import StudyFile

_MAX_KINDS: Final = 6


def describe_suite_gaps(study: StudyFile, earlier: StudyFile, sources: Collection[int]) -> Iterator[str]:
    """Yield sentences about what `study`, the run of a suite, did not test.

    `earlier` is the study that the suite was made from. `sources` are the ids that the scenarios of the suite have in
    `earlier`. Nothing is yielded if `earlier` is itself a run of the suite.
    """
    if earlier.meta.suite:
        return
    name = quote_name(earlier.path.name)
    left = [row.id for row in earlier.finished_rows() if row.id not in set(sources)]
    facts = []
    if earlier.criterion is not None:
        is_critical = dict(
            zip((row.id for row in earlier.finished_rows()), earlier.critical_mask().tolist(), strict=True)
        )
        facts.append(f"{sum(is_critical[scenario] for scenario in left) or 'none'} critical there")
    impacts = earlier.impacts()
    facts.append(f"{sum(bool(impacts.get(scenario)) for scenario in left) or 'none'} with a collision there")
    if left:
        yield f"{len(left)} of the {len(left) + len(sources)} scenarios of {name}: {', '.join(facts)}."
    yield from _describe_missing_kinds(study, earlier, sources)
    yield (
        f"What no scenario of {name} shows: the ranges of the parameters end there, and its own report says how much of"
        " the critical set it missed."
    )


def _describe_missing_kinds(study: StudyFile, earlier: StudyFile, sources: Collection[int]) -> Iterator[str]:
    """Yield a sentence about the kinds (named clusters) of the earlier study that are missing from the suite."""
    by, labels, sizes = _find_kinds(study, earlier)
    if by is None:
        return
    present = {labels[scenario] for scenario in sources if scenario in labels} | set(study.meta.kinds)
    missing = [(kind, size) for kind, size in sizes.items() if kind not in present]
    if not missing:
        yield f"Of the kinds of {quote_name(earlier.path.name)} by {by}, none is left out: all {len(sizes)} are in it."
        return
    texts = [f"“{kind}” ({size} scenarios there)" for kind, size in missing[:_MAX_KINDS]]
    more = f" and {len(missing) - _MAX_KINDS} more" if len(missing) > _MAX_KINDS else ""
    yield (
        f"Kinds of {quote_name(earlier.path.name)} by {by} that no scenario of the suite is of:"
        f" {', '.join(texts)}{more}."
    )


def _find_kinds(study: StudyFile, earlier: StudyFile) -> tuple[str | None, Mapping[int, str], Mapping[str, int]]:
    """Find the aspect (what scenarios are compared by) whose kinds (named clusters) the suite names.

    Return the aspect, the kind of each scenario of the earlier study that is in a cluster, by id, and the size of each
    kind. If several aspects have kinds that the suite names, the aspect with most of these kinds is returned. The
    aspect is None if the suite names no kind of the earlier study.
    """
    named = set(study.meta.kinds) - {""}
    best: tuple[int, str | None, dict[int, str], dict[str, int]] = (0, None, {}, {})
    analyses: Mapping[str, Any] = read_analyses(earlier)
    # If several aspects have kinds of the same names, the aspect that the study was reduced by counts.
    reduced_by = (earlier.read_reduction() or {}).get("by")
    for by, analysis in sorted(analyses.items(), key=lambda item: item[0] != reduced_by):
        label_of = {profile.cluster: profile.label for profile in analysis.profiles if profile.cluster >= 0}
        shared = len(named & set(label_of.values()))
        if shared > best[0]:
            labels = {
                scenario: label_of[cluster]
                for scenario, cluster in zip(analysis.ids.tolist(), analysis.labels.tolist(), strict=True)
                if cluster in label_of
            }
            best = (shared, by, labels, dict(Counter(labels.values()).most_common()))
    return best[1:]
