"""The steps of the scorer's benchmark: a quick run's and the whole sweep's."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from benchmarks.measurements import (
    TOTAL_POINTS,
    measure_equality,
    measure_frames,
    measure_memory,
    measure_mis_scaled,
    measure_parts,
)
from benchmarks.peers import measure_complete, measure_peers
from benchmarks.planar import measure_planar
from benchmarks.synthetic import KEYPOINT_DISTANCE_M, Noise
from benchmarks.trials import Setting

PARTS_OF_FRAME = (2, 4, 7)
CORRELATED_M = 0.008
BASE = Setting()
CORRELATED = Noise(correlated_m=CORRELATED_M)


@dataclass(frozen=True, slots=True)
class Step:
    """varies, value: what a step of the sweep changes of the base setting, for plots."""

    name: str
    work: Callable[[], dict[str, Any]]
    varies: str = ""
    value: float | str = ""


def quick_steps(
    *, cases: int = 20, parts: int = 12, frames: int = 5, repeats: int = 2, slab_evaluations: float = 1e7
) -> list[Step]:
    """The standard settings. The defaults take some ten seconds of CPU time; a test asks for less."""
    return [
        *_equality_steps(1, cases=cases),
        *_part_steps(parts=parts, repeats=repeats, other_repeats=1),
        *(_frame_step("mid", 0.005, k, frames=frames, repeats=repeats) for k in PARTS_OF_FRAME),
        *_single_steps(planar=parts, parts=parts),
        _peer_step("mid", 0.010, parts=4, slab_evaluations=slab_evaluations),
    ]


def full_steps() -> list[Step]:
    base = replace(BASE, parts=40)
    changes: list[tuple[str, float | str, Setting]] = [
        *(("points", n, replace(base, num_points=n)) for n in (64, 128, 256, 512, 1024, 2048)),
        *(("sigma_mm", 1e3 * s, replace(base, noise=Noise(sigma_m=s))) for s in (0.0, 0.002, 0.005, 0.010, 0.020)),
        *(("outliers", o, replace(base, noise=Noise(outliers=o))) for o in (0.0, 0.15, 0.40, 0.60)),
        *(
            (f"voxel_mm {name}", 1e3 * voxel_m, replace(base, distance=name, voxel_m=voxel_m))
            for name in KEYPOINT_DISTANCE_M
            for voxel_m in (0.002, 0.005, 0.010)
        ),
        *((f"shape {s}", s, replace(base, shapes=(s,), parts=16)) for s in base.shapes),
    ]
    return [
        *_equality_steps(10, cases=100),
        *_part_steps(parts=40, repeats=3, other_repeats=3),
        *(
            Step(f"{varies} {value:g}" if isinstance(value, float | int) else varies, _parts(setting), varies, value)
            for varies, value, setting in changes
        ),
        *(
            _frame_step(name, voxel_m, k, frames=12, repeats=3)
            for name in KEYPOINT_DISTANCE_M
            for voxel_m in (0.005, 0.010)
            for k in PARTS_OF_FRAME
        ),
        *_single_steps(planar=60, parts=40),
        *(
            _peer_step(name, voxel_m, parts=12, slab_evaluations=2e7)
            for name in KEYPOINT_DISTANCE_M
            for voxel_m in (0.002, 0.005, 0.010)
        ),
        # All points of a frame on one part: the exhaustive accumulators pay for each of them.
        _peer_step("mid", 0.010, parts=12, slab_evaluations=2e7, num_points=TOTAL_POINTS),
        Step("complete", lambda: measure_complete(replace(BASE, distance="near", voxel_m=0.010))),
    ]


def _parts(setting: Setting) -> Callable[[], dict[str, Any]]:
    return lambda: measure_parts(setting)


def _equality_steps(count: int, *, cases: int) -> list[Step]:
    return [Step(f"equality {i}", lambda seed=i: measure_equality(cases, seed=seed)) for i in range(count)]


def _part_steps(*, parts: int, repeats: int, other_repeats: int) -> list[Step]:
    """The standard setting is timed with `repeats`; a quick run reports no times of the others."""
    steps = []
    for name in KEYPOINT_DISTANCE_M:
        for kind, noise in (("independent", Noise()), ("correlated", CORRELATED)):
            times = repeats if (name, kind) == ("mid", "independent") else other_repeats
            setting = replace(BASE, distance=name, noise=noise, parts=parts, repeats=times)
            steps.append(Step(f"parts {name} {kind}", _parts(setting)))
    return steps


def _frame_step(distance: str, voxel_m: float, num_parts: int, *, frames: int, repeats: int) -> Step:
    return Step(
        f"frame {distance} {1e3 * voxel_m:g} mm K={num_parts}",
        lambda: measure_frames(distance, voxel_m, num_parts, frames=frames, repeats=repeats),
    )


def _single_steps(*, planar: int, parts: int) -> list[Step]:
    return [
        Step("planar independent", lambda: measure_planar(parts=planar)),
        Step("planar correlated", lambda: measure_planar(parts=planar, correlated_m=CORRELATED_M)),
        Step("mis-scaled", lambda: measure_mis_scaled(replace(BASE, parts=parts))),
        Step("memory", measure_memory),
    ]


def _peer_step(
    distance: str, voxel_m: float, *, parts: int, slab_evaluations: float, num_points: int = BASE.num_points
) -> Step:
    setting = replace(BASE, distance=distance, voxel_m=voxel_m, parts=parts, num_points=num_points)
    name = f"peers {distance} {1e3 * voxel_m:g} mm" + ("" if num_points == BASE.num_points else f" {num_points} points")
    return Step(name, lambda: measure_peers(setting, slab_evaluations=slab_evaluations))
