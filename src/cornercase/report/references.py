"""What reference drivers showed in the scenarios of a study."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from cornercase.metrics import CriticalIf, condition_of
from cornercase.study import Study, damage_told
from cornercase.suite import Requirement


@dataclass(frozen=True)
class ReferenceCount:
    """How many scenarios, re-run with a reference driving the ego, had which result."""

    prevents: int
    collides: int
    says_nothing: int  # scenarios outside the model of the reference

    @property
    def run(self) -> int:
        """Number of scenarios that were re-run with it."""
        return self.prevents + self.collides + self.says_nothing


def count_references(study: Study) -> dict[str, ReferenceCount]:
    """Count the results of each reference named in the condition or requirements of an open study, by name."""
    meta = study.meta
    with damage_told(study.path):
        condition = condition_of(meta.metrics)
        names = list(CriticalIf.of(condition).references) if condition else []
        names += [Requirement.parse(text).reference for text in meta.requirements]
        counts = {}
        for reference in filter(None, dict.fromkeys(names)):
            collisions = [count.collides for count in study.references(reference).values()]
            counts[reference] = ReferenceCount(collisions.count(False), collisions.count(True), collisions.count(None))
        return counts


def tell_references(references: Mapping[str, ReferenceCount]) -> str:
    """Describe what the references showed: one sentence each, preceded by a space; empty without any."""
    sentences = []
    for name, count in references.items():
        results = [f"prevents {count.prevents}", f"does not prevent {count.collides}"]
        results += [f"says nothing of {count.says_nothing}"] if count.says_nothing else []
        scenarios = "One scenario was" if count.run == 1 else f"{count.run} scenarios were"
        sentences.append(
            f" {scenarios} run again with {name} at the wheel, which {', '.join(results[:-1])} and {results[-1]}."
        )
    return "".join(sentences)
