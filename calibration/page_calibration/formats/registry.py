"""Any calibration file in, camera.json's contents out; and back, with what the other format could not take."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from page_calibration.calibration import CalibratedCamera, Calibration, CalibrationError, Provenance
from page_calibration.camera_json import FORMAT, from_document, to_json
from page_calibration.formats.bop import DATASET, SCENE
from page_calibration.formats.contract import Format
from page_calibration.formats.document import Document, Size, open_document, parse_document
from page_calibration.formats.kalibr import KALIBR
from page_calibration.formats.oak import OAK
from page_calibration.formats.open3d import INTRINSIC, PARAMETERS
from page_calibration.formats.opencv import OPENCV
from page_calibration.formats.orb_slam import ORB_SLAM
from page_calibration.formats.ros import ROS_INI, ROS_MESSAGE, ROS_YAML
from page_calibration.plausibility import lens_warnings, require_plausible
from page_runtime.lens import Distortion

# In the order they are tried; each recognises names that none before it has.
FORMATS: tuple[Format, ...] = (
    OAK, ROS_YAML, ROS_MESSAGE, ROS_INI, KALIBR, INTRINSIC, PARAMETERS, DATASET, SCENE, ORB_SLAM, OPENCV,
)  # fmt: skip
OWN = "page"
NAMES = (OWN, *(format.name for format in FORMATS))
KEPT = 1e-9


def read_calibration(path: Path | str, *, size: Size | None = None) -> Calibration:
    """The calibration in a file, in metres and OpenCV axes, whatever program wrote it.

    size: (width, height) in pixels, for formats that do not say. CalibrationError names what is wrong with the file:
    not understood, cut off, a rotation that is none, K of another resolution, another unit, too old.
    """
    document = open_document(Path(path), size=size)
    try:
        return require_plausible(_read(document))
    except ValueError as error:
        text = str(error)
        raise CalibrationError(text if text.startswith(str(path)) else f"{path}: {text}") from error


def _read(document: Document) -> Calibration:
    if document.has("format") and document.data["format"] == FORMAT:
        return from_document(document.data, where=str(document.path))
    for format in FORMATS:
        if format.recognises(document):
            read = format.read(document)
            calibration = Calibration(
                read.cameras, Provenance(format.title, document.path.name, read.notes, read.warnings)
            )
            warnings = (*read.warnings, *lens_warnings(calibration))
            return replace(calibration, provenance=replace(calibration.provenance, warnings=warnings))
    raise CalibrationError(f"{document.path}: {_what_it_may_be(document)}")


def _what_it_may_be(document: Document) -> str:
    understood = f"understood are camera.json and {', '.join(format.title for format in FORMATS)}"
    if document.has("rows", "cols", "data"):
        return (
            "one matrix without a name, a pose rather than a camera (page-calibrate hand-eye takes ViSP's); "
            + understood
        )
    lines = [line for line in document.text.splitlines() if line and not line.startswith("#")]
    try:
        for line in lines:
            float(line)
        return f"{len(lines)} bare numbers, and nothing says which is which; " + understood
    except ValueError:
        pass
    if all(len(line.split()) == 4 and "/" in line for line in lines):
        return "a list of timestamps and pictures (TUM associations), not a calibration; " + understood
    return "not a calibration known here; " + understood


@dataclass(frozen=True, slots=True)
class Written:
    """The text of a file. lost: what its format cannot hold, in words, without which points are projected elsewhere or
    measured otherwise. left_out: names and standard deviations it cannot hold."""

    text: str
    lost: tuple[str, ...] = ()
    left_out: tuple[str, ...] = ()


def written(calibration: Calibration, name: str) -> Written:
    """The calibration in the format called `name` (NAMES), read again to find what did not survive."""
    if name == OWN:
        return Written(to_json(calibration))
    format = next((format for format in FORMATS if format.name == name), None)
    if format is None:
        raise CalibrationError(f"no format {name!r}; there are {', '.join(NAMES)}")
    text = format.write(calibration)
    path = Path(f"{format.name}{format.suffix}")
    data = parse_document(path, text)
    lost = []
    try:
        again = format.read(Document(path, text, data)).cameras
    except CalibrationError:
        first = calibration.cameras[0].camera
        size = first.width, first.height
        again = format.read(Document(path, text, data, size)).cameras
        lost.append("the picture size")
    left_out: list[str] = []
    for i, camera in enumerate(calibration):
        if i >= len(again):
            lost.append(f"the camera {camera.frame!r}")
            continue
        lost += _lost(camera, again[i])
        if again[i].frame != camera.frame:
            left_out.append(f"the name {camera.frame!r}, now {again[i].frame!r}")
        is_alone = camera.world_frame == camera.frame and again[i].world_frame == again[i].frame
        if again[i].world_frame != camera.world_frame and not is_alone:
            left_out.append(
                f"the name of {camera.frame!r}'s world, {camera.world_frame!r}, now {again[i].world_frame!r}"
            )
        if camera.deviations is not None:
            left_out.append(f"the standard deviations of {camera.frame!r}")
    return Written(text, tuple(lost), tuple(left_out))


def _lost(before: CalibratedCamera, after: CalibratedCamera) -> Iterator[str]:
    frame = before.frame
    a, b = before.camera, after.camera
    if (a.width, a.height) != (b.width, b.height):
        yield f"the picture size of {frame!r}"
    if np.abs(a.K - b.K).max() > KEPT:
        yield f"the skew of {frame!r}" if a.K[0, 1] != b.K[0, 1] else f"the K of {frame!r}"
    if not same_lens(before.raw.distortion, after.raw.distortion):
        yield f"the {before.raw.distortion.model} distortion of {frame!r}"
    if np.abs(a.T_camera_world - b.T_camera_world).max() > KEPT:
        yield f"where {frame!r} is in {before.world_frame!r}"
    if (before.depth_unit_m or 0.0) != (after.depth_unit_m or 0.0) and not np.isclose(
        before.depth_unit_m or 0.0, after.depth_unit_m or 0.0, rtol=KEPT, atol=0.0
    ):
        yield f"the depth unit of {frame!r}"


def same_lens(a: Distortion, b: Distortion) -> bool:
    """Whether both do the same to every point: coefficients that are not there are zeros."""
    if a.is_none or b.is_none:
        return a.is_none and b.is_none
    if a.model != b.model:
        return False
    padded = np.zeros((2, 14))
    for row, lens in zip(padded, (a, b), strict=True):
        row[: len(lens.coefficients)] = lens.coefficients
    return bool(np.abs(padded[0] - padded[1]).max() <= KEPT)
