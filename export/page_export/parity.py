"""Do two networks say the same? Outputs and final poses of both, on real samples."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from page_runtime.bundle import BundleMetadata
from page_runtime.estimator import sample_for
from page_runtime.evaluation import rotation_error, translation_error
from page_runtime.neighbours import Neighbours, find_neighbours
from page_runtime.network import NetworkOutput
from page_runtime.part_poses import pose_from_output
from page_runtime.pose import ArticulatedPose, NotSeen, PartPose
from page_runtime.recorded import Source
from page_runtime.sampling import RegionSample
from page_runtime.signature import OUTPUT_NAMES
from page_training.evaluate import torch_inputs
from page_training.network import NetworkInputs, PageNetwork

# Above these a bundle is another network than its checkpoint (float32 in another order mostly gives a tenth of them).
MAX_OUTPUT_DIFFERENCE = 1e-4
# Some samples magnify what float32 rounds: no bundle is asked to be nearer than the checkpoint in float32 is itself.
ROUNDINGS = 2.0
MAX_ROTATION_DEG = 0.02
MAX_TRANSLATION_MM = 0.1
# Of the parts, whose poses may jump. A pose follows from decisions (which points are the part's, which of two fits is
# better), and where two are as good a difference of 1e-6 decides. A door had 3 %, the shipped bundles none.
MAX_UNDECIDED_SHARE = 0.05
DISTURBANCES = 16
FRAMES = 50

Inputs = tuple[RegionSample, Neighbours]
# What a network makes of a sample: the graph's outputs in the order of OUTPUT_NAMES, batch of one.
Run = Callable[[RegionSample, Neighbours], tuple[NDArray[np.float32], ...]]


@dataclass(frozen=True, slots=True)
class Difference:
    """The largest and the mean of absolute differences."""

    max: float
    mean: float

    @staticmethod
    def of(values: list[float], means: list[float] | None = None) -> Difference:
        """Of single values, or of the largest and the mean of groups of one size."""
        means = values if means is None else means
        return Difference(max(values, default=0.0), float(np.mean(means)) if means else 0.0)


@dataclass(frozen=True, slots=True)
class Parity:
    """outputs: by the graph's name for them, absolute up to a value of 1 and relative above. rounding: by the same
    names, the largest difference that the checkpoint has in float32 from itself in float64. rotation_deg,
    translation_mm: where both have a pose.

    disagreements: parts that one of the two gives a pose for and the other does not. undecided: parts that are counted
    in none of these: the reference's own pose of them jumps by more than the bounds when its outputs are disturbed by
    no more than the largest difference of the two. parts: all of them.
    """

    samples: int
    outputs: dict[str, Difference]
    rounding: dict[str, float]
    rotation_deg: Difference
    translation_mm: Difference
    disagreements: int
    undecided: int
    parts: int

    @property
    def undecided_bound(self) -> float:
        """Share of the parts that may be undecided."""
        return MAX_UNDECIDED_SHARE

    def output_bound(self, name: str) -> float:
        """How far an output may be from the checkpoint's."""
        return max(MAX_OUTPUT_DIFFERENCE, ROUNDINGS * self.rounding[name])

    @property
    def holds(self) -> bool:
        """Whether the two are the same network, by this module's bounds."""
        return (
            all(difference.max <= self.output_bound(name) for name, difference in self.outputs.items())
            and self.rotation_deg.max <= MAX_ROTATION_DEG
            and self.translation_mm.max <= MAX_TRANSLATION_MM
            and self.disagreements == 0
            and self.undecided <= self.undecided_bound * self.parts
        )

    def document(self) -> dict[str, Any]:
        """In JSON's types, with the bounds."""

        def entry(difference: Difference, bound: float) -> dict[str, float]:
            return {"max": difference.max, "mean": difference.mean, "bound": bound}

        return {
            "samples": self.samples,
            "holds": self.holds,
            "outputs": {name: entry(value, self.output_bound(name)) for name, value in self.outputs.items()},
            "rounding": self.rounding,
            "rotation_deg": entry(self.rotation_deg, MAX_ROTATION_DEG),
            "translation_mm": entry(self.translation_mm, MAX_TRANSLATION_MM),
            "disagreements": self.disagreements,
            "undecided": self.undecided,
            "undecided_bound": self.undecided_bound,
            "parts": self.parts,
        }


def samples_of(metadata: BundleMetadata, source: Source, limit: int = FRAMES) -> Iterator[Inputs]:
    """What a network would be given for the first `limit` regions of `source` with depth; ValueError for none."""
    found = 0
    for recorded in source:
        for region in (instance.region for instance in recorded.instances if instance.region is not None):
            sample = sample_for(metadata, recorded.frame, region)
            if found == limit or isinstance(sample, str):
                continue
            found += 1
            yield sample, find_neighbours(sample.points_camera - sample.center_camera)
        if found == limit:
            return
    if found == 0:
        raise ValueError(f"{source.path}: expected at least one region with depth to compare on")


def checkpoint_run(metadata: BundleMetadata, network: PageNetwork, dtype: torch.dtype = torch.float64) -> Run:
    """A checkpoint's network as `Network.run_raw` would give its answers, computed in `dtype` on one thread.

    In float32 the reference would be off itself, and on some samples more than what it is compared with: of 50 frames
    of boxes, up to 1.7e-4 in a logit where the bundle is off by 4e-5.
    """
    exact = copy.deepcopy(network).to(dtype).eval()

    @torch.no_grad()
    def run(sample: RegionSample, neighbours: Neighbours) -> tuple[NDArray[np.float32], ...]:
        given = torch_inputs(metadata, sample, neighbours)
        before = torch.get_num_threads()
        torch.set_num_threads(1)
        try:
            outputs = exact(NetworkInputs(*(x.to(dtype) if x.is_floating_point() else x for x in given)))
        finally:
            torch.set_num_threads(before)
        return tuple(getattr(outputs, name).numpy().astype(np.float32) for name in OUTPUT_NAMES)

    return run


def compare(metadata: BundleMetadata, ours: Run, network: PageNetwork, samples: Iterable[Inputs]) -> Parity:
    """Run `ours` and a checkpoint's network on the samples."""
    theirs, rounded = checkpoint_run(metadata, network), checkpoint_run(metadata, network, torch.float32)
    worst: dict[str, list[float]] = {name: [] for name in OUTPUT_NAMES}
    mean: dict[str, list[float]] = {name: [] for name in OUTPUT_NAMES}
    rounding: dict[str, list[float]] = {name: [] for name in OUTPUT_NAMES}
    moved: list[tuple[float, float]] = []
    disagreements, undecided, count = 0, 0, 0
    for sample, neighbours in samples:
        count += 1
        pair = ours(sample, neighbours), theirs(sample, neighbours)
        for name, one, other, third in zip(OUTPUT_NAMES, *pair, rounded(sample, neighbours), strict=True):
            difference = _difference(other, one)
            worst[name].append(float(difference.max()))
            mean[name].append(float(difference.mean()))
            rounding[name].append(float(_difference(other, third).max()))
        reference = pose_of(metadata, sample, pair[1])
        found = _moves(reference, pose_of(metadata, sample, pair[0]))
        if not all(_within(move) for move in found):
            jumps = _jumps(metadata, sample, pair, reference, seed=count)
            undecided += sum(not _within(move) and jumps[k] for k, move in enumerate(found))
            found = [move for k, move in enumerate(found) if _within(move) or not jumps[k]]
        moved += [move for move in found if move is not None]
        disagreements += sum(move is None for move in found)
    return Parity(
        samples=count,
        outputs={name: Difference.of(worst[name], mean[name]) for name in OUTPUT_NAMES},
        rounding={name: max(values, default=0.0) for name, values in rounding.items()},
        rotation_deg=Difference.of([degrees for degrees, _ in moved]),
        translation_mm=Difference.of([mm for _, mm in moved]),
        disagreements=disagreements,
        undecided=undecided,
        parts=count * len(metadata.category.parts),
    )


def _difference(reference: NDArray[np.float32], other: NDArray[np.float32]) -> NDArray[np.floating]:
    """Of a value above 1 float32 keeps so much less behind the point."""
    return np.abs(other - reference) / np.maximum(1.0, np.abs(reference))


# Degrees and mm between two poses of a part, both 0 where neither has one, None where only one has.
_Move = tuple[float, float] | None


def _moves(one: ArticulatedPose, other: ArticulatedPose) -> list[_Move]:
    return [_move(*parts) for parts in zip(one.parts, other.parts, strict=True)]


def _move(one: PartPose | NotSeen, other: PartPose | NotSeen) -> _Move:
    if isinstance(one, PartPose) and isinstance(other, PartPose):
        return (
            float(np.degrees(rotation_error(one.T_camera_part, other.T_camera_part))),
            1e3 * float(translation_error(one.T_camera_part, other.T_camera_part)),
        )
    return (0.0, 0.0) if type(one) is type(other) else None


def _within(move: _Move) -> bool:
    return move is not None and move[0] <= MAX_ROTATION_DEG and move[1] <= MAX_TRANSLATION_MM


def _jumps(
    metadata: BundleMetadata,
    sample: RegionSample,
    pair: tuple[tuple[NDArray[np.float32], ...], tuple[NDArray[np.float32], ...]],
    reference: ArticulatedPose,
    *,
    seed: int,
) -> list[bool]:
    """Of each part, whether the reference's own pose leaves the bounds when its outputs, the second of the pair, are
    disturbed by the largest of their differences with random signs."""
    rng = np.random.default_rng(seed)
    jumps = [False] * len(reference.parts)
    for _ in range(DISTURBANCES):
        disturbed = tuple(
            (theirs + rng.choice((-1.0, 1.0), theirs.shape) * np.abs(ours - theirs).max()).astype(np.float32)
            for ours, theirs in zip(*pair, strict=True)
        )
        moves = _moves(reference, pose_of(metadata, sample, disturbed))
        jumps = [jump or not _within(move) for jump, move in zip(jumps, moves, strict=True)]
    return jumps


def pose_of(metadata: BundleMetadata, sample: RegionSample, values: tuple[NDArray[np.float32], ...]) -> ArticulatedPose:
    """The pose that a graph's outputs lead to."""
    return pose_from_output(metadata, sample, NetworkOutput.from_graph(values, metadata.category.region_radius_m))
