"""Fitting a bundle's confidence on validation frames: of the parts said to be right with 0.9, nine in ten shall be."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import onnx
from numpy.typing import NDArray

from page_export.bundle_writer import bundle_bytes, write_file
from page_runtime.bundle import BundleMetadata
from page_runtime.capture.playback import open_source
from page_runtime.confidence import FEATURES, RIGHT_ROTATION_RAD, RIGHT_TRANSLATION_M, ConfidenceModel, features
from page_runtime.estimator import estimate
from page_runtime.evaluation import part_errors
from page_runtime.network import Network
from page_runtime.pose import PartPose

# Of the standardised weights' squares: a weight only a few frames speak for stays small.
_RIDGE = 1.0
_ROUNDS = 50
_LEAST_EXAMPLES = 50


@dataclass(frozen=True, eq=False, slots=True)
class Examples:
    """E estimated parts. features (E,F); right (E,) bool: within the tolerances of `confidence`; confidence (E,) as
    the bundle gave it."""

    features: NDArray[np.float64]
    right: NDArray[np.bool_]
    confidence: NDArray[np.float64]


def examples_from(network: Network, recording: Path) -> Iterator[Examples]:
    """One for each frame of a recording with truth: its visible parts that got a pose."""
    source = open_source(recording)
    if not source.has_truth:
        raise ValueError(f"{recording}: expected a recording with true poses, got {source.format} without")
    for recorded in source:
        rows, right, confidence = [], [], []
        for instance in recorded.instances:
            if instance.region is None or instance.truths is None:
                continue
            pose = estimate(network, recorded.frame, instance.region)
            hits = {
                error.name: error.within(RIGHT_ROTATION_RAD, RIGHT_TRANSLATION_M)
                for error in part_errors(network.metadata.category, pose, instance.truths)
            }
            for part in pose.parts:
                if isinstance(part, PartPose) and part.name in hits:
                    rows.append(features(part))
                    right.append(hits[part.name])
                    confidence.append(part.confidence)
        yield Examples(np.array(rows).reshape(len(rows), len(FEATURES)), np.array(right, bool), np.array(confidence))


def joined(examples: list[Examples]) -> Examples:
    """All of them as one."""
    filled = [e for e in examples if len(e.right)]
    if not filled:
        raise ValueError("calibration: expected estimated parts with truth, got none; is it the bundle's category?")
    return Examples(
        np.concatenate([e.features for e in filled]),
        np.concatenate([e.right for e in filled]),
        np.concatenate([e.confidence for e in filled]),
    )


def fitted(examples: Examples) -> ConfidenceModel:
    """Logistic regression with a small ridge by Newton's method. ValueError for too few examples of either kind."""
    right = examples.right.astype(float)
    if min(right.sum(), (1.0 - right).sum()) < 5 or len(right) < _LEAST_EXAMPLES:
        raise ValueError(
            f"calibration: expected at least {_LEAST_EXAMPLES} parts, 5 right and 5 wrong, got {int(right.sum())} "
            f"right of {len(right)}; give more validation frames"
        )
    mean, spread = examples.features.mean(axis=0), examples.features.std(axis=0)
    spread = np.where(spread > 1e-9, spread, 1.0)
    X = np.hstack([(examples.features - mean) / spread, np.ones((len(right), 1))])
    ridge = np.diag([_RIDGE] * (X.shape[1] - 1) + [0.0])
    w = np.zeros(X.shape[1])
    for _ in range(_ROUNDS):
        p = 1.0 / (1.0 + np.exp(-np.clip(X @ w, -30.0, 30.0)))
        hessian = X.T @ (X * (p * (1.0 - p))[:, None]) + ridge + 1e-9 * np.eye(len(w))
        w = w - np.linalg.solve(hessian, X.T @ (p - right) + ridge @ w)
    weights = w[:-1] / spread
    return ConfidenceModel(tuple(float(x) for x in weights), float(w[-1] - weights @ mean))


def cross_fitted(examples: Examples, folds: int = 5) -> NDArray[np.float64]:
    """(E,) confidence of each example by a model that has not seen its fold; folds are runs of frames."""
    fold = np.arange(len(examples.right)) * folds // len(examples.right)
    found = np.empty(len(examples.right))
    for k in range(folds):
        others = fold != k
        model = fitted(Examples(examples.features[others], examples.right[others], examples.confidence[others]))
        found[~others] = [model.probability(row) for row in examples.features[~others]]
    return found


def write_confidence(bundle: Path, metadata: BundleMetadata, model: ConfidenceModel | None) -> None:
    """Put the model into the bundle file, whole or not at all."""
    write_file(bundle_bytes(onnx.load(bundle), replace(metadata, confidence=model)), bundle)
