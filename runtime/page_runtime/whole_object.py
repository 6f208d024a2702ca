"""Whether an object is better explained as a whole than by its parts one by one, and then how.

Asked only where the parts make no sense: one with points has no pose, or two contradict their joint, and their points
are not where the poses have them.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from page_runtime.articulation import CONTRADICTION, Articulation, PartEvidence
from page_runtime.category import Category
from page_runtime.chain_fit import WholePose, whole_pose
from page_runtime.pieces import Piece, misfits
from page_runtime.registration import Observed
from page_runtime.similarity import Similarities
from page_runtime.template import Template

# Means over the parts of their misfits, 1 for a part that has no pose. Up to _EXPLAINED nothing is searched for: such
# contradictions are of sizes and joints, not of poses; of 63 frames in which the whole was the better answer (those of
# validation of drawers, staplers, eyeglasses and a Panda) three were below. By _BETTER the whole must fit better.
_EXPLAINED = 0.35
_BETTER = 0.03


def whole_instead(
    category: Category,
    observed: Sequence[Observed | str],
    poses: Sequence[Sequence[PartEvidence]],
    articulation: Articulation,
) -> WholePose | None:
    """All parts that joints tie together, placed at once, where that explains their points better; else None.

    observed, poses: of the category's parts, what is seen of each and the poses it may have by itself, none for one
    that has none; articulation: what was made of them.
    """
    pieces = [
        _piece(one, part.template) if isinstance(one, Observed) else None
        for one, part in zip(observed, category.parts, strict=True)
    ]
    seen = [k for k, piece in enumerate(pieces) if piece is not None]
    if len(seen) < 2 or not _in_trouble(seen, articulation):
        return None
    apart = {k: _misfit(pieces[k], articulation.parts[k]) for k in seen}
    if float(np.mean(list(apart.values()))) <= _EXPLAINED:
        return None
    known = {k: _similarities(own) for k, own in enumerate(poses) if own and k in seen}
    whole = whole_pose(category, pieces, known)
    if whole is None or len(whole.parts) < 2:
        return None
    better = float(np.mean([apart[k] for k in whole.parts]) - whole.misfit.mean())
    return whole if better > _BETTER else None


def _in_trouble(seen: Sequence[int], articulation: Articulation) -> bool:
    return any(articulation.parts[k] is None for k in seen) or any(
        state.disagreement is not None and not state.disagreement <= CONTRADICTION for state in articulation.joints
    )


def _piece(observed: Observed, template: Template | None) -> Piece | None:
    """None for a part without a surface or a size; of a size that the category's parts can have."""
    if template is None or not len(template.points_unit) or observed.diagonal_m is None:
        return None
    finite = np.isfinite(observed.points_camera).all(axis=1) & np.isfinite(observed.radii_m).all(axis=1)
    if not finite.any():
        return None
    return Piece(
        np.asarray(observed.points_camera, np.float64)[finite],
        np.asarray(observed.radii_m, np.float64)[finite],
        np.asarray(observed.keypoints_unit, np.float64),
        float(np.clip(observed.diagonal_m, *observed.scale_range_m)),
        template.stretched(np.asarray(observed.extents_unit, np.float64)),
    )


def _similarities(poses: Sequence[PartEvidence]) -> Similarities:
    T = np.array([pose.T_camera_part for pose in poses], np.float64)
    return Similarities(T[:, :3, :3], T[:, :3, 3], np.array([pose.scale_m for pose in poses]))


def _misfit(piece: Piece | None, evidence: PartEvidence | None) -> float:
    if piece is None or evidence is None:
        return 1.0
    pose = _similarities([evidence])
    return float(misfits(piece.sketch(), pose.R, pose.t)[0])
