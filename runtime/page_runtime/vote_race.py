"""What is known of the most votes of each keypoint while `branch_and_bound` searches, and what it found at the end."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from page_runtime.vote_shells import FloatArray, IntArray, Shells, exact_count
from page_runtime.voxel_cells import Cells


@dataclass(frozen=True, eq=False, slots=True)
class Found:
    """Voxels (T, 3), lattice indices in C order, that have the most votes of those known; none where no voxel is known
    to have a vote. No voxel that was not searched has more votes than unsearched_bound, 0 if all were.
    """

    voxels: IntArray
    votes: int
    evaluations: int
    unsearched_bound: int


@dataclass(frozen=True, eq=False, slots=True)
class Counted:
    """Voxels (3, M) from the origins of their keypoints owner (M,), ascending, and their exact votes (M,)."""

    voxels: IntArray
    votes: IntArray
    owner: NDArray[np.intp]


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


def start_race(shells: Shells, seeds: FloatArray) -> tuple[IntArray, IntArray, Race]:
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


def ties_of(found: Sequence[Counted], race: Race) -> IntArray:
    """(J,) voxels counted so far that have the most votes."""
    ties = np.zeros(len(race.votes), np.int64)
    for one in found:
        ties += np.bincount(one.owner[one.votes == race.votes[one.owner]], minlength=len(ties))
    return ties


def founds_of(
    shells: Shells, found: Sequence[Counted], race: Race, starts: IntArray, start_votes: IntArray
) -> list[Found]:
    """What is found of each keypoint, from the voxels counted."""
    num_starts = starts.shape[1] // len(shells)
    founds = []
    for j in range(len(shells)):
        # The best voxels known may be in cells that were left out.
        seeds, best = slice(j * num_starts, (j + 1) * num_starts), race.voxels[:, j, None]
        voxels = [starts[:, seeds], best] if race.unsearched[j] else []
        votes = [start_votes[seeds], exact_count(shells, best, np.array([j]))] if race.unsearched[j] else []
        for one in found:
            mine = slice(*one.owner.searchsorted((j, j + 1)))
            voxels.append(one.voxels[:, mine])
            votes.append(one.votes[mine])
        own_votes = np.concatenate([*votes, np.empty(0, np.int64)])
        own_voxels = np.concatenate([*voxels, np.empty((3, 0), np.int64)], axis=1)
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
