"""Confidence: fitted probabilities mean what they say, and a bundle keeps what was fitted."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from page_export.calibration import (
    Examples,
    cross_fitted,
    examples_from,
    fitted,
    joined,
    write_confidence,
)
from page_runtime import Network
from page_runtime.confidence import FEATURES, ConfidenceModel
from page_runtime.validation.reliability import calibration_error, reliability


def drawn(count: int, seed: int = 0) -> tuple[Examples, np.ndarray]:
    """Examples whose truth is a logistic model, and its probabilities."""
    rng = np.random.default_rng(seed)
    X = rng.normal(size=(count, len(FEATURES))) * 10.0 ** rng.uniform(-2, 2, len(FEATURES)) + 3.0
    weights = rng.normal(size=len(FEATURES)) / X.std(axis=0)
    p = 1.0 / (1.0 + np.exp(-((X - X.mean(axis=0)) @ weights + 0.7)))
    return Examples(X, rng.random(count) < p, p), p


def test_a_fit_recovers_the_probabilities_the_truth_was_drawn_with() -> None:
    examples, p = drawn(6000)
    model = fitted(examples)
    found = np.array([model.probability(row) for row in examples.features])
    assert np.abs(found - p).mean() < 0.03


def test_what_is_said_to_be_right_with_nine_tenths_is_right_in_nine_of_ten() -> None:
    examples, _ = drawn(4000, seed=1)
    bins = reliability(cross_fitted(examples), examples.right)
    assert sum(b.count for b in bins) == 4000
    assert calibration_error(bins) < 0.04
    assert all(b.low <= b.confidence <= b.high for b in bins)


def test_few_or_one_sided_examples_are_refused() -> None:
    examples, _ = drawn(40)
    with pytest.raises(ValueError, match="at least 50 parts"):
        fitted(examples)
    examples, _ = drawn(200)
    with pytest.raises(ValueError, match="5 right and 5 wrong"):
        fitted(Examples(examples.features, np.ones(200, bool), examples.confidence))
    with pytest.raises(ValueError, match="got none"):
        joined([])


def test_a_model_of_the_wrong_length_is_refused() -> None:
    with pytest.raises(ValueError, match="calibrate the bundle again"):
        ConfidenceModel((1.0,), 0.0)


def test_a_bundle_gives_the_confidence_written_into_it(
    tmp_path: Path, oracle_bundle: Path, toy_recording: Path
) -> None:
    bundle = Path(shutil.copy(oracle_bundle, tmp_path))
    before = joined(list(examples_from(Network(bundle), toy_recording)))
    assert before.right.all()
    assert before.features.shape == (len(before.right), len(FEATURES))
    assert np.isfinite(before.features).all()
    model = ConfidenceModel((0.0, -1.0, 0.0, 0.0, 0.5, 0.0, 0.0, 0.0), -2.0)
    write_confidence(bundle, Network(bundle).metadata, model)
    network = Network(bundle)
    assert network.metadata.confidence == model
    after = joined(list(examples_from(network, toy_recording)))
    np.testing.assert_array_equal(after.features, before.features)
    np.testing.assert_allclose(after.confidence, [model.probability(row) for row in before.features])
