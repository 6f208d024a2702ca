"""Colour and depth pictures on disk: PNG and JPEG in, RGB and metres out; BGR stays inside this module.

A folder of pictures is checked by headers and trailers before a single one is decoded, so that a recording is refused
at once and not in the middle of a run.
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

COLOR_SUFFIXES = (".png", ".jpg", ".jpeg")
JPEG_QUALITY = 92
# zlib's level 9 takes ten times as long on depth as 6, for a tenth less; run lengths alone are as quick as its level 1
# and a fifth smaller (640x480 sensor depth: 29 ms and 165 kB, 90 and 146, 925 and 132).
PNG_SMALL = (cv2.IMWRITE_PNG_COMPRESSION, 6)
PNG_FAST = (cv2.IMWRITE_PNG_COMPRESSION, 1, cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_RLE)
PngEffort = tuple[int, ...]

_PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_PNG_TRAILER = b"IEND\xaeB`\x82"
_PNG_GRAY = 0
_JPEG_SIGNATURE = b"\xff\xd8"
_JPEG_END = b"\xff\xd9"
_JPEG_SIZES = {*range(0xC0, 0xD0)} - {0xC4, 0xC8, 0xCC}
_TAIL_BYTES = 1 << 16


class SourceError(ValueError):
    """What was given as a source of frames cannot be played; the message is a sentence that says why."""


@dataclass(frozen=True, slots=True)
class ImageHeader:
    """width, height: pixels. bits: of one sample. gray: one channel. container: "PNG" or "JPEG"."""

    width: int
    height: int
    bits: int
    gray: bool
    container: str

    def __str__(self) -> str:
        kind = "single-channel" if self.gray else "colour"
        return f"{self.bits}-bit {kind} {self.container} of {self.width}x{self.height}"


def read_header(path: Path) -> ImageHeader:
    """Size and kind of a picture, not decoded; SourceError when it is missing, neither PNG nor JPEG, or cut off."""
    try:
        with path.open("rb") as file:
            head = file.read(32)
            file.seek(0, 2)
            file.seek(max(0, file.tell() - _TAIL_BYTES))
            tail = file.read()
            if head.startswith(_PNG_SIGNATURE) and len(head) >= 26:
                header = _png_header(head)
                complete = tail.endswith(_PNG_TRAILER)
            elif head.startswith(_JPEG_SIGNATURE):
                file.seek(0)
                header = _jpeg_header(file.read())
                complete = header is not None and _JPEG_END in tail
            else:
                raise SourceError(f"{path}: expected a PNG or JPEG picture, got a file of another kind")
    except OSError as error:
        raise SourceError(f"{path}: cannot read the picture ({error.strerror})") from error
    if header is None or not complete:
        raise SourceError(f"{path}: the picture is cut off or damaged; copy or record it again")
    return header


def _png_header(head: bytes) -> ImageHeader:
    width, height, bits, color_type = struct.unpack(">IIBB", head[16:26])
    return ImageHeader(width, height, bits, color_type == _PNG_GRAY, "PNG")


def _jpeg_header(data: bytes) -> ImageHeader | None:
    position = 2
    while position + 9 < len(data) and data[position] == 0xFF:
        marker = data[position + 1]
        if marker in _JPEG_SIZES:
            bits, height, width, channels = struct.unpack(">BHHB", data[position + 4 : position + 10])
            return ImageHeader(width, height, bits, channels == 1, "JPEG")
        (length,) = struct.unpack(">H", data[position + 2 : position + 4])
        position += 2 + length
    return None


def require_depth_header(path: Path) -> ImageHeader:
    """The header of a depth picture: a 16-bit single-channel PNG, the only kind whose unit a scale can give."""
    header = read_header(path)
    if header.container != "PNG" or header.bits != 16 or not header.gray:
        raise SourceError(
            f"{path}: expected depth as a 16-bit single-channel PNG, got {header}; "
            "store whole units of the depth scale, 0 where there is no reading"
        )
    return header


def read_color(path: Path) -> NDArray[np.uint8]:
    """(H,W,3) uint8 RGB. An orientation in the file's metadata is ignored: K belongs to the pixels as stored."""
    decoded = _decode(path, cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
    return np.asarray(cv2.cvtColor(decoded, cv2.COLOR_BGR2RGB), dtype=np.uint8)


def read_depth(path: Path, *, metres_per_unit: float) -> NDArray[np.float32]:
    """(H,W) float32 metres, 0 = no reading."""
    require_depth_header(path)
    units = np.asarray(_decode(path, cv2.IMREAD_UNCHANGED), dtype=np.uint16)
    return depth_in_metres(units, metres_per_unit=metres_per_unit)


def depth_in_metres(units: NDArray[np.uint16], *, metres_per_unit: float) -> NDArray[np.float32]:
    """float32 metres nearest to whole units, of any shape.

    The product is made in double precision: 1 unit of 1 mm and 5 of 0.2 mm then give the same float32, so that a frame
    is the same to the last bit in whatever unit a format stores it.
    """
    return np.multiply(units, metres_per_unit, dtype=np.float64).astype(np.float32)


def read_mask(path: Path) -> NDArray[np.bool_]:
    """(H,W) bool, true where the stored single-channel picture is not 0."""
    return np.asarray(_decode(path, cv2.IMREAD_GRAYSCALE)) > 0


def decode_color_picture(data: NDArray[np.uint8], *, where: str) -> NDArray[np.uint8]:
    """(H,W,3) uint8 RGB of the bytes of a PNG or JPEG file; where: for the error, a SourceError."""
    decoded = _decode_bytes(data, cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION, where=where)
    return np.asarray(cv2.cvtColor(decoded, cv2.COLOR_BGR2RGB), dtype=np.uint8)


def decode_depth_picture(data: NDArray[np.uint8], *, where: str) -> NDArray[np.uint16]:
    """(H,W) uint16 of the bytes of a 16-bit PNG file; where: for the error, a SourceError."""
    decoded = _decode_bytes(data, cv2.IMREAD_UNCHANGED, where=where)
    if decoded.dtype != np.uint16 or decoded.ndim != 2:
        raise SourceError(f"{where}: expected depth as a 16-bit single-channel PNG, got {decoded.dtype}{decoded.shape}")
    return np.asarray(decoded, dtype=np.uint16)


def _decode(path: Path, flags: int) -> NDArray[np.uint8 | np.uint16]:
    try:
        data = np.frombuffer(path.read_bytes(), np.uint8)
    except OSError as error:
        raise SourceError(f"{path}: cannot read the picture ({error.strerror})") from error
    return _decode_bytes(data, flags, where=str(path))


def _decode_bytes(data: NDArray[np.uint8], flags: int, *, where: str) -> NDArray[np.uint8 | np.uint16]:
    if data[: len(_PNG_SIGNATURE)].tobytes() == _PNG_SIGNATURE:
        _require_checksums(data.tobytes(), where=where)
    try:
        decoded = cv2.imdecode(data, flags) if data.size else None
    except cv2.error as error:
        raise SourceError(f"{where}: OpenCV cannot decode the picture ({error.err})") from error
    if decoded is None:
        raise SourceError(f"{where}: the picture is cut off or damaged; copy or record it again")
    return np.asarray(decoded, dtype=np.uint16 if decoded.dtype == np.uint16 else np.uint8)


def _require_checksums(png: bytes, *, where: str) -> None:
    """SourceError unless every chunk of the PNG is whole: OpenCV decodes a damaged one as far as it gets, silently."""
    position = len(_PNG_SIGNATURE)
    while position + 12 <= len(png):
        end = position + 8 + int.from_bytes(png[position : position + 4])
        stored = int.from_bytes(png[end : end + 4])
        if end + 4 > len(png) or zlib.crc32(memoryview(png)[position + 4 : end]) != stored:
            break
        if png[position + 4 : position + 8] == b"IEND":
            return
        position = end + 4
    raise SourceError(f"{where}: the picture is cut off or damaged; copy or record it again")


def write_color(path: Path, color: NDArray[np.uint8], *, effort: PngEffort = PNG_SMALL) -> None:
    """Write (H,W,3) uint8 RGB as the PNG or JPEG the path's suffix says. effort: PNG_SMALL or PNG_FAST."""
    _encode(path, np.ascontiguousarray(color[..., ::-1]), effort)


def encode_jpeg(color: NDArray[np.uint8], *, quality: int = JPEG_QUALITY) -> bytes:
    """(H,W,3) uint8 RGB as the bytes of a JPEG file."""
    written, data = cv2.imencode(".jpg", np.ascontiguousarray(color[..., ::-1]), [cv2.IMWRITE_JPEG_QUALITY, quality])
    if not written:
        raise ValueError(f"encode_jpeg: expected (H,W,3) uint8, got {color.shape} {color.dtype}")
    return data.tobytes()


def write_depth(
    path: Path, depth_m: NDArray[np.float32], *, metres_per_unit: float, effort: PngEffort = PNG_SMALL
) -> None:
    """Write (H,W) float32 metres as whole units in a 16-bit PNG; ValueError when a reading does not fit. effort: as in
    write_color."""
    units = np.rint(np.nan_to_num(depth_m.astype(np.float64) / metres_per_unit, nan=0.0, posinf=0.0))
    limit = np.iinfo(np.uint16).max
    if units.min(initial=0) < 0 or units.max(initial=0) > limit:
        unit_mm = metres_per_unit * 1e3
        raise ValueError(
            f"depth_m: units of {unit_mm:g} mm reach from 0 to {limit * metres_per_unit:.4g} m, got "
            f"{depth_m.min():.4g} to {depth_m.max():.4g} m; choose a larger unit"
        )
    _encode(path, units.astype(np.uint16), effort)


def write_mask(path: Path, mask: NDArray[np.bool_]) -> None:
    """Write (H,W) bool as an 8-bit PNG of 0 and 255."""
    _encode(path, np.where(mask, np.uint8(255), np.uint8(0)), PNG_SMALL)


def _encode(path: Path, pixels: NDArray[np.uint8] | NDArray[np.uint16], effort: PngEffort) -> None:
    suffix = path.suffix.lower()
    if suffix not in COLOR_SUFFIXES:
        raise ValueError(f"{path}: expected a name ending in {', '.join(COLOR_SUFFIXES)}")
    options = effort if suffix == ".png" else (cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY)
    written, data = cv2.imencode(suffix, pixels, options)
    if not written:
        raise OSError(f"{path}: cannot encode a {pixels.dtype} picture of shape {pixels.shape}")
    path.write_bytes(data.tobytes())
