"""The calibration in an OAK device's EEPROM, as depthai writes it to JSON (`CalibrationHandler.eepromToJsonFile`).

Translations are centimetres; extrinsics map X_to = R X + t from the socket they belong to towards `toCameraSocket`, a
chain that ends at a socket without one. K is for width x height and belongs to the raw, distorted picture; for what a
device delivers at another aspect ratio see RawCamera.covering. Sockets are frames: 0 is CAM_A.
Source: depthai-core, EepromData and CameraInfo.
"""

from __future__ import annotations

import json
import string
from typing import Any

import numpy as np

from page_calibration.calibration import CalibratedCamera, Calibration, CalibrationError, baseline_m
from page_calibration.camera_json import matrix
from page_calibration.formats.contract import Format, Read
from page_calibration.formats.document import Document
from page_runtime.camera import Camera
from page_runtime.capture.documents import field, listed, number, numbers
from page_runtime.geometry import Array, invert, orthonormalized, require_rigid, transform_from
from page_runtime.lens import Distortion, RawCamera

METRES_PER_CM = 1e-2
OLDEST_VERSION, WRITTEN_VERSION = 6, 7
PERSPECTIVE, FISHEYE = 0, 1
NO_SOCKET = -1
MAX_SPEC_DIFFERENCE = 0.03
# Cameras of a board are 4 to 30 cm apart: metres read as centimetres come out below, millimetres above.
BASELINES_M = (0.002, 1.5)
_NUM_COEFFICIENTS = {PERSPECTIVE: 14, FISHEYE: 4}


def recognises(document: Document) -> bool:
    return document.has("cameraData", "boardName")


def read(document: Document) -> Read:
    """Every socket's camera, placed in the socket its chain ends at."""
    where = str(document.path)
    version = number(field(document.data, "version", where=where), where=f"{where}, version")
    entries = {
        int(number(socket, where=f"{where}, cameraData")): entry
        for socket, entry in _pairs(document.data["cameraData"], where=f"{where}, cameraData")
    }
    if not entries:
        raise CalibrationError(f"{where}: no camera in it; the device was never calibrated, or its EEPROM was cleared")
    if version < OLDEST_VERSION or any("cameraType" not in e or "specHfovDeg" not in e for e in entries.values()):
        raise CalibrationError(
            f"{where}: old EEPROM version {version:g}, from before cameraType and specHfovDeg, which depthai 3 refuses "
            "too: lens model and resolution would be guesses; read the device again with a current depthai"
        )
    links = {socket: _link(entry, where=f"{where}, {frame_of(socket)}") for socket, entry in entries.items()}
    warnings = [
        warning
        for socket, entry in sorted(entries.items())
        for warning in _against_spec(entry, socket, links[socket], where=where)
    ]
    cameras = []
    for socket, entry in sorted(entries.items()):
        root, T_root_socket = _chain(socket, links, where=where)
        cameras.append(_camera(entry, socket, root, invert(T_root_socket), where=f"{where}, {frame_of(socket)}"))
    board = document.data.get("productName") or document.data["boardName"]
    return Read(tuple(cameras), (f"{board}, EEPROM version {version:g}",), tuple(warnings))


def frame_of(socket: int) -> str:
    """The name of a socket: 0 is CAM_A."""
    return f"CAM_{string.ascii_uppercase[socket]}" if 0 <= socket < 26 else f"CAM_{socket}"


def _pairs(value: Any, *, where: str) -> list[list[Any]]:
    pairs = listed(value, where=where)
    if not all(isinstance(pair, list) and len(pair) == 2 and isinstance(pair[1], dict) for pair in pairs):
        raise CalibrationError(f"{where}: expected pairs of a socket and its camera")
    return pairs


def _vector_m(entry: Any, name: str, *, where: str) -> Array:
    vector = field(entry, name, where=where)
    values = [field(vector, axis, where=f"{where}, {name}") for axis in "xyz"]
    return np.array(numbers(values, 3, where=f"{where}, {name}")) * METRES_PER_CM


def _link(entry: dict[str, Any], *, where: str) -> tuple[int, Array] | None:
    """(socket the extrinsics lead to, T_to_this) of a camera, None for the end of a chain."""
    extrinsics = field(entry, "extrinsics", where=where)
    to = int(number(field(extrinsics, "toCameraSocket", where=where), where=f"{where}, toCameraSocket"))
    if to == NO_SOCKET:
        return None
    R = matrix(field(extrinsics, "rotationMatrix", where=where), 3, 3, where=f"{where}, rotationMatrix")
    translation_m = _vector_m(extrinsics, "translation", where=where)
    # The EEPROM is float32: without this a chain and its way back would differ by 1e-7.
    T_to_this = orthonormalized(require_rigid(transform_from(R, translation_m), name=f"{where}, extrinsics"))
    baseline, (low, high) = baseline_m(T_to_this), BASELINES_M
    if not low <= baseline <= high:
        is_metres = baseline < low
        raise CalibrationError(
            f"{where}: {baseline * 100:.4g} cm from {frame_of(to)}, which no board is; the EEPROM holds centimetres, "
            f"these are probably {'metres' if is_metres else 'millimetres'}"
            if baseline > 0
            else f"{where}: at the very place of {frame_of(to)}; its extrinsics were never calibrated"
        )
    return to, T_to_this


def _against_spec(entry: dict[str, Any], socket: int, link: tuple[int, Array] | None, *, where: str) -> list[str]:
    """A warning when the calibrated distance is not the board's own, within MAX_SPEC_DIFFERENCE."""
    if link is None or "specTranslation" not in entry["extrinsics"]:
        return []
    spec = float(np.linalg.norm(_vector_m(entry["extrinsics"], "specTranslation", where=where)))
    calibrated = baseline_m(link[1])
    if spec == 0.0 or abs(calibrated / spec - 1.0) <= MAX_SPEC_DIFFERENCE:
        return []
    return [
        f"{frame_of(socket)} is {calibrated * 100:.2f} cm from {frame_of(link[0])} by calibration, {spec * 100:.2f} cm "
        f"by the board's drawing, {100 * abs(calibrated / spec - 1):.1f} % apart; unless the board is bent, calibrate "
        "again"
    ]


def _chain(socket: int, links: dict[int, tuple[int, Array] | None], *, where: str) -> tuple[int, Array]:
    """(socket at the end of the chain, T_root_socket)."""
    T, here, seen = np.eye(4), socket, {socket}
    while (link := links[here]) is not None:
        here, T = link[0], link[1] @ T
        if here in seen or here not in links:
            fault = "leads in a circle" if here in seen else f"leads to {frame_of(here)}, which has no camera in it"
            raise CalibrationError(f"{where}: the chain of extrinsics from {frame_of(socket)} {fault}")
        seen.add(here)
    return here, T


def _camera(entry: dict[str, Any], socket: int, root: int, T_camera_world: Array, *, where: str) -> CalibratedCamera:
    width, height = (int(number(field(entry, n, where=where), where=f"{where}, {n}")) for n in ("width", "height"))
    if width <= 0 or height <= 0:
        raise CalibrationError(f"{where}: the picture size K is for is {width}x{height}; the EEPROM was not filled")
    kind = field(entry, "cameraType", where=where)
    coefficients = listed(field(entry, "distortionCoeff", where=where), where=where)
    coefficients = numbers(coefficients, len(coefficients), where=f"{where}, distortionCoeff")
    if kind == FISHEYE:
        if any(coefficients[4:]):
            raise CalibrationError(f"{where}: a fisheye lens has 4 coefficients, got {coefficients}")
        lens = Distortion("kannala-brandt", np.array(coefficients[:4]))
    elif kind == PERSPECTIVE:
        lens = Distortion("brown-conrady", np.array(coefficients)) if any(coefficients) else Distortion()
    else:
        raise CalibrationError(f"{where}: cameraType {kind} is neither perspective (0) nor fisheye (1)")
    K = matrix(field(entry, "intrinsicMatrix", where=where), 3, 3, where=f"{where}, intrinsicMatrix")
    camera = Camera(K, width, height, T_camera_world)
    return CalibratedCamera(frame_of(socket), frame_of(root), RawCamera(camera, lens))


def write(calibration: Calibration) -> str:
    """An EEPROM document that depthai loads; frames must be sockets. Centimetres, in double precision."""
    sockets = {frame_of(socket): socket for socket in range(26)}
    unknown = [frame for frame in calibration.frames if frame not in sockets]
    if unknown:
        raise CalibrationError(f"an OAK EEPROM has sockets CAM_A, CAM_B ...; {unknown[0]!r} is none: rename the camera")
    entries = []
    for camera in calibration:
        root = camera.world_frame
        is_root = root == camera.frame or root not in calibration.frames
        lens = camera.raw.distortion
        kind = FISHEYE if lens.model == "kannala-brandt" else PERSPECTIVE
        coefficients = np.zeros(_NUM_COEFFICIENTS[kind])
        coefficients[: len(lens.coefficients)] = lens.coefficients
        T_to_this = np.eye(4) if is_root else calibration.transform(root, camera.frame)
        entries.append([
            sockets[camera.frame],
            {
                "cameraType": kind,
                "distortionCoeff": coefficients.tolist(),
                "extrinsics": {
                    "rotationMatrix": T_to_this[:3, :3].tolist(),
                    "specTranslation": dict.fromkeys("xyz", 0.0),
                    "toCameraSocket": NO_SOCKET if is_root else sockets[root],
                    "translation": dict(zip("xyz", (T_to_this[:3, 3] / METRES_PER_CM).tolist(), strict=True)),
                },
                "height": camera.camera.height,
                "intrinsicMatrix": camera.camera.K.tolist(),
                "lensPosition": 0,
                "specHfovDeg": float(np.degrees(2 * np.arctan(camera.camera.width / 2 / camera.camera.K[0, 0]))),
                "width": camera.camera.width,
            },
        ])  # fmt: skip
    nothing = {"rotationMatrix": [], "toCameraSocket": NO_SOCKET}
    zeros = dict.fromkeys("xyz", 0.0)
    document = {
        "batchName": "", "batchTime": 0, "boardConf": "", "boardCustom": "", "boardName": "page-edge",
        "boardOptions": 0, "boardRev": "", "cameraData": entries, "hardwareConf": "",
        "imuExtrinsics": {**nothing, "specTranslation": zeros, "translation": zeros},
        "miscellaneousData": [], "productName": "",
        "stereoRectificationData": {
            "leftCameraSocket": NO_SOCKET, "rectifiedRotationLeft": [],
            "rectifiedRotationRight": [], "rightCameraSocket": NO_SOCKET,
        },
        "version": WRITTEN_VERSION,
    }  # fmt: skip
    return json.dumps(document, indent=1) + "\n"


OAK = Format("oak", "OAK EEPROM", ".json", recognises, read, write)
