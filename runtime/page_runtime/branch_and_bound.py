"""The voxels with the most votes, by branch and bound with the dense float64 accumulator's answer.

A cell of 2^l voxels a side cannot hold a voxel with more votes than the number of shells, thickened by half the
diagonal between the cell's outermost voxel centres, that the cell's centre lies in. Cells bounded below the best votes
known are dropped, the others split. A point without a vote in a cell has none in the cells within: voters are asked in
blocks, and a cell is dropped as soon as those asked and its parent's votes of the others are too few. All keypoints of
a frame advance together, a level at a time, because at 300 points a numpy call costs more than its arithmetic. The
bounds are float32, with the worst rounding possible; the votes reported are the float64 count of the defining formula.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from page_runtime.vote_shells import (
    Float32Array,
    FloatArray,
    IntArray,
    Shells,
    bands,
    count,
    count_blocks,
    exact_count,
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
# Bound the memory, to some 20 MB, where few points leave a wide plateau or radii agree on nothing.
_MAX_CELLS = 2**16
_MAX_CELLS_EACH = 2**13


@dataclass(frozen=True, eq=False, slots=True)
class Found:
    """Voxels (T, 3), lattice indices in C order, that have the most votes of those known; none where no voxel is known
    to have a vote. No voxel that was not searched has more votes than unsearched_bound, 0 if all were.
    """

    voxels: IntArray
    votes: int
    evaluations: int
    unsearched_bound: int


@dataclass(eq=False, slots=True)
class Race:
    """What is known so far of each of J keypoints: its best voxel (3, J) from the origin with its votes (J,);
    evaluations (J,); the bound of unsearched voxels (J,).
    """

    voxels: IntArray
    votes: IntArray
    evaluations: IntArray
    unsearched: IntArray

    @property
    def required(self) -> IntArray:
        """(J,) fewest votes of a voxel that is kept."""
        return np.maximum(self.votes, 1)

    def offer(self, voxels: IntArray, votes: IntArray, owner: NDArray[np.intp]) -> None:
        """Take the better of voxels (3, M) with at least `votes` (M,)."""
        for at in np.flatnonzero(votes > self.votes[owner]):
            keypoint = owner[at]
            if votes[at] > self.votes[keypoint]:
                self.votes[keypoint] = votes[at]
                self.voxels[:, keypoint] = voxels[:, at]

    def leave(self, cells: Cells) -> None:
        np.maximum.at(self.unsearched, cells.owner, cells.bounds)


WINDOW = cube(3) - 1


def search(shells: Shells, seeds: FloatArray, max_evaluations: int, deadline: float = math.inf) -> list[Found]:
    """For each of J keypoints the voxels of most votes, level by level from seeds (J, S, 3) m.

    Seeds only bound the search; they and the 27 voxels around the best are not part of the budget of max_evaluations
    for each keypoint. deadline: of `perf_counter`; the levels stop there.
    """
    starts, start_votes, race = _start(shells, seeds)
    race.evaluations += starts.shape[1] // len(shells) * shells.num_voters
    if perf_counter() >= deadline:
        race.unsearched += shells.num_voters
        nothing = no_cells(shells)
        return _founds(shells, nothing.corners, nothing.bounds, nothing.owner, race, starts, start_votes)
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

    cells, top = no_cells(shells), int(levels.max())
    level = top
    for level in range(top, -1, -1):
        possible = bands(shells, shells.half_diagonal_m * (2**level - 1), reach_m, at_least=True)
        parents = _affordable(shells, race, cells, budget, 8)
        joining = roots(shells, first, last, np.flatnonzero(levels == level), level)
        joining = _affordable(shells, race, joining, budget, 1)
        kept = []
        for block in _blocks(shells, parents, 8):
            if perf_counter() >= deadline:
                kept.append(parents[slice(block.start, None)])
                break
            kept.append(_sift(shells, possible, split(parents[block], level), level, race, deadline))
        for block in _blocks(shells, joining, 1):
            kept.append(_sift(shells, possible, joining[block], level, race, deadline))
        cells = joined(shells, kept)
        if perf_counter() >= deadline:
            break
        if level:
            cells = _probed(shells, certain, cells, level, race)
    if perf_counter() >= deadline:
        race.leave(cells)
        race.unsearched[levels < level] = shells.num_voters[levels < level]
        cells = no_cells(shells)
    voxels, votes, owner = _counted(shells, certain, cells, race, deadline)
    return _founds(shells, voxels, votes, owner, race, starts, start_votes)


def _start(shells: Shells, seeds: FloatArray) -> tuple[IntArray, IntArray, Race]:
    """Start voxels (3, J (S + 1)) of J keypoints with their votes, and the best of each."""
    keypoints, first = np.arange(len(shells)), np.array(shells.starts[:-1])
    # A voxel at the first shell has its vote, so that the best known is hardly ever none.
    first += np.array([np.isfinite(shells.radii_m[shells.columns(j)]).argmax() for j in range(len(shells))])
    lowest_m, highest_m = shells.rule.bounds_m(shells.voxel_m)
    on_shell = -0.5 * shells.lift[1:, first]
    on_shell[0] += np.maximum(shells.radii_m[first] + 0.5 * (lowest_m + highest_m), 0.0)
    # A seed may have diverged; 2^40 voxels is far from any, yet exact in int64 and float64.
    near = np.clip(seeds / shells.voxel_m - shells.origin.T[:, None], -(2.0**40), 2.0**40)
    starts = np.rint(np.concatenate(((on_shell / shells.voxel_m).T[:, None], near), axis=1)).astype(np.int64)
    num_starts = starts.shape[1]
    starts = starts.reshape(-1, 3).T
    votes = exact_count(shells, starts, np.repeat(keypoints, num_starts))
    best = votes.reshape(-1, num_starts).argmax(axis=1) + num_starts * keypoints
    zeros = np.zeros((2, len(shells)), np.int64)
    return starts, votes, Race(starts[:, best], votes[best], zeros[0], zeros[1])


def _affordable(shells: Shells, race: Race, cells: Cells, budget: IntArray, children: int) -> Cells:
    """The likeliest cells whose `children` each keypoint's budget and the memory allow; the others are left."""
    # Half of what is left for each level, that a search cut short still ends at voxels and their recount.
    allowed = (budget - race.evaluations) // 2 // shells.num_voters // children
    counts = np.bincount(cells.owner, minlength=len(shells))
    most = max(_MAX_CELLS, _MAX_CELLS_EACH * len(shells)) // children
    allowed = np.minimum(allowed, _largest_share(counts, most))
    excessive = np.flatnonzero(counts > allowed)
    if len(excessive) == 0:
        return cells
    edges = keypoint_edges(shells, cells.owner)
    left = np.zeros(len(cells), np.bool_)
    for j in excessive:
        order = np.argsort(-cells.bounds[edges[j] : edges[j + 1]], kind="stable")
        left[edges[j] + order[max(0, allowed[j]) :]] = True
    race.leave(cells[left])
    return cells[~left]


def _largest_share(counts: IntArray, total: int) -> int:
    """How many each may have at most of what it counts, so that together they have no more than the total."""
    if counts.sum() <= total:
        return total
    for taken, wanted in enumerate(np.sort(counts).tolist()):
        share = total // (len(counts) - taken)
        if wanted > share:
            return share
        total -= wanted
    return total


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


def _counted(
    shells: Shells, certain: Float32Array, cells: Cells, race: Race, deadline: float
) -> tuple[IntArray, IntArray, NDArray[np.intp]]:
    """The voxels that are left, their exact votes and owners; where both float32 bounds agree, they are those."""
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
    return np.delete(voxels, unsure, axis=1), np.delete(votes, unsure), np.delete(owner, unsure)


def _founds(
    shells: Shells,
    voxels: IntArray,
    votes: IntArray,
    owner: NDArray[np.intp],
    race: Race,
    starts: IntArray,
    start_votes: IntArray,
) -> list[Found]:
    """What is found of each keypoint, from voxels (3, M) with exact votes (M,) of keypoints `owner` (M,), ascending."""
    edges, num_starts = keypoint_edges(shells, owner), starts.shape[1] // len(shells)
    founds = []
    for j in range(len(shells)):
        mine = slice(edges[j], edges[j + 1])
        own_voxels, own_votes = voxels[:, mine], votes[mine]
        if race.unsearched[j]:
            # The best voxels known may be in cells that were left out.
            seeds, best = slice(j * num_starts, (j + 1) * num_starts), race.voxels[:, j, None]
            own_voxels = np.concatenate((own_voxels, starts[:, seeds], best), axis=1)
            best_votes = exact_count(shells, best, np.array([j]))
            own_votes = np.concatenate((own_votes, start_votes[seeds], best_votes))
        most = int(own_votes.max(initial=0))
        best = _sorted_rows(own_voxels[:, own_votes == max(most, 1)])
        founds.append(Found(best + shells.origin[:, j], most, int(race.evaluations[j]), int(race.unsearched[j])))
    return founds


def _sorted_rows(voxels: IntArray) -> IntArray:
    """The distinct ones (T, 3) of voxels (3, M), in C order."""
    voxels = voxels[:, np.lexsort(voxels[::-1])]
    fresh = np.ones(voxels.shape[1], np.bool_)
    fresh[1:] = (voxels[:, 1:] != voxels[:, :-1]).any(axis=0)
    return voxels[:, fresh].T
