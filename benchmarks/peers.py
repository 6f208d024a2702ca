"""The scorer beside exhaustive accumulators; ratios divide CPU times measured in turn, in one process."""

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from importlib import import_module
from types import ModuleType
from typing import Any

import numpy as np
from benchmarks.accumulators import Grid, gemm_votes, grid_around, maximum
from benchmarks.figures import best_of, certified_share, distance_mm, figure, median
from benchmarks.synthetic import NUM_VOTED
from benchmarks.trials import RULES, RuleName, Setting, score
from numpy.typing import NDArray
from tests.synthetic_parts import SyntheticPart

from page_runtime.scoring import KeypointVotes

FloatArray = NDArray[np.float64]


def compiled_peers() -> tuple[ModuleType | None, str]:
    """The module of numba's accumulators, or None and what to do about it."""
    try:
        return import_module("benchmarks.compiled"), ""
    except ImportError as error:
        return None, f"left out: {error}; `pip install numba` adds the compiled peers"


@dataclass(frozen=True, slots=True)
class Peer:
    """An exhaustive accumulator: votes of a grid's voxels from points and radii, under one of RULES."""

    name: str
    what: str
    rule: RuleName
    votes: Callable[[NDArray[np.floating], NDArray[np.floating], Grid], NDArray[np.int32]]


def peers() -> tuple[list[Peer], str]:
    found = [
        Peer("gemm", "ours, exhaustive: numpy, float32 GEMM in cache-sized chunks, Eq. 16", "two-sided", gemm_votes)
    ]
    compiled, missing = compiled_peers()
    if compiled is not None:
        literal = "ours after the paper's Algorithm 1: numba, per-voxel loop, float64, one-sided, one thread"
        lifted = "ours, exhaustive: numba, float32 without roots, voxels side by side, Eq. 16, one thread"
        found.append(Peer("algorithm_1", literal, "one-sided", compiled.algorithm_1_votes))
        found.append(Peer("compiled", lifted, "two-sided", compiled.lifted_votes))
    return found, missing


def measure_peers(setting: Setting, *, slab_evaluations: float) -> dict[str, Any]:
    """The peers on a slab of each part's grid, extrapolated by evaluation count, beside the scorer on all of it, under
    the peer's rule."""
    found, missing = peers()
    ours = {name: _Ours(name) for name in RULES}
    all_evaluations, all_voxels = [], []
    cpu_ms: dict[str, list[float]] = {peer.name: [] for peer in found}
    per_evaluation_ns: dict[str, list[float]] = {peer.name: [] for peer in found}
    for part in setting.suite():
        radii_m = part.radii_m[:, 0]
        grid = grid_around(part.points_camera, radii_m, setting.voxel_m)
        evaluations = grid.voxels * setting.num_points
        before = {name: one.timed(part, setting) for name, one in ours.items()}
        for peer in found:
            if not per_evaluation_ns[peer.name]:
                peer.votes(part.points_camera, radii_m, next(grid.slabs(1000)))  # compiles
            cpu = _extrapolated_ms(peer, part, grid, setting.repeats, slab_evaluations)
            cpu_ms[peer.name].append(cpu)
            per_evaluation_ns[peer.name].append(1e6 * cpu / evaluations)
        for name, one in ours.items():
            # Once more after the peers, that both saw the same neighbours on the machine.
            one.cpu_ms.append(min(before[name], one.timed(part, setting)))
        all_evaluations.append(evaluations)
        all_voxels.append(grid.voxels)
    shape_of = np.array([setting.shapes[i % len(setting.shapes)] for i in range(len(all_voxels))])
    rows = {}
    for peer in found:
        ratio = np.array(cpu_ms[peer.name]) / ours[peer.rule].cpu_ms
        rows[peer.name] = {
            "what": peer.what,
            "rule": peer.rule,
            "cpu_ms_per_keypoint": median(cpu_ms[peer.name]),
            "extrapolated": True,
            "ns_per_evaluation": median(per_evaluation_ns[peer.name]),
            "ratio": median(ratio),
            "lowest_ratio": figure(ratio.min()),
            "highest_ratio": figure(ratio.max()),
            "ratio_of": {str(shape): median(ratio[shape_of == shape]) for shape in np.unique(shape_of)},
        }
    return {
        "setting": asdict(setting),
        "how": f"peers: a slab of {slab_evaluations:.0e} evaluations, times all evaluations / the slab's; CPU time",
        "exhaustive_evaluations": median(all_evaluations),
        "grid_voxels": median(all_voxels),
        "scorer": {name: one.figures() for name, one in ours.items()},
        "peers": rows,
        "missing": missing,
    }


def measure_complete(setting: Setting) -> dict[str, Any]:
    """The peers on the whole grid of one part, for the extrapolation of a slab of 2e7 evaluations and the maximum."""
    part = replace(setting, parts=1).suite()[0]
    radii_m, truth = part.radii_m[:, 0], part.keypoints_camera[0]
    grid = grid_around(part.points_camera, radii_m, setting.voxel_m)
    ours = {name: _Ours(name) for name in RULES}
    for one in ours.values():
        one.cpu_ms.append(one.timed(part, setting))
    found, missing = peers()
    rows: dict[str, Any] = {}
    for peer in found:
        peer.votes(part.points_camera, radii_m, next(grid.slabs(1000)))
        extrapolated = _extrapolated_ms(peer, part, grid, setting.repeats, 2e7)

        def whole(peer: Peer = peer) -> tuple[int, FloatArray]:
            return maximum(lambda piece: peer.votes(part.points_camera, radii_m, piece), grid, 40_000)

        (best, at), _, cpu = best_of(1, whole)
        rows[peer.name] = {
            "what": peer.what,
            "rule": peer.rule,
            "cpu_ms_per_keypoint": figure(cpu),
            "extrapolated": False,
            "extrapolated_cpu_ms": figure(extrapolated),
            "ratio": figure(cpu / ours[peer.rule].cpu_ms[0]),
            "max_votes": best,
            "voxel_error_mm": figure(distance_mm(at, truth)),
        }
    return {
        "setting": asdict(setting),
        "grid_voxels": grid.voxels,
        "scorer": {name: one.figures() for name, one in ours.items()},
        "scorer_max_votes": {name: one.votes[0].max_votes for name, one in ours.items()},
        "scorer_voxel_error_mm": {
            name: figure(distance_mm(one.votes[0].peaks[0].voxel_camera, truth)) for name, one in ours.items()
        },
        "peers": rows,
        "missing": missing,
    }


class _Ours:
    """The scorer under one rule, beside peers: its votes and its CPU time per keypoint."""

    def __init__(self, rule: RuleName) -> None:
        self.rule: RuleName = rule
        self.votes: list[KeypointVotes] = []
        self.cpu_ms: list[float] = []

    def timed(self, part: SyntheticPart, setting: Setting) -> float:
        votes, _, cpu = best_of(setting.repeats, lambda: score(part, setting.voxel_m, rule=RULES[self.rule]))
        self.votes += votes
        return cpu / NUM_VOTED

    def figures(self) -> dict[str, Any]:
        return {
            "cpu_ms_per_keypoint": median(self.cpu_ms),
            "evaluations_per_keypoint": median([float(one.evaluations) for one in self.votes]),
            "certified_share": certified_share([one.gap for one in self.votes]),
        }


def _extrapolated_ms(peer: Peer, part: SyntheticPart, grid: Grid, repeats: int, slab_evaluations: float) -> float:
    """CPU time of one keypoint on all of the grid, from a slab of so many evaluations."""
    radii_m = part.radii_m[:, 0]
    slab = grid.middle_slab(round(slab_evaluations / len(radii_m)))
    _, _, cpu = best_of(repeats, lambda: peer.votes(part.points_camera, radii_m, slab))
    return cpu * grid.voxels / slab.voxels
