"""Where the keypoints of a part are: by rule. `page-train keypoints` compares them with learned ones.

A trial (METHOD 9) found off-surface keypoints at 0.3 to 0.35 of the part's size best for plate-like parts: keypoints
on the surface or in the plate's plane double the rotation error, far ones dilute it.
"""

from __future__ import annotations

import numpy as np

from page_runtime.geometry import Array

NUM_VOTED = 3


def off_surface_keypoints() -> Array:
    """(8,3) keypoints in units of the part's diagonal, canonical frame.

    Three voted ones above the part, three below turned by 60 degrees, one beyond either end along x. No plane holds
    them all and no reflection maps the set to itself in order, so a mirrored pose never fits all eight radii
    (METHOD 12).
    """
    height, radius = 0.33, 0.33
    above = np.radians([90.0, 210.0, 330.0])
    below = np.radians([30.0, 150.0, 270.0])
    rings = [
        np.stack([radius * np.cos(angles), radius * np.sin(angles), np.full(3, z)], axis=1)
        for angles, z in ((above, height), (below, -height))
    ]
    return np.concatenate([*rings, [[0.6, 0.0, 0.0], [-0.5, 0.2, 0.1]]])
