"""Is this a calibration of a real camera? What no camera can be is refused, with what it probably is instead.

Orthonormal rotations, determinant +1 and the shape of K are refused by page_runtime's own types; these are the checks
that need to know how cameras are built and mounted.
"""

from __future__ import annotations

import numpy as np

from page_calibration.calibration import CalibratedCamera, Calibration, CalibrationError, baseline_m
from page_runtime.image_files import SourceError
from page_runtime.recorded import require_central

# Focal length over the longer side of the picture: fisheyes of 200 degrees begin at 0.28, telephoto lenses end at 15.
FOCAL_SHARES = (0.2, 20.0)
# Pixels of every sensor in use are square to a few percent; anisotropic resizing of K is not a sensor.
MAX_ASPECT = 1.5
# Cameras of one rig hang on one piece of metal.
MAX_BASELINE_M = 5.0
# A camera and the world it is placed in.
MAX_DISTANCE_M = 200.0
# Share of the picture whose pixels the lens model cannot give a ray. Factory calibrations of wide lenses fold in the
# corners (up to 22 % of the picture in real ones); beyond this the coefficients are not this camera's.
MAX_FOLDED = 0.4
MIN_DEPTH_UNIT_M, MAX_DEPTH_UNIT_M = 1e-6, 1.0


def require_plausible(calibration: Calibration) -> Calibration:
    """`calibration` unchanged, or a CalibrationError that says which camera cannot be, and why."""
    for camera in calibration:
        _require_intrinsics(camera)
        _require_lens(camera)
        _require_place(camera)
    for i, a in enumerate(calibration):
        for b in calibration.cameras[i + 1 :]:
            if a.world_frame == b.world_frame:
                _require_baseline(calibration, a, b)
    return calibration


def _require_intrinsics(calibrated: CalibratedCamera) -> None:
    camera, where = calibrated.camera, f"camera {calibrated.frame!r}"
    if np.array_equal(camera.K, np.eye(3)):
        raise CalibrationError(
            f"{where}: K is the identity, which is what Open3D and some drivers give for a calibration they could not "
            "find; look for the missing file"
        )
    fx, fy = camera.K[0, 0], camera.K[1, 1]
    low, high = (share * max(camera.width, camera.height) for share in FOCAL_SHARES)
    if not (low <= fx <= high and low <= fy <= high):
        raise CalibrationError(
            f"{where}: focal lengths of {fx:.4g} and {fy:.4g} px are not those of a {camera.width}x{camera.height} "
            "picture; expected pixels, not mm or shares of the width, and K of this resolution"
        )
    if max(fx / fy, fy / fx) > MAX_ASPECT:
        raise CalibrationError(
            f"{where}: focal lengths {fx:.4g} and {fy:.4g} px differ by more than half; "
            "was K resized with another picture?"
        )
    try:
        require_central(camera, where=where)
    except SourceError as error:
        raise CalibrationError(str(error)) from error


def folded_share(calibrated: CalibratedCamera) -> float:
    """Share of the picture whose pixels have no ray in front of the camera."""
    camera = calibrated.camera
    u, v = (np.linspace(-0.5, size - 0.5, 33) for size in (camera.width, camera.height))
    rays = calibrated.raw.rays(np.stack(np.meshgrid(u, v), axis=-1))
    return float(np.isnan(rays).any(axis=-1).mean())


def lens_warnings(calibration: Calibration) -> tuple[str, ...]:
    """A sentence for each camera whose picture cannot be undistorted everywhere."""
    shares = {camera.frame: folded_share(camera) for camera in calibration}
    return tuple(
        f"the lens model of {frame!r} has no ray for {max(1, round(100 * share))} % of the picture, in its corners: "
        "nothing will be found there; views of the board that reach the corners would tell the model more"
        for frame, share in shares.items()
        if share > 0.0
    )


def _require_lens(calibrated: CalibratedCamera) -> None:
    share = folded_share(calibrated)
    if share > MAX_FOLDED:
        raise CalibrationError(
            f"camera {calibrated.frame!r}: its {calibrated.raw.distortion.model} distortion has no ray for "
            f"{100 * share:.0f} % of the picture; the coefficients are in another order or of another model, or K is "
            "of another resolution"
        )


def _require_place(calibrated: CalibratedCamera) -> None:
    distance = baseline_m(calibrated.camera.T_camera_world)
    if distance > MAX_DISTANCE_M:
        raise CalibrationError(
            f"camera {calibrated.frame!r}: {distance:.4g} m from {calibrated.world_frame!r}; expected metres, these "
            "are probably millimetres"
        )
    unit = calibrated.depth_unit_m
    if unit is not None and not MIN_DEPTH_UNIT_M <= unit <= MAX_DEPTH_UNIT_M:
        raise CalibrationError(
            f"camera {calibrated.frame!r}: one unit of depth is {unit:g} m; expected metres a unit, such as 0.001; "
            "a factor of units a metre is the inverse"
        )


def _require_baseline(calibration: Calibration, a: CalibratedCamera, b: CalibratedCamera) -> None:
    distance = baseline_m(calibration.transform(a.frame, b.frame))
    if distance > MAX_BASELINE_M and not calibration.provenance.format.startswith("BOP scene"):
        unit = "millimetres" if distance > 20 else "centimetres"
        raise CalibrationError(
            f"cameras {a.frame!r} and {b.frame!r} are {distance:.4g} m apart; expected metres on one rig, these are "
            f"probably {unit}"
        )
