"""How likely a part's pose is right, from what the estimate shows of itself.

"Right" is within 5 degrees and 5 cm of the truth. A logistic regression on a few signs of trouble, fitted for each
bundle on validation frames (`page-export calibrate`), turns them into that probability. None of them is a place or a
length, but "right" counts centimetres: a category of much larger objects needs its own calibration.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from page_runtime.geometry import Array
from page_runtime.pose import PartPose

RIGHT_ROTATION_RAD = float(np.radians(5.0))
RIGHT_TRANSLATION_M = 0.05
# inliers: radii that agree with the pose; residual: their spread in the part's diagonals; rotation, translation:
# standard deviations, rad and diagonals; rival: support of the second pose; votes: highest peak's share; points: behind
# the pose; joint: how far the joints' other parts disagree, in standard deviations.
FEATURES = ("inliers", "residual", "rotation", "translation", "rival", "votes", "points", "joint")
# Beyond this disagreement is no worse: one of the two parts is wrong.
_MAX_DISAGREEMENT = 10.0


@dataclass(frozen=True, slots=True)
class ConfidenceModel:
    """P(right) = 1 / (1 + exp(-(offset + weights . features))), features in FEATURES' order."""

    weights: tuple[float, ...]
    offset: float

    def __post_init__(self) -> None:
        if len(self.weights) != len(FEATURES) or not np.isfinite([*self.weights, self.offset]).all():
            raise ValueError(
                f"confidence: expected {len(FEATURES)} finite weights ({', '.join(FEATURES)}) and an offset, "
                f"got {self.weights} and {self.offset}; calibrate the bundle again"
            )

    def probability(self, features: Array) -> float:
        """In (0, 1), of features (F,)."""
        return float(1.0 / (1.0 + np.exp(-np.clip(self.offset + np.dot(self.weights, features), -30.0, 30.0))))


def features(part: PartPose) -> Array:
    """(F,) signs of trouble of one part, unitless."""
    diagonal_m = float(np.linalg.norm(part.extents_m))
    variances = np.diagonal(part.covariance)
    return np.array([
        np.log(1.02 - part.inlier_share),
        np.log(1e-4 + part.residual_m / diagonal_m),
        0.5 * np.log(1e-8 + variances[:3].sum()),
        0.5 * np.log(1e-10 + variances[3:6].sum() / diagonal_m**2),
        part.runner_up_ratio,
        float(part.scores.mean()),
        np.log(part.num_points),
        np.log1p(min(part.disagreement, _MAX_DISAGREEMENT)),
    ])  # fmt: skip
