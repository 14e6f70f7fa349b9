"""Compiled sampling of paths, and search for the overlap of two paths."""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, untyped-decorator"

from __future__ import annotations

import math

import numpy as np

from cornercase._common.geometry.aabb_tree import (
    append_overlap_run,
    build_aabb_tree,
    next_overlapping_leaf,
    node_after_subtree,
)
from cornercase._common.numba.kernel import kernel

_MARGIN = 1e-3
"""Margin in m of the search for centres that are near enough, far more than rounding."""

_N_BISECTIONS = 20
"""Number of bisections of a step in the search for the instant of contact: to a millionth of the step."""

_MAX_SUBSTEPS = 50
"""Largest number of parts of a time step."""

_STANDING_TOLERANCE = 1e-9
"""Largest change of a pose between two instants of a standing entity."""


@kernel(error_model="numpy")
def sample_path(time, exists, x, y, cos, sin, max_spacing):
    """Return times, shape (n,), and poses, shape (4, n), of boxes that are at most `max_spacing` apart on a path.

    A pose is x and y of the centre, and cosine and sine of the heading. While the entity stands, only the first and the
    last instant are sampled. A step is split into at most 50 parts; the boxes of a longer step are farther apart.
    """
    n_instants, n_selected = len(time), 0
    selected = np.empty(n_instants, dtype=np.int64)
    is_still = False
    for k in range(n_instants):
        if not exists[k]:
            is_still = False
            continue
        stays = (
            k + 1 < n_instants
            and exists[k + 1]
            and abs(x[k + 1] - x[k]) <= _STANDING_TOLERANCE
            and abs(y[k + 1] - y[k]) <= _STANDING_TOLERANCE
            and abs(cos[k + 1] - cos[k]) <= _STANDING_TOLERANCE
            and abs(sin[k + 1] - sin[k]) <= _STANDING_TOLERANCE
        )
        if not (is_still and stays):
            selected[n_selected] = k
            n_selected += 1
        is_still = stays
    n_parts, n_boxes = np.ones(n_selected, dtype=np.int64), n_selected
    for i in range(n_selected - 1):
        k, after = selected[i], selected[i + 1]
        step_length = math.hypot(x[after] - x[k], y[after] - y[k])
        n_parts[i] = int(min(max(np.ceil(step_length / max(max_spacing, 1e-3)), 1.0), _MAX_SUBSTEPS))
        n_boxes += n_parts[i] - 1
    times, poses = np.empty(n_boxes), np.empty((4, n_boxes))
    has_parts, box = n_boxes > n_selected, 0
    for i in range(n_selected):
        k, after = selected[i], selected[min(i + 1, n_selected - 1)]
        for part in range(n_parts[i]):
            # Rounded as a position along the whole path.
            share = (i + part / n_parts[i]) - i
            times[box] = (time[after] - time[k]) * share + time[k]
            poses[0, box] = (x[after] - x[k]) * share + x[k]
            poses[1, box] = (y[after] - y[k]) * share + y[k]
            poses[2, box] = (cos[after] - cos[k]) * share + cos[k]
            poses[3, box] = (sin[after] - sin[k]) * share + sin[k]
            if has_parts:
                norm = max(math.hypot(poses[2, box], poses[3, box]), 1e-12)
                poses[2, box] /= norm
                poses[3, box] /= norm
            box += 1
    return times, poses


@kernel(error_model="numpy")
def find_first_crossing(time_a, poses_a, size_a, time_b, poses_b, size_b):
    """Return whether two paths overlap, and when each entity is in the overlap that is reached first.

    Where boxes of both paths overlap in successive steps, they form one overlap of the paths. The times in s are the
    first and last contact of entity a, then of entity b.
    """
    nothing = (False, math.nan, math.nan, math.nan, math.nan)
    if _bounding_boxes_are_disjoint(poses_a, size_a, poses_b, size_b):
        return nothing
    runs = _find_overlap_runs(poses_a, size_a, poses_b, size_b, build_aabb_tree(_bounds_of_centres(poses_b)))
    if not len(runs):
        return nothing
    roots = _connect_runs(runs)
    earliest, first = math.inf, nothing
    for root in range(len(runs)):
        if roots[root] != root:
            continue
        enters, leaves = _contact_times(time_a, poses_a, size_a, poses_b, size_b, runs, roots, root, True)
        other_enters, other_leaves = _contact_times(time_b, poses_b, size_b, poses_a, size_a, runs, roots, root, False)
        if min(enters, other_enters) < earliest or not first[0]:
            earliest, first = min(enters, other_enters), (True, enters, leaves, other_enters, other_leaves)
    return first


@kernel(error_model="numpy", _nrt=False)
def _bounding_boxes_are_disjoint(poses_a, size_a, poses_b, size_b):
    reach = 0.5 * (math.hypot(size_a[0], size_a[1]) + math.hypot(size_b[0], size_b[1]))
    for k in range(2):
        low_a, high_a, low_b, high_b = math.inf, -math.inf, math.inf, -math.inf
        for i in range(poses_a.shape[1]):
            low_a, high_a = min(low_a, poses_a[k, i]), max(high_a, poses_a[k, i])
        for j in range(poses_b.shape[1]):
            low_b, high_b = min(low_b, poses_b[k, j]), max(high_b, poses_b[k, j])
        if low_a > high_b + reach or low_b > high_a + reach:
            return True
    return False


@kernel(error_model="numpy")
def _bounds_of_centres(poses):
    """Return a bounding box of size 0 for each centre of a path, as input of a bounding-box tree."""
    bounds = np.empty((poses.shape[1], 4))
    for i in range(len(bounds)):
        for k in range(2):
            bounds[i, k] = bounds[i, k + 2] = poses[k, i]
    return bounds


@kernel(error_model="numpy")
def _connect_runs(runs):
    """Return for each run of `_find_overlap_runs` the index of the first run in the same overlap of the paths."""
    roots = np.empty(len(runs), dtype=np.int64)
    for run in range(len(runs)):
        roots[run] = run
    before, step = 0, 0
    for run in range(len(runs)):
        if runs[run, 0] != runs[step, 0]:
            before, step = step, run
        if step == 0 or runs[before, 0] != runs[run, 0] - 1:
            continue
        for near in range(before, step):
            if runs[near, 1] <= runs[run, 2] + 1 and runs[near, 2] >= runs[run, 1] - 1:
                root, other_root = _find_root(roots, run), _find_root(roots, near)
                roots[max(root, other_root)] = min(root, other_root)
    for run in range(len(runs)):
        roots[run] = roots[roots[run]]
    return roots


@kernel(error_model="numpy", _nrt=False)
def _find_root(roots, run):
    while roots[run] != run:
        roots[run] = roots[roots[run]]
        run = roots[run]
    return run


@kernel(error_model="numpy")
def _contact_times(time, poses, size, other_poses, other_size, runs, roots, root, is_path_a):
    """Return the first and last time at which the boxes of one path touch the other path in one overlap.

    The overlap consists of the runs (see `_find_overlap_runs`) whose root is `root`.
    """
    begin, end = (0, 0) if is_path_a else (1, 2)
    first, last = len(time), -1
    for run in range(len(runs)):
        if roots[run] == root:
            first, last = min(first, runs[run, begin]), max(last, runs[run, end])
    # A step has each box of the other path in one run at most.
    touched = np.empty(other_poses.shape[1], dtype=np.int64)
    enters, leaves = time[first], time[last]
    for step, neighbour in ((first, first - 1), (last, last + 1)):
        if not 0 <= neighbour < len(time):
            continue
        n_touched = 0
        for run in range(len(runs)):
            if roots[run] == root and runs[run, begin] <= step <= runs[run, end]:
                low, high = (runs[run, 1], runs[run, 2]) if is_path_a else (runs[run, 0], runs[run, 0])
                for box in range(low, high + 1):
                    touched[n_touched] = box
                    n_touched += 1
        share = _contact_fraction(poses, size, neighbour, step, other_poses, other_size, touched, n_touched)
        contact = time[neighbour] + share * (time[step] - time[neighbour])
        if neighbour < step:
            enters = contact
        else:
            leaves = contact
    return enters, leaves


@kernel(error_model="numpy")
def _find_overlap_runs(poses_a, size_a, poses_b, size_b, tree):
    """Return which boxes of path a overlap which boxes of path b, as runs of consecutive boxes of path b.

    A run is a box of a, and the first and last box of b. `poses_a`, shape (4, n), and `poses_b`, shape (4, m), have
    rows x, y, cosine and sine of the heading; sizes are length and width. `tree` is the bounding-box tree of the
    centres of path b.
    """
    reach = 0.5 * (math.hypot(size_a[0], size_a[1]) + math.hypot(size_b[0], size_b[1]))
    wide = reach + _MARGIN
    leaves, count = len(tree) // 2, 0
    runs = np.empty((64, 3), dtype=np.int64)
    for i in range(poses_a.shape[1]):
        low_x, low_y, high_x, high_y = (
            poses_a[0, i] - wide,
            poses_a[1, i] - wide,
            poses_a[0, i] + wide,
            poses_a[1, i] + wide,
        )
        last = -2
        node = next_overlapping_leaf(tree, 1, low_x, low_y, high_x, high_y)
        while node > 0:
            j = node - leaves
            x, y = poses_b[0, j] - poses_a[0, i], poses_b[1, j] - poses_a[1, i]
            if x * x + y * y <= reach * reach and _boxes_overlap(
                x, y, poses_a[2, i], poses_a[3, i], size_a, poses_b[2, j], poses_b[3, j], size_b
            ):
                if j != last + 1:
                    runs = append_overlap_run(runs, count, i, j)
                    count += 1
                runs[count - 1, 2] = last = j
            node = next_overlapping_leaf(tree, node_after_subtree(node), low_x, low_y, high_x, high_y)
    return runs[:count]


@kernel(error_model="numpy", _nrt=False)
def _contact_fraction(poses_a, size_a, before, after, poses_b, size_b, touched, n_touched):
    """Return the fraction of a step of path a at which it first touches one of the `touched` boxes of path b."""
    low, high = 0.0, 1.0
    for _ in range(_N_BISECTIONS):
        share = 0.5 * (low + high)
        x = poses_a[0, before] + share * (poses_a[0, after] - poses_a[0, before])
        y = poses_a[1, before] + share * (poses_a[1, after] - poses_a[1, before])
        cos = poses_a[2, before] + share * (poses_a[2, after] - poses_a[2, before])
        sin = poses_a[3, before] + share * (poses_a[3, after] - poses_a[3, before])
        norm = math.hypot(cos, sin)
        touches = False
        for k in range(n_touched):
            j = touched[k]
            if _boxes_overlap(
                poses_b[0, j] - x,
                poses_b[1, j] - y,
                cos / norm,
                sin / norm,
                size_a,
                poses_b[2, j],
                poses_b[3, j],
                size_b,
            ):
                touches = True
                break
        if touches:
            high = share
        else:
            low = share
    return high


@kernel(error_model="numpy", _nrt=False)
def _boxes_overlap(x, y, cos_a, sin_a, size_a, cos_b, sin_b, size_b):
    """Return whether two boxes overlap whose centres differ by (x, y) (separating-axis test)."""
    cos, sin = abs(cos_a * cos_b + sin_a * sin_b), abs(cos_a * sin_b - sin_a * cos_b)
    length_a, width_a, length_b, width_b = 0.5 * size_a[0], 0.5 * size_a[1], 0.5 * size_b[0], 0.5 * size_b[1]
    return (
        abs(cos_a * x + sin_a * y) <= length_a + cos * length_b + sin * width_b
        and abs(cos_a * y - sin_a * x) <= width_a + sin * length_b + cos * width_b
        and abs(cos_b * x + sin_b * y) <= length_b + cos * length_a + sin * width_a
        and abs(cos_b * y - sin_b * x) <= width_b + sin * length_a + cos * width_a
    )
