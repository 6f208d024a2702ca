"""What a pose from radii is really worth."""

from __future__ import annotations

import numpy as np

from page_runtime.geometry import Array

# The normal equations count every radius as a witness of its own, but a network that misjudges a pose makes radii that
# agree on it. Standard deviations of such an error, which all radii of a part share: about each axis [rad], along each
# [diagonals], of the log scale; and a factor on those of the normal equations. Of eight settings tried on the box's
# validation frames these were among the best; they are not the errors themselves, which gross failures make larger.
COMMON_ROTATION_RAD = 0.03
COMMON_TRANSLATION_UNIT = 0.01
COMMON_LOG_SCALE = 0.02
INFLATION = 5.0


def with_common_error(covariance: Array, scale_m: float) -> Array:
    """(7,7) the covariance of a `Registration` of diagonal scale_m, allowing for what its radii err in common."""
    common = np.repeat([COMMON_ROTATION_RAD, COMMON_TRANSLATION_UNIT * scale_m, COMMON_LOG_SCALE], [3, 3, 1])
    return INFLATION**2 * np.asarray(covariance, dtype=float) + np.diag(common**2)
