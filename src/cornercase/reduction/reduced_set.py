"""The reduced set: the few concrete scenarios that matter, and what they leave out."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from html import escape

from cornercase.reduction.cluster_shapes import ClusterShape
from cornercase.reduction.coverage import Coverage
from cornercase.reduction.critical_coverage import CriticalCoverage
from cornercase.reduction.exposure import ExposingChoice
from cornercase.reduction.kept import Role
from cornercase.scenario import Value


@dataclass(frozen=True)
class KeptScenario:
    """A scenario of the reduced set.

    Attributes
    ----------
    id : int
        In the study.
    file : str
        OpenSCENARIO file in the folder of the reduced set; of imported recordings the recording.
    cluster : int
        Cluster that it represents; -1 for noise.
    role : {"archetype", "prototype", "gap", "exposing"}
        A gap is a scenario that was unlike those that were kept before it; one that is exposing exposes mutants of the
        driver.
    why : str
        Why it is kept, in words.
    values : mapping of str to float or str
        Parameters.
    scores : mapping of str to float
        By metric, in the metric's unit.
    """

    id: int
    file: str
    cluster: int
    role: Role
    why: str
    values: Mapping[str, Value]
    scores: Mapping[str, float]


@dataclass(frozen=True, repr=False)
class ReducedSet:
    """The few concrete scenarios that matter, and what they leave out.

    Attributes
    ----------
    by : str
        Aspect whose clusters count.
    run : int
        Number of scenarios that had been run.
    kept : tuple of KeptScenario
        In the order in which they were chosen.
    shapes : tuple of ClusterShape
        Of cluster 0 first; empty in a study of an early version.
    coverage : mapping of str to Coverage
        By aspect; without aspects that no kept scenario was analysed by.
    critical : mapping of str to CriticalCoverage
        By aspect; empty where no threshold says what is critical.
    hulls : mapping of int to tuple of tuple of int
        By cluster the facets of its hull in the parameter space, or of the hulls of its near-convex parts; each facet
        by the ids of the scenarios at its corners.
    exposing : ExposingChoice or None
        What mutants chose, and what that is worth; None where none did.
    threshold : float or None
        Score from which a scenario was critical when they were chosen; None where nothing said it.
    """

    by: str
    run: int
    kept: tuple[KeptScenario, ...]
    shapes: tuple[ClusterShape, ...]
    coverage: Mapping[str, Coverage]
    critical: Mapping[str, CriticalCoverage]
    hulls: Mapping[int, tuple[tuple[int, ...], ...]]
    exposing: ExposingChoice | None = None
    threshold: float | None = None

    def __len__(self) -> int:
        return len(self.kept)

    @property
    def ids(self) -> list[int]:
        """Ids of the kept scenarios, in the order in which they were chosen."""
        return [one.id for one in self.kept]

    def __repr__(self) -> str:
        roles = Counter(one.role for one in self.kept)
        counts = ", ".join(f"{count} {role}{'' if count == 1 else 's'}" for role, count in roles.items())
        return f"ReducedSet({len(self.kept)} of {self.run} scenarios kept by {self.by}: {counts or 'none'})"

    def _repr_html_(self) -> str:
        """Table of the kept scenarios, for notebooks."""
        if not self.kept:
            return f"<p>{escape(repr(self))}</p>"
        first = self.kept[0]
        head = ["id", "cluster", "role", *first.values, *first.scores, "why"]
        rows = [
            [one.id, one.cluster, one.role, *one.values.values(), *one.scores.values(), one.why] for one in self.kept
        ]
        cells = "".join(f"<tr>{''.join(f'<td>{escape(_text(cell))}</td>' for cell in row)}</tr>" for row in rows)
        names = "".join(f"<th>{escape(name)}</th>" for name in head)
        return f"<p>{escape(repr(self))}</p><table><tr>{names}</tr>{cells}</table>"


def _text(cell: object) -> str:
    return f"{cell:.4g}" if isinstance(cell, float) else str(cell)
