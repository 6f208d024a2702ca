"""What depthai's RecordMetadataOnly and RecordMessage nodes write: MCAP files of protobuf ImgFrames.

A folder with a file for each stream, or one file with both. Such a file has every bit of RAW16 depth; a stream recorded
by RecordVideo is a video instead, its MCAP holds no pixels, and RAW16 is destroyed. Decoded without depthai. K is the
colour frames' own, at their size. depthai loses messages of a damaged file silently; here they are counted.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from page_runtime.camera import Camera
from page_runtime.capture.mcap_file import McapFile, MessageRef
from page_runtime.capture.pairing import Stream, pair_recorded
from page_runtime.capture.undistortion import lens_of, undistorted
from page_runtime.image_files import SourceError, depth_in_metres
from page_runtime.lens import NO_DISTORTION, Distortion
from page_runtime.recorded import FrameEntry, Pixels, Source, require_central, require_playable

FORMAT = "depthai recording"
IMAGE_KIND = "dai.proto.img_frame.ImgFrame"
METRES_PER_UNIT = 1e-3
DAMAGED = "messages that cannot be decoded"


@dataclass(frozen=True, eq=False, slots=True)
class _Stored:
    file: McapFile
    decoder: Any
    ref: MessageRef

    def message(self) -> Any:
        return self.decoder(self.file.read(self.ref))


def is_depthai(files: list[McapFile]) -> bool:
    """Whether depthai wrote these files."""
    return bool(files) and all(file.library.startswith("depthai") for file in files)


def read_depthai(path: Path, files: list[McapFile], *, window_s: float) -> Source:
    """The streams of `files` as a source, without truths."""
    readings: list[tuple[float, Stream, _Stored]] = []
    missed: Counter[str] = Counter()
    kinds: Counter[str] = Counter()
    for file in files:
        missed.update(file.missed)
        decoders = _decoders(file)
        for ref in file.messages:
            if ref.topic not in decoders:
                continue
            stored = _Stored(file, decoders[ref.topic], ref)
            try:
                message = stored.message()
            except Exception:
                # protobuf raises DecodeError, and ValueError for damaged text.
                missed[DAMAGED] += 1
                continue
            kind = _type_name(message)
            kinds[kind] += 1
            stream: Stream = "depth" if kind == "RAW16" else "color"
            readings.append((message.tsDevice.sec + message.tsDevice.nsec * 1e-9, stream, stored))
    streams = {stream for _, stream, _ in readings}
    if streams != {"color", "depth"}:
        found = ", ".join(f"{count} {kind}" for kind, count in kinds.items()) or "no frames"
        raise SourceError(
            f"{path}: expected frames of colour and of RAW16 depth, found {found}; "
            "record both streams by RecordMetadataOnly into one folder"
        )
    pairs, counts = pair_recorded(sorted(readings, key=lambda reading: reading[0]), window_s=window_s)
    entries = []
    for index, pair in enumerate(pairs):
        color = pair.color.message()
        camera, distortion = _camera(path, color)
        decode = partial(_decode, path, pair.color, pair.depth, camera, distortion)
        timestamp_s = color.ts.sec + color.ts.nsec * 1e-9
        entries.append(FrameEntry(path, path, 0.0, camera, (), timestamp_s, index, pair.skew_s, decode))
    counts = replace(counts, missed=dict(missed))
    return require_playable(Source(path, FORMAT, tuple(entries), pairing=counts))


def _decoders(file: McapFile) -> dict[str, Any]:
    """Functions from bytes to a message, by topic, for the topics that hold pictures."""
    try:
        from mcap.well_known import MessageEncoding
        from mcap_protobuf.decoder import DecoderFactory
    except ImportError as error:
        raise SourceError(
            "depthai recordings need mcap-protobuf-support, which is not installed; pip install 'page-edge[ros]'"
        ) from error
    factory = DecoderFactory()
    found = {}
    for channel in file.channels:
        if channel.kind == IMAGE_KIND:
            found[channel.topic] = factory.decoder_for(MessageEncoding.Protobuf, file.schema_of(channel.topic))
    return found


def _type_name(message: Any) -> str:
    field = message.fb.DESCRIPTOR.fields_by_name["type"]
    return field.enum_type.values_by_number[message.fb.type].name


def _camera(path: Path, message: Any) -> tuple[Camera, Distortion]:
    # K of the sensor's picture, and the crop and scale from there to the recorded one.
    try:
        K, M_picture_source = (
            np.array([list(row.values) for row in matrix.arrays], dtype=float).reshape(3, 3)
            for matrix in (message.transformation.sourceIntrinsicMatrix, message.transformation.transformationMatrix)
        )
        camera = Camera(M_picture_source @ K, message.fb.width, message.fb.height)
    except ValueError as error:
        raise SourceError(f"{path}: its colour frames carry no intrinsics ({error})") from error
    require_central(camera, where=str(path))
    coefficients = message.transformation.distortionCoefficients.values
    return camera, lens_of("rational_polynomial", coefficients, where=str(path)) if any(coefficients) else NO_DISTORTION


def _decode(path: Path, color: _Stored, depth: _Stored, camera: Camera, distortion: Distortion) -> Pixels:
    pixels = _color(path, color.message())
    message = depth.message()
    units = _plane(path, message, np.dtype("<u2"), message.fb.width, message.fb.height)
    if units.shape != pixels.shape[:2]:
        raise SourceError(
            f"{path}: colour is {pixels.shape[1]}x{pixels.shape[0]}, depth {units.shape[1]}x{units.shape[0]}; "
            "record depth aligned to colour"
        )
    return undistorted(pixels, depth_in_metres(units, metres_per_unit=METRES_PER_UNIT), camera, distortion)


def _color(path: Path, message: Any) -> NDArray[np.uint8]:
    width, height, kind = message.fb.width, message.fb.height, _type_name(message)
    if kind == "NV12":
        planes = _plane(path, message, np.dtype(np.uint8), width, height * 3 // 2)
        return np.asarray(cv2.cvtColor(planes, cv2.COLOR_YUV2RGB_NV12), np.uint8)
    if kind not in ("BGR888i", "RGB888i"):
        raise SourceError(f"{path}: expected colour as BGR888i, RGB888i or NV12, got {kind}")
    pixels = _plane(path, message, np.dtype(np.uint8), width * 3, height).reshape(height, width, 3)
    return np.ascontiguousarray(pixels[..., ::-1] if kind == "BGR888i" else pixels)


def _plane(path: Path, message: Any, kind: np.dtype[Any], columns: int, rows: int) -> NDArray[Any]:
    """(rows, columns) of the message's bytes, without what pads its rows."""
    stride = max(message.fb.stride, columns * kind.itemsize)
    data = np.frombuffer(message.data, np.uint8)
    if len(data) < stride * rows:
        raise SourceError(
            f"{path}: expected {rows} rows of {stride} bytes in a frame, got {len(data)} bytes; was it recorded by "
            "RecordVideo? Its MCAP has no pixels"
        )
    used = np.ascontiguousarray(data[: stride * rows].reshape(rows, stride)[:, : columns * kind.itemsize])
    return used.view(kind)
