"""What references showed in the scenarios of a study."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from cornercase.metrics import CriticalIf, condition_of
from cornercase.study import Study, damage_told
from cornercase.suite import Requirement


@dataclass(frozen=True)
class ReferenceCount:
    """What a reference showed in the scenarios that were run again with it at the wheel of the ego.

    Attributes
    ----------
    prevents, collides, says_nothing : int
        Number of scenarios; it says nothing of those that it is no model of.
    """

    prevents: int
    collides: int
    says_nothing: int

    @property
    def run(self) -> int:
        """Number of scenarios that were run with it."""
        return self.prevents + self.collides + self.says_nothing


def count_references(study: Study) -> dict[str, ReferenceCount]:
    """Count what references showed in a study.

    Parameters
    ----------
    study : Study
        Open.

    Returns
    -------
    dict of str to ReferenceCount
        By name, of those that its condition or its requirements speak of.
    """
    meta = study.meta
    with damage_told(study.path):
        condition = condition_of(meta.metrics)
        names = list(CriticalIf.of(condition).references) if condition else []
        names += [Requirement.parse(one).reference for one in meta.requirements]
        found = {}
        for name in filter(None, dict.fromkeys(names)):
            collides = [one.collides for one in study.references(name).values()]
            found[name] = ReferenceCount(collides.count(False), collides.count(True), collides.count(None))
        return found


def tell_references(references: Mapping[str, ReferenceCount]) -> str:
    """Say what references showed that were put at the wheel of the ego.

    Parameters
    ----------
    references : mapping of str to ReferenceCount
        By name.

    Returns
    -------
    str
        A sentence for each, with a space before it; empty without any.
    """
    said = []
    for name, one in references.items():
        shown = [f"prevents {one.prevents}", f"does not prevent {one.collides}"]
        shown += [f"says nothing of {one.says_nothing}"] if one.says_nothing else []
        scenarios = "One scenario was" if one.run == 1 else f"{one.run} scenarios were"
        said.append(f" {scenarios} run again with {name} at the wheel, which {', '.join(shown[:-1])} and {shown[-1]}.")
    return "".join(said)
