"""Calibrations in words."""

from __future__ import annotations

import numpy as np

from page_calibration.calibration import CalibratedCamera, Calibration, baseline_m
from page_runtime.geometry import rotation_angle


def readable(calibration: Calibration) -> str:
    """Everything in a calibration, for people."""
    provenance = calibration.provenance
    lines = [f"{provenance.source}: {provenance.format}, {len(calibration)} camera{'s' * (len(calibration) > 1)}"]
    for camera in calibration:
        lines += camera_lines(camera)
    for i, a in enumerate(calibration):
        for b in calibration.cameras[i + 1 :]:
            if a.world_frame == b.world_frame:
                T = calibration.transform(b.frame, a.frame)
                lines.append(f"{a.frame} to {b.frame}: {_place(T)}")
    lines += [f"note     {note}" for note in provenance.notes]
    lines += [f"warning  {warning}" for warning in provenance.warnings]
    return "\n".join(lines) + "\n"


def camera_lines(camera: CalibratedCamera) -> list[str]:
    """One camera, indented under its name."""
    K, lens, deviations = camera.camera.K, camera.raw.distortion, camera.deviations
    width, height = camera.camera.width, camera.camera.height
    fields = [np.degrees(2 * np.arctan(size / 2 / f)) for size, f in ((width, K[0, 0]), (height, K[1, 1]))]
    known = None if deviations is None else deviations.intrinsics_px
    values = [
        f"{name} {value:.3f}" + ("" if known is None else f" +- {known[i]:.3f}")
        for i, (name, value) in enumerate(zip(("fx", "fy", "cx", "cy"), K[[0, 1, 0, 1], [0, 1, 2, 2]], strict=True))
    ]
    lines = [
        camera.frame,
        f"  picture  {width}x{height}, {fields[0]:.1f} x {fields[1]:.1f} degrees without the lens",
        f"  K        {', '.join(values)} px",
        f"  lens     {lens.model} {' '.join(f'{value:.6g}' for value in lens.coefficients)}".rstrip(),
    ]
    if camera.world_frame != camera.frame:
        lines.append(f"  place    from {camera.world_frame}: {_place(camera.camera.T_camera_world)}")
    if deviations is not None and deviations.translation_m is not None and deviations.rotation_rad is not None:
        shift, turn = deviations.translation_m.max() * 1e3, np.degrees(deviations.rotation_rad.max())
        lines.append(f"           +- {shift:.2f} mm, {turn:.3f} degrees")
    if camera.depth_unit_m is not None:
        lines.append(f"  depth    {camera.depth_unit_m * 1e3:g} mm a unit")
    return lines


def _place(T: np.ndarray) -> str:
    x, y, z = T[:3, 3] * 1e3
    turn = np.degrees(float(rotation_angle(T[:3, :3], np.eye(3))))
    return f"({x:.2f}, {y:.2f}, {z:.2f}) mm, {baseline_m(T) * 1e3:.2f} mm in all, turned by {turn:.3f} degrees"
