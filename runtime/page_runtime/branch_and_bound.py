"""The voxels with the most votes, by branch and bound with the dense float64 accumulator's answer.

A cell of 2^l voxels a side cannot hold a voxel with more votes than the number of shells, thickened by half the
diagonal between the cell's outermost voxel centres, that the cell's centre lies in. Cells bounded below the best votes
known are dropped, the others split. A point without a vote in a cell has none in the cells within: voters are asked in
blocks, and a cell is dropped as soon as those asked and its parent's votes of the others are too few. All keypoints of
a frame advance together, a level at a time, because at 300 points a numpy call costs more than its arithmetic; more
cells than memory shall hold go on in batches, the most promising first and each down to its voxels. The bounds are
float32, with the worst rounding possible; the votes reported are the float64 count of the defining formula.
"""

import math
from collections.abc import Iterable
from itertools import pairwise
from time import perf_counter

import numpy as np

from page_runtime.vote_race import Counted, Found, Race, founds_of, start_race, ties_of
from page_runtime.vote_shells import (
    Float32Array,
    FloatArray,
    IntArray,
    Shells,
    bands,
    count,
    count_blocks,
    exact_counts,
    keypoint_edges,
    lifted,
    pigeonhole_box,
)
from page_runtime.voxel_cells import Cells, cube, joined, no_cells, roots, split, start_levels

_PROBED_AMONG = 256
_PROBED_CELLS = 8
_BLOCK_CELLS = 8192
# The clock is read before as many evaluations: a millisecond at most.
_BLOCK_EVALUATIONS = 2**21
# Bound the memory, to some 50 MB, where voxels are small, few points leave a wide plateau or radii agree on nothing: of
# the cells of a batch, whose children are at most eight times as many, and of the ties of a keypoint.
_BATCH_CELLS = 2**14
_MAX_TIES = 2**15


WINDOW = cube(3) - 1


def search(
    shells: Shells, seeds: FloatArray, max_evaluations: int, deadline: float = math.inf, full_share: float = 0.0
) -> list[Found]:
    """For each of J keypoints the voxels of most votes, level by level from seeds (J, S, 3) m.

    Seeds only bound the search; they and the 27 voxels around the best are not part of the budget of max_evaluations
    for each keypoint. deadline: of `perf_counter`; the levels stop there. full_share: of the votes; a keypoint whose
    best voxel known before has less gets so much less of its budget.
    """
    starts, start_votes, race = start_race(shells, seeds)
    race.evaluations += starts.shape[1] // len(shells) * shells.num_voters
    if perf_counter() >= deadline:
        race.unsearched += shells.num_voters
        return founds_of(shells, [], race, starts, start_votes)
    boxes = [pigeonhole_box(shells, j, votes) for j, votes in enumerate(race.required.tolist())]
    first, last = (np.stack(corners, axis=1) for corners in zip(*boxes, strict=True))
    levels = start_levels(last - first + 1)
    farthest = np.maximum(np.maximum(np.abs(first), np.abs(last)) + 2**levels, np.abs(race.voxels) + 2)
    reach_m = np.linalg.norm(farthest * shells.voxel_m, axis=0)
    certain = bands(shells, 0.0, reach_m, at_least=False)
    window = (race.voxels[:, :, None] + WINDOW[:, None, :]).reshape(3, -1)
    owner = np.repeat(np.arange(len(shells)), WINDOW.shape[1])
    race.offer(window, count(shells, certain, lifted(shells, window, 0), owner), owner)
    race.evaluations += WINDOW.shape[1] * shells.num_voters
    budget = race.evaluations + max_evaluations
    if full_share > 0.0:
        worth = np.minimum(race.votes / (full_share * shells.num_voters), 1.0)
        budget = race.evaluations + (worth * max_evaluations).astype(np.int64)

    top, lowest = int(levels.max()), int(levels.min())
    reached, possible, found = top + 1, {}, []
    pending = [(top, no_cells(shells))]
    while pending:
        level, parents = pending.pop()
        parents = parents[parents.bounds >= race.required[parents.owner]]
        if perf_counter() >= deadline:
            race.leave(parents)
            continue
        if level < reached:
            thickness_m = shells.half_diagonal_m * (2**level - 1)
            possible[level] = bands(shells, thickness_m, reach_m, at_least=True)
        joining = np.flatnonzero(levels == level) if level < reached else np.empty(0, np.intp)
        reached = min(level, reached)
        parents = _affordable(shells, race, parents, budget, 8)
        new = _affordable(shells, race, roots(shells, first, last, joining, level), budget, 1)
        cells = _descended(shells, possible[level], parents, new, level, race, deadline)
        if level:
            if perf_counter() < deadline:
                cells = _probed(shells, certain, cells, level, race)
            # Roots join the others as long as there is one batch.
            batches = _batches(cells, race) if level <= lowest else [cells]
            pending += [(level - 1, batch) for batch in batches]
            continue
        for block in _blocks(shells, cells, 1):
            if perf_counter() >= deadline:
                race.leave(cells[slice(block.start, None)])
                break
            found.append(_counted(shells, certain, cells[block], race, deadline))
        budget[ties_of(found, race) > _MAX_TIES] = 0
    late = levels < reached
    race.unsearched[late] = shells.num_voters[late]
    return founds_of(shells, found, race, starts, start_votes)


def _descended(
    shells: Shells, possible: Float32Array, parents: Cells, new: Cells, level: int, race: Race, deadline: float
) -> Cells:
    """The cells of `level` that can have the required votes, of those within the parents and of the new ones."""
    kept = []
    for block in _blocks(shells, parents, 8):
        if perf_counter() >= deadline:
            race.leave(parents[slice(block.start, None)])
            break
        kept.append(_sift(shells, possible, split(parents[block], level), level, race, deadline))
    for block in _blocks(shells, new, 1):
        kept.append(_sift(shells, possible, new[block], level, race, deadline))
    return joined(shells, kept)


def _batches(cells: Cells, race: Race) -> list[Cells]:
    """Of at most _BATCH_CELLS, the most promising last."""
    if len(cells) <= _BATCH_CELLS:
        return [cells]
    order = np.argsort(cells.bounds - race.required[cells.owner], kind="stable")
    return [cells[np.sort(rows)] for rows in np.array_split(order, -(-len(cells) // _BATCH_CELLS))]


def _affordable(shells: Shells, race: Race, cells: Cells, budget: IntArray, children: int) -> Cells:
    """The likeliest cells whose `children` each keypoint's budget allows; the others are left."""
    # Half of what is left for each level, that a search cut short still ends at voxels and their recount.
    allowed = np.maximum(budget - race.evaluations, 0) // 2 // shells.num_voters // children
    excessive = np.flatnonzero(np.bincount(cells.owner, minlength=len(shells)) > allowed)
    if len(excessive) == 0:
        return cells
    edges = keypoint_edges(shells, cells.owner)
    left = np.zeros(len(cells), np.bool_)
    for j in excessive:
        order = np.argsort(-cells.bounds[edges[j] : edges[j + 1]], kind="stable")
        left[edges[j] + order[allowed[j] :]] = True
    race.leave(cells[left])
    return cells[~left]


def _blocks(shells: Shells, cells: Cells, children: int) -> Iterable[slice]:
    most = min(_BLOCK_CELLS, _BLOCK_EVALUATIONS // int(shells.num_voters.max()))
    step = max(1, most // children)
    return (slice(begin, begin + step) for begin in range(0, len(cells), step))


def _sift(shells: Shells, possible: Float32Array, cells: Cells, level: int, race: Race, deadline: float) -> Cells:
    """Those of the cells that can have the required votes, once all voters are asked; at the deadline, so far."""
    centres = lifted(shells, cells.corners, level)
    slack = cells.bounds - race.required[cells.owner]
    rows, edges = np.arange(len(cells)), keypoint_edges(shells, cells.owner)
    for block in range(shells.num_blocks):
        if len(rows) == 0 or perf_counter() >= deadline:
            break
        counts = count_blocks(shells, possible, range(block, block + 1), centres, edges.tolist())
        race.evaluations += (edges[1:] - edges[:-1]) * shells.widths
        tally = cells.tallies[block]
        slack -= tally.take(rows)
        slack += counts
        tally[rows] = counts
        survives = np.flatnonzero(slack >= 0)
        rows, slack, edges = rows.take(survives), slack.take(survives), survives.searchsorted(edges)
        if block + 1 < shells.num_blocks:
            centres = centres.take(survives, axis=1)
    owner = cells.owner.take(rows)
    return Cells(
        cells.corners.take(rows, axis=1), owner, slack + race.required[owner], cells.tallies.take(rows, axis=1)
    )


def _probed(shells: Shells, certain: Float32Array, cells: Cells, level: int, race: Race) -> Cells:
    """The cells that survive when the centres of the likeliest are voxels too: a better one spares the levels below."""
    picks = [
        first + np.argpartition(-cells.bounds[first:last], _PROBED_CELLS)[:_PROBED_CELLS]
        for first, last in pairwise(keypoint_edges(shells, cells.owner).tolist())
        if last - first > _PROBED_AMONG
    ]
    if not picks:
        return cells
    rows = np.concatenate(picks)
    voxels, owner = cells.corners[:, rows] + (1 << level >> 1), cells.owner[rows]
    race.evaluations += np.bincount(owner, minlength=len(shells)) * shells.num_voters
    known = race.votes.copy()
    race.offer(voxels, count(shells, certain, lifted(shells, voxels, 0), owner), owner)
    return cells[cells.bounds >= race.required[cells.owner]] if (race.votes > known).any() else cells


def _counted(shells: Shells, certain: Float32Array, cells: Cells, race: Race, deadline: float) -> Counted:
    """Those of the cells, voxels, that have the most votes; where both float32 bounds agree, they are the votes."""
    voxels, owner = cells.corners, cells.owner
    votes = count(shells, certain, lifted(shells, voxels, 0), owner)
    race.evaluations += np.bincount(owner, minlength=len(shells)) * shells.num_voters
    unsure = np.flatnonzero(votes != cells.bounds)
    recounted = 0
    for where, exact in exact_counts(shells, voxels[:, unsure], owner[unsure]):
        votes[unsure[where]] = exact
        recounted = where.stop
        if perf_counter() >= deadline:
            break
    unsure = unsure[recounted:]
    race.leave(cells[unsure])
    # Whatever is not known exactly is not offered either.
    votes[unsure] = 0
    race.offer(voxels, votes, owner)
    most = votes >= race.required[owner]
    return Counted(voxels[:, most], votes[most], owner[most])
