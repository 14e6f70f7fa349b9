"""A reduced set of a wanted size, or as small as a wanted coverage allows."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cornercase.archetypes import Kept, hull_archetypes, prototype
from cornercase.errors import InputError
from cornercase.typing import FloatArray, IntArray

# Archetypes take up to this share of the set; the rest goes where something is unlike all that is kept.
_ARCHETYPES = 0.5
_CRITICAL = 3.0
_ALIKE = 1e-3


def choose(
    points: FloatArray,
    distances: Sequence[FloatArray],
    labels: IntArray,
    critical: Sequence[int] = (),
    *,
    size: int | None = None,
    cover: float | None = None,
) -> tuple[Kept, ...]:
    """Choose scenarios for the clusters, and then for whatever they leave out.

    First the prototype of each cluster, critical ones first; then archetypes on the clusters' hulls, up to half of the
    set, each cluster with a part that grows with the root of its size and is three times as large where it is critical;
    then, always, the scenario that is least like all that are kept (farthest-first traversal, Gonzalez 1985), whatever
    its cluster. How unlike two scenarios are is the largest of their distances, each as a share of the largest in its
    matrix. Nothing is kept that is within 0.001 of something kept.

    Parameters
    ----------
    points : ndarray of float64, shape (n, d)
        Parameters in the unit cube.
    distances : sequence of ndarray of float64, each (n, n)
        Of all clusterings; the first is that of `labels`.
    labels : ndarray of int64, shape (n,)
        -1 is noise.
    critical : sequence of int
        Clusters that are critical.
    size : int, optional
        How many to keep, at least one; fewer only where no others differ.
    cover : float, optional
        Instead: go on until nothing is more unlike what is kept than this, above 0 and up to 1.

    Returns
    -------
    tuple of Kept
        In the order in which they were chosen.

    Raises
    ------
    InputError
        Neither or both of `size` and `cover` are given, or one is out of range.
    """
    if (size is None) == (cover is None):
        raise InputError("Give either a size or a coverage of the reduced set.")
    if size is not None and size < 1:
        raise InputError(f"A size of {size} keeps nothing; give 1 or more.")
    if cover is not None and not 0.0 < cover <= 1.0:
        raise InputError(f"A coverage of {cover:g} cannot be reached; give a number above 0 and up to 1.")
    apart = np.max([matrix / max(matrix.max(), 1e-300) for matrix in distances], axis=0)
    kept: list[Kept] = []
    gap = np.full(len(labels), np.inf)

    def keep(one: Kept) -> None:
        if gap[one.index] > _ALIKE and (size is None or len(kept) < size):
            kept.append(one)
            np.minimum(gap, apart[one.index], out=gap)

    clusters = [int(label) for label in np.unique(labels) if label >= 0]
    clusters.sort(key=lambda label: (label not in critical, label))
    for label in clusters:
        keep(Kept(prototype(distances[0], np.flatnonzero(labels == label)), label, "prototype"))
    # A coverage is reached with as few as possible, so without archetypes that add nothing to it.
    if size is not None and clusters:
        for one in _archetypes(points, labels, clusters, critical, int(_ARCHETYPES * size)):
            keep(one)
    while (len(kept) < size) if size is not None else bool(gap.max() > float(cover or 0.0)):
        worst = int(gap.argmax())
        if gap[worst] <= _ALIKE:
            break
        keep(Kept(worst, int(labels[worst]), "gap"))
    return tuple(kept)


def _archetypes(
    points: FloatArray, labels: IntArray, clusters: list[int], critical: Sequence[int], count: int
) -> list[Kept]:
    weights = np.array([np.sqrt((labels == c).sum()) * (_CRITICAL if c in critical else 1.0) for c in clusters])
    share = count * weights / weights.sum()
    each = np.floor(share).astype(int)
    each[np.argsort(each - share, kind="stable")[: count - each.sum()]] += 1
    found = []
    for label, number in zip(clusters, each.tolist(), strict=True):
        members = np.flatnonzero(labels == label)
        if number:
            found += [Kept(int(members[k]), label, "archetype") for k in hull_archetypes(points[members], number)]
    return found
