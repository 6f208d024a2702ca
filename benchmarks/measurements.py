"""What is measured of the scorer and of what follows it; every function returns figures for JSON.

Wall times are those of a machine that may be busy, CPU times (`time.process_time`) suffer less from that; both are the
least of a few repeats. Ratios divide CPU times measured in turn, in one process.
"""

import math
import tracemalloc
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from importlib import import_module
from time import perf_counter, process_time
from types import ModuleType
from typing import Any, Literal, TypeVar

import numpy as np
from benchmarks.accumulators import Grid, gemm_votes, grid_around, maximum
from benchmarks.synthetic import KEYPOINT_DISTANCE_M, NUM_VOTED, SHAPES, Noise, suite
from numpy.typing import NDArray
from tests.dense_accumulator import dense_votes
from tests.synthetic_parts import SyntheticPart

from page_runtime.estimator import MAX_VOTERS
from page_runtime.geometry import rotation_angle, transform_from
from page_runtime.registration import Ambiguous, Observed, Registration, register_part, register_parts
from page_runtime.scoring import ONE_SIDED, TWO_SIDED, KeypointVotes, VoteRule, score_keypoints, score_parts
from page_runtime.similarity import umeyama

FloatArray = NDArray[np.float64]
T = TypeVar("T")
RuleName = Literal["two-sided", "one-sided"]

# Eq. 16 and the paper's Algorithm 1, by the names of the dense accumulator.
RULES: dict[RuleName, VoteRule] = {"two-sided": TWO_SIDED, "one-sided": ONE_SIDED}
SCALE_RANGE_M = (0.15, 1.1)
TOTAL_POINTS = 2048
MIS_SCALED = 1.03
# A voxel farther from the truth belongs to another mode: medians of keypoint errors are over the others.
WRONG_PEAK_M = 0.06
# Of a plate a position is right this near to the keypoint, or not at a wrong peak and nearer than to its mirror image.
RIGHT_M = 0.02
WRONG_SIDES = 0.2


@dataclass(frozen=True, slots=True)
class Setting:
    """Parts of a suite and how they are scored. num_points: of one part; voxel_m: rho."""

    distance: str = "mid"
    voxel_m: float = 0.005
    num_points: int = 512
    noise: Noise = field(default_factory=Noise)
    shapes: tuple[str, ...] = SHAPES
    parts: int = 16
    repeats: int = 3
    seed: int = 0

    def suite(self) -> list[SyntheticPart]:
        return suite(self.parts, self.distance, self.num_points, self.noise, seed=self.seed, shapes=self.shapes)


def best_of(repeats: int, work: Callable[[], T]) -> tuple[T, float, float]:
    """The result, the least wall time and the least CPU time, ms."""
    walls, processor = [], []
    while True:
        wall, cpu = perf_counter(), process_time()
        result = work()
        processor.append((process_time() - cpu) * 1e3)
        walls.append((perf_counter() - wall) * 1e3)
        if len(walls) >= repeats:
            return result, min(walls), min(processor)


def percentiles(values: Sequence[float]) -> dict[str, float | None]:
    return {"p50": figure(np.percentile(values, 50)), "p95": figure(np.percentile(values, 95))}


def figure(value: float | np.floating) -> float | None:
    """Four significant digits; None for what is not finite, such as the median error of poses mostly missing."""
    return float(f"{float(value):.4g}") if math.isfinite(value) else None


def median(values: Sequence[float] | FloatArray) -> float | None:
    return figure(np.percentile(values, 50, method="lower")) if len(values) else None


def certified_share(gaps: Sequence[int]) -> float | None:
    """Of keypoints whose maximum is certain to be the grid's; of others the evaluation budget ran out."""
    return figure(np.mean(np.array(gaps) == 0))


def score(part: SyntheticPart, voxel_m: float, **options: Any) -> tuple[KeypointVotes, ...]:
    return score_keypoints(part.points_camera, part.radii_m[:, :NUM_VOTED], voxel_m=voxel_m, **options)


def register(
    part: SyntheticPart,
    votes: tuple[KeypointVotes, ...],
    *,
    keypoints: int | None = None,
    box: bool = True,
    side_logits: FloatArray | None = None,
    kappa_scale: float = 1.0,
) -> Registration | Ambiguous | str:
    """Pose by `page_runtime`, on the radii of the first `keypoints`; without `box`, one that holds every point."""
    return register_part(observed(part, votes, keypoints, box, side_logits, kappa_scale))


def observed(
    part: SyntheticPart,
    votes: tuple[KeypointVotes, ...],
    keypoints: int | None = None,
    box: bool = True,
    side_logits: FloatArray | None = None,
    kappa_scale: float = 1.0,
) -> Observed:
    """What `register` gives the registration."""
    return Observed(
        part.points_camera,
        part.radii_m[:, :keypoints],
        kappa_scale * part.keypoints_unit[:keypoints],
        votes,
        part.extents_unit if box else np.full(3, 100.0),
        SCALE_RANGE_M,
        side_logits,
    )


def argmax_kabsch(
    part: SyntheticPart, votes: tuple[KeypointVotes, ...], *, kappa_scale: float = 1.0
) -> FloatArray | None:
    """T_camera_part the paper's way: Kabsch of the metric keypoints to their first arg-max voxels."""
    if any(not one.peaks for one in votes):
        return None
    source = kappa_scale * part.scale_m * part.keypoints_unit[: len(votes)]
    target = np.array([one.peaks[0].voxel_camera for one in votes])
    R = umeyama(source[None], target[None]).R[0]
    return np.asarray(transform_from(R, target.mean(axis=0) - R @ source.mean(axis=0)), np.float64)


def pose_errors(T_camera_part: FloatArray | None, part: SyntheticPart) -> tuple[float, float, float]:
    """Degrees, millimetres of the origin, mean millimetres of the visible points (ADD); infinite without a pose."""
    if T_camera_part is None:
        return math.inf, math.inf, math.inf
    R, t = T_camera_part[:3, :3], T_camera_part[:3, 3]
    moved = (part.points_camera - part.t) @ part.R @ R.T + t - part.points_camera
    return (
        float(np.degrees(rotation_angle(R, part.R))),
        float(1e3 * np.linalg.norm(t - part.t)),
        float(1e3 * np.linalg.norm(moved, axis=1).mean()),
    )


def transform_of(result: Registration | Ambiguous | str) -> FloatArray | None:
    return result.T_camera_part if isinstance(result, Registration) else None


def pose_figures(errors: list[tuple[float, float, float]]) -> dict[str, Any]:
    """Medians with a missing pose as an infinite error, and the share of those missing."""
    rotation_deg, translation_mm, add_mm = np.array(errors).T
    return {
        "rotation_deg": median(rotation_deg),
        "translation_mm": median(translation_mm),
        "add_mm": median(add_mm),
        "add_p90_mm": figure(np.percentile(add_mm, 90, method="lower")),
        "without_pose": figure(np.mean(~np.isfinite(add_mm))),
    }


def measure_parts(setting: Setting) -> dict[str, Any]:
    """Time, keypoint error and pose error of the parts of a setting."""
    wall_ms, cpu_ms, registration_ms, evaluations, gaps, ties = [], [], [], [], [], []
    errors: dict[str, list[float]] = {name: [] for name in ("voxel", "voxel_one_sided", "refined", "registered")}
    poses: dict[str, list[tuple[float, float, float]]] = {}

    def add_pose(name: str, T_camera_part: FloatArray | None, part: SyntheticPart) -> None:
        poses.setdefault(name, []).append(pose_errors(T_camera_part, part))

    parts = setting.suite()
    score(parts[0], setting.voxel_m)
    for part in parts:
        votes, wall, cpu = best_of(setting.repeats, lambda part=part: score(part, setting.voxel_m))
        result, wall_registration, _ = best_of(setting.repeats, lambda p=part, v=votes: register(p, v))
        wall_ms.append(wall / NUM_VOTED)
        cpu_ms.append(cpu / NUM_VOTED)
        registration_ms.append(wall_registration)
        for j, one in enumerate(votes):
            truth = part.keypoints_camera[j]
            evaluations.append(one.evaluations)
            gaps.append(one.gap)
            ties.append(one.ties)
            errors["voxel"].append(distance_mm(one.peaks[0].voxel_camera, truth) if one.peaks else math.inf)
            errors["refined"].append(distance_mm(one.peaks[0].position_camera, truth) if one.peaks else math.inf)
            posed = isinstance(result, Registration)
            placed = distance_mm(result.keypoints_camera[j], truth) if posed else math.inf
            errors["registered"].append(placed)
        add_pose("argmax_kabsch", argmax_kabsch(part, votes), part)
        add_pose("refined", transform_of(result), part)
        add_pose("refined_three_keypoints", transform_of(register(part, votes, keypoints=NUM_VOTED)), part)
        one_sided = score(part, setting.voxel_m, rule=ONE_SIDED)
        add_pose("argmax_kabsch_one_sided", argmax_kabsch(part, one_sided), part)
        errors["voxel_one_sided"] += [
            distance_mm(one.peaks[0].voxel_camera, part.keypoints_camera[j]) if one.peaks else math.inf
            for j, one in enumerate(one_sided)
        ]
    right = np.array(errors["voxel"]) <= 1e3 * WRONG_PEAK_M
    shape_of = np.repeat([setting.shapes[i % len(setting.shapes)] for i in range(len(parts))], NUM_VOTED)
    return {
        "setting": asdict(setting),
        "ms_per_keypoint": percentiles(wall_ms),
        "cpu_ms_per_keypoint": percentiles(cpu_ms),
        "registration_ms": percentiles(registration_ms),
        "evaluations_per_keypoint": percentiles(evaluations),
        "certified_share": certified_share(gaps),
        "mean_ties": figure(np.mean(ties)),
        "keypoint_mm": {name: median(np.array(values)[right]) for name, values in errors.items()},
        "wrong_peak_share": figure(np.mean(~right)),
        "wrong_peak_share_of": {
            str(shape): figure(np.mean(~right[shape_of == shape])) for shape in np.unique(shape_of)
        },
        "pose": {name: pose_figures(values) for name, values in poses.items()},
    }


def distance_mm(one: FloatArray, other: FloatArray) -> float:
    return float(1e3 * np.linalg.norm(one - other))


def measure_frames(distance: str, voxel_m: float, num_parts: int, *, frames: int, repeats: int) -> dict[str, Any]:
    """Frames of TOTAL_POINTS in num_parts equal parts of turning shapes: all their keypoints, then all their poses."""
    scoring_ms, scoring_cpu_ms, capped_ms, single_ms, both_ms, evaluations, gaps = [], [], [], [], [], [], []
    num_points = TOTAL_POINTS // num_parts
    capping = num_points > MAX_VOTERS
    score(suite(1, distance, num_points, Noise(), seed=1000)[0], voxel_m)  # warms caches
    for frame in range(frames):
        parts = suite(num_parts, distance, num_points, Noise(), seed=1000 + frame)

        def scored(
            parts: list[SyntheticPart] = parts, voters: int | None = None
        ) -> tuple[tuple[KeypointVotes, ...], ...]:
            given = [(part.points_camera[:voters], part.radii_m[:voters, :NUM_VOTED]) for part in parts]
            return score_parts(given, voxel_m=voxel_m)

        votes, wall, cpu = best_of(repeats, scored)
        capped = best_of(1, lambda scored=scored: scored(voters=MAX_VOTERS))[1] if capping else wall
        _, single, _ = best_of(1, lambda parts=parts: [score(part, voxel_m) for part in parts])
        _, registration, _ = best_of(
            repeats, lambda parts=parts, votes=votes: register_parts(list(map(observed, parts, votes)))
        )
        scoring_ms.append(wall)
        scoring_cpu_ms.append(cpu)
        capped_ms.append(capped)
        single_ms.append(single)
        both_ms.append(wall + registration)
        evaluations.append(sum(one.evaluations for part in votes for one in part))
        gaps += [one.gap for part in votes for one in part]
    return {
        "distance": distance,
        "voxel_m": voxel_m,
        "parts": num_parts,
        "points": TOTAL_POINTS,
        "points_per_part": num_points,
        "frames": frames,
        "ms": percentiles(scoring_ms),
        "cpu_ms": percentiles(scoring_cpu_ms),
        "ms_with_the_estimators_voters": {"at_most": MAX_VOTERS, **percentiles(capped_ms)},
        "ms_part_by_part": percentiles(single_ms),
        "scoring_plus_registration_ms": percentiles(both_ms),
        "evaluations": percentiles(evaluations),
        "certified_share": certified_share(gaps),
    }


def measure_equality(cases: int, *, seed: int) -> dict[str, Any]:
    """Share of random problems on coarse grids in which the scorer's maximum, tie set and first peak are those of the
    dense float64 reference: all shapes and distances, noise to two voxels, up to 60 % outliers."""
    failures = dict.fromkeys(RULES, 0)
    voxels = []
    for case in range(cases):
        rng = np.random.default_rng([seed, case])
        voxel_m = float(rng.uniform(0.04, 0.08))
        noise = Noise(
            sigma_m=voxel_m * float(rng.choice([0.0, 0.2, 0.6, 2.0])),
            outliers=float(rng.choice([0.0, 0.15, 0.4, 0.6])),
            correlated_m=voxel_m * float(rng.choice([0.0, 1.0])),
        )
        shape, distance = str(rng.choice(SHAPES)), str(rng.choice(list(KEYPOINT_DISTANCE_M)))
        part = suite(1, distance, int(rng.integers(8, 160)), noise, seed=int(rng.integers(2**31)), shapes=(shape,))[0]
        radii_m = part.radii_m[:, 0]
        for rule, of_scorer in RULES.items():
            votes = score_keypoints(part.points_camera, radii_m[:, None], voxel_m=voxel_m, rule=of_scorer)[0]
            dense = dense_votes(part.points_camera, radii_m, voxel_m, rule=rule)
            voxels.append(dense.votes.size)
            equal = (
                votes.gap == 0
                and votes.max_votes == dense.max_votes
                and np.array_equal(votes.ties_camera, dense.ties_camera)
                and bool(votes.peaks)
                and np.array_equal(votes.peaks[0].voxel_camera, dense.ties_camera[0])
            )
            failures[rule] += not equal
    return {
        "cases": cases,
        "mismatches": failures,
        "compared": "maximum, tie set and arg-max with tests/dense_accumulator.py, float64, every voxel",
        "largest_grid_voxels": max(voxels),
    }


def measure_planar(*, parts: int, correlated_m: float = 0.0, voxel_m: float = 0.005) -> dict[str, Any]:
    """Plates: whether the keypoint is among the listed modes, and which evidence tells it from its mirror image.

    The evidence is added step by step: radii and triangle of three keypoints, the part's box (template), sides of
    which WRONG_SIDES are wrong, the other five keypoints. The last is what the runtime uses.
    """
    steps = ("triangle", "template", "sides", "eight_keypoints")
    right: dict[str, list[bool]] = {name: [] for name in ("argmax", *steps, "eight_keypoints_without_sides")}
    ambiguous: dict[str, list[bool]] = {name: [] for name in right}
    listed: list[bool] = []
    decided: dict[str, int] = dict.fromkeys((*steps, "none"), 0)
    plates = suite(parts, "mid", 512, Noise(correlated_m=correlated_m), seed=7, shapes=("plate",))
    for i, part in enumerate(plates):
        rng = np.random.default_rng([7, i])
        votes, truths = score(part, voxel_m), part.keypoints_camera[:NUM_VOTED]
        images = truths - 2.0 * ((truths - part.t) @ part.R[:, 2:]) * part.R[:, 2]
        for one, truth, image in zip(votes, truths, images, strict=True):
            listed.append(any(_is_right(peak.position_camera, truth, image) for peak in one.peaks))
        first = [one.peaks[0].position_camera if one.peaks else np.full(3, np.inf) for one in votes]
        flipped = np.where(rng.random((len(part.radii_m), NUM_VOTED)) < WRONG_SIDES, -1.0, 1.0)
        sides = 3.0 * flipped * part.sides[:, :NUM_VOTED]
        results = {
            "triangle": register(part, votes, keypoints=NUM_VOTED, box=False),
            "template": register(part, votes, keypoints=NUM_VOTED),
            "sides": register(part, votes, keypoints=NUM_VOTED, side_logits=sides),
            "eight_keypoints": register(part, votes, side_logits=sides),
            "eight_keypoints_without_sides": register(part, votes),
        }
        right["argmax"].append(all(map(_is_right, first, truths, images)))
        ambiguous["argmax"].append(False)
        for name, result in results.items():
            placed = list(result.keypoints_camera[:NUM_VOTED]) if isinstance(result, Registration) else []
            right[name].append(bool(placed) and all(map(_is_right, placed, truths, images)))
            ambiguous[name].append(isinstance(result, Ambiguous))
        decided[next((name for name in steps if right[name][-1]), "none")] += 1
    return {
        "truth_listed": figure(np.mean(listed)),
        "chosen": figure(np.mean(right["eight_keypoints"])),
        "ambiguous": figure(np.mean(ambiguous["eight_keypoints"])),
        "right_with": {name: figure(np.mean(values)) for name, values in right.items()},
        "ambiguous_with": {name: figure(np.mean(values)) for name, values in ambiguous.items()},
        "decided_by": {name: figure(count / parts) for name, count in decided.items()},
        "plates": parts,
        "correlated_m": correlated_m,
        "meaning": (
            f"right: within {RIGHT_M} m, or within {WRONG_PEAK_M} m and nearer than to the mirror image; a pose is if "
            "its three voted keypoints are; decided_by: first step of evidence with which the pose is right"
        ),
    }


def _is_right(position: FloatArray, truth: FloatArray, image: FloatArray) -> bool:
    error_m = float(np.linalg.norm(position - truth))
    nearer = error_m < float(np.linalg.norm(position - image))
    return error_m <= RIGHT_M or (error_m <= WRONG_PEAK_M and nearer)


def measure_mis_scaled(setting: Setting) -> dict[str, Any]:
    """What keypoints that are 3 % too large cost a rigid fit and the registration with scale."""
    kinds = ("argmax_kabsch", "refined")
    errors: dict[str, dict[float, list[float]]] = {kind: {1.0: [], MIS_SCALED: []} for kind in kinds}
    for part in setting.suite():
        votes = score(part, setting.voxel_m)
        for factor in (1.0, MIS_SCALED):
            rigid = argmax_kabsch(part, votes, kappa_scale=factor)
            scaled = transform_of(register(part, votes, kappa_scale=factor))
            errors["argmax_kabsch"][factor].append(pose_errors(rigid, part)[2])
            errors["refined"][factor].append(pose_errors(scaled, part)[2])
    figures: dict[str, Any] = {"scale": MIS_SCALED, "error": "mean mm of the visible points (ADD), median over parts"}
    for kind, by_factor in errors.items():
        plain, scaled = (float(np.percentile(by_factor[factor], 50, method="lower")) for factor in (1.0, MIS_SCALED))
        figures[kind] = {"add_mm": figure(plain), "extra_mm": figure(scaled - plain)}
    return figures


def measure_memory(voxel_m: float = 0.005) -> dict[str, Any]:
    """Peak of allocations while one part's three keypoints are scored, beyond its inputs."""
    peaks = {}
    for num_points in (512, 1024):
        part = suite(1, "mid", num_points, Noise(), seed=0)[0]
        score(part, voxel_m)
        tracemalloc.start()
        score(part, voxel_m)
        peaks[f"points_{num_points}_mb"] = figure(tracemalloc.get_traced_memory()[1] / 1e6)
        tracemalloc.stop()
    return peaks


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
