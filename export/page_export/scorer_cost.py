"""What scoring inside the graph gives and costs, beside the numpy scorer, on real regions."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from time import perf_counter

import numpy as np
import onnxruntime as ort

from page_export.scorer_graph import CENTER, DISTINCT, OUTPUTS
from page_runtime.capture.playback import open_source
from page_runtime.estimator import first_look
from page_runtime.neighbours import find_neighbours
from page_runtime.network import Network, NetworkOutput, feeds
from page_runtime.part_poses import members_of, votes_of

_WARM_UP = 2


@dataclass(frozen=True, slots=True)
class ScorerCost:
    """regions and keypoints compared; within_voxel: share of the keypoints whose voxel in the graph is at most one
    voxel along each axis from one of the numpy scorer's tied ones; least_share: the fewest votes of the graph's voxel
    over the maximum. Median ms of a region: network alone, numpy scoring, network and scorer in one graph.
    """

    regions: int
    keypoints: int
    within_voxel: float
    least_share: float
    network_ms: float
    numpy_scoring_ms: float
    graph_ms: float


def measure_scorer(bundle: Network, graph: bytes, recording: Path, *, threads: int, limit: int = 50) -> ScorerCost:
    """Compare on up to `limit` regions of a recording; ValueError if no keypoint of any of them was voted for."""
    options = ort.SessionOptions()
    options.intra_op_num_threads = threads
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    session = ort.InferenceSession(graph, options, providers=["CPUExecutionProvider"])
    metadata = bundle.metadata
    times: list[tuple[float, float, float]] = []
    near: list[bool] = []
    shares: list[float] = []
    for frame, region in (
        (item.frame, instance.region) for item in open_source(recording) for instance in item.instances
    ):
        if len(times) == limit:
            break
        sample = None if region is None else first_look(bundle, frame, region).sample
        if sample is None:
            continue
        given = feeds(metadata, sample, find_neighbours(sample.points_camera - sample.center_camera))
        began = perf_counter()
        values = tuple(np.asarray(value, np.float32) for value in bundle.session.run(None, given))
        network_done = perf_counter()
        output = NetworkOutput.from_graph(values, metadata.category.region_radius_m)
        members = members_of(output, sample.num_distinct)
        votes = votes_of(members, sample.points_camera[: len(output.part_logits)], output, metadata)
        numpy_done = perf_counter()
        center = np.asarray(sample.center_camera, np.float32)[None]
        further = {CENTER: center, DISTINCT: np.array([sample.num_distinct], np.int64)}
        places, counts = (np.asarray(value)[0] for value in session.run(list(OUTPUTS), given | further))
        graph_done = perf_counter()
        times.append((network_done - began, numpy_done - network_done, graph_done - numpy_done))
        for part, own in votes.items():
            for place, count, vote in zip(places[part], counts[part], own, strict=True):
                if vote.peaks and vote.gap == 0:
                    away = np.abs(vote.ties_camera - place).max(axis=1).min()
                    near.append(bool(away <= 1.01 * metadata.voxel_m))
                    shares.append(float(count) / vote.max_votes)
    if not near:
        raise ValueError(f"{recording}: expected at least one region with keypoints to compare on")
    network_ms, scoring_ms, graph_ms = 1e3 * np.median(times[_WARM_UP:] or times, axis=0)
    return ScorerCost(
        regions=len(times),
        keypoints=len(near),
        within_voxel=float(np.mean(near)),
        least_share=min(shares),
        network_ms=float(network_ms),
        numpy_scoring_ms=float(scoring_ms),
        graph_ms=float(graph_ms),
    )
