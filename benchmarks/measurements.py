"""What is measured of the scorer and of what follows it; every function returns figures for JSON."""

import math
import tracemalloc
from dataclasses import asdict
from typing import Any

import numpy as np
from benchmarks.figures import best_of, certified_share, distance_mm, figure, median, percentiles
from benchmarks.synthetic import KEYPOINT_DISTANCE_M, NUM_VOTED, SHAPES, Noise, suite
from benchmarks.trials import (
    RULES,
    WRONG_PEAK_M,
    Setting,
    argmax_kabsch,
    observed,
    pose_errors,
    pose_figures,
    register,
    score,
    transform_of,
)
from numpy.typing import NDArray
from tests.dense_accumulator import dense_votes
from tests.synthetic_parts import SyntheticPart

from page_runtime.part_poses import MAX_VOTERS
from page_runtime.registration import Registration, register_parts
from page_runtime.scoring import ONE_SIDED, KeypointVotes, score_keypoints, score_parts

FloatArray = NDArray[np.float64]

TOTAL_POINTS = 2048

MIS_SCALED = 1.03


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
