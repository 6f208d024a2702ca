"""Every way a recording of toy frames can be broken, and what is to be said of it."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np

import toy
from page_runtime.image_files import write_color

Break = Callable[[Path], object]


def edit_json(name: str, change: Callable[[Any], Any]) -> Break:
    def apply(folder: Path) -> None:
        path = folder / name
        path.write_text(json.dumps(change(json.loads(path.read_text()))))

    return apply


def edit_camera(**fields: Any) -> Break:
    """Change fields of every frame's camera; None removes one."""

    def change(document: Any) -> Any:
        for camera in document.values():
            camera.update(fields)
            for name in [name for name, value in fields.items() if value is None]:
                del camera[name]
        return document

    return edit_json("scene_camera.json", change)


def scaled_K(factor: float) -> list[float]:
    K = toy.toy_camera().K.copy()
    K[:2] *= factor
    return K.ravel().tolist()


def edit_frame(**fields: Any) -> Break:
    def change(document: Any) -> Any:
        document["frames"]["1"].update(fields)
        return document

    return edit_json("recording.json", change)


def edit_recording(**fields: Any) -> Break:
    return edit_json("recording.json", lambda document: document | fields)


def replace_depth(pixels: np.ndarray, suffix: str = ".png") -> Break:
    def apply(folder: Path) -> None:
        path = folder / "depth" / "000001.png"
        written, data = cv2.imencode(suffix, pixels)
        assert written
        path.write_bytes(data.tobytes())

    return apply


def cut(name: str, share: float = 0.5) -> Break:
    def apply(folder: Path) -> None:
        data = (folder / name).read_bytes()
        (folder / name).write_bytes(data[: int(len(data) * share)])

    return apply


def scramble(name: str) -> Break:
    """Damage in the middle, which only decoding finds."""

    def apply(folder: Path) -> None:
        data = bytearray((folder / name).read_bytes())
        middle = len(data) // 2
        data[middle : middle + 64] = bytes(64)
        (folder / name).write_bytes(data)

    return apply


def remove(name: str) -> Break:
    def apply(folder: Path) -> None:
        path = folder / name
        shutil.rmtree(path) if path.is_dir() else path.unlink()

    return apply


def write(name: str, text: str) -> Break:
    return lambda folder: (folder / name).write_text(text)


def half_size(folder: Path) -> None:
    write_color(folder / "rgb" / "000001.png", np.zeros((120, 160, 3), np.uint8))


H, W = 240, 320

BROKEN_RECORDINGS: dict[str, tuple[Break, str]] = {
    "no depth folder": (remove("depth"), "no depth/ folder"),
    "no depth of a frame": (remove("depth/000001.png"), "1 of 3 frames are not in depth/, the first is 1"),
    "no colour folder": (remove("rgb"), "no rgb/ folder"),
    "no cameras": (remove("scene_camera.json"), "no scene_camera.json"),
    "no truth document": (remove("scene_gt.json"), "scene_gt.json has 0 entries"),
    "depth without scale": (edit_camera(depth_scale=None), "depth without a scale"),
    "depth scale zero": (edit_camera(depth_scale=0), "expected a positive depth scale"),
    "depth scale not a number": (edit_camera(depth_scale="1 mm"), "depth_scale: expected a number"),
    "8-bit depth": (replace_depth(np.ones((H, W), np.uint8)), "16-bit single-channel PNG, got 8-bit"),
    "colour as depth": (replace_depth(np.ones((H, W, 3), np.uint16)), "got 16-bit colour PNG"),
    "JPEG as depth": (replace_depth(np.ones((H, W), np.uint8), ".jpg"), "got 8-bit single-channel JPEG"),
    "float depth": (replace_depth(np.ones((H, W), np.float32), ".tiff"), "expected a PNG or JPEG picture"),
    "depth of another size": (replace_depth(np.ones((H, 2 * W), np.uint16)), "register depth to colour first"),
    "K of twice the size": (edit_camera(cam_K=scaled_K(2)), "K does not match the image size"),
    "K of three times the size": (edit_camera(cam_K=scaled_K(3)), "K does not match the image size"),
    "K of half the size": (edit_camera(cam_K=scaled_K(0.5)), "K does not match the image size"),
    "a picture of half the size": (half_size, "K is for 320x240 but 000001.png is 160x120"),
    "K of eight numbers": (edit_camera(cam_K=[1.0] * 8), "cam_K: expected 9 numbers"),
    "K transposed": (edit_camera(cam_K=toy.toy_camera().K.T.ravel().tolist()), "may be stored transposed"),
    "K missing": (edit_camera(cam_K=None), "expected a field 'cam_K'"),
    "K infinite": (edit_camera(cam_K=[float("inf")] * 9), "cam_K: expected 9 numbers"),
    "a region outside": (edit_frame(instances=[{"region": [500, 0, 9, 9], "parts": None}]), "outside the 320x240"),
    "an empty region": (edit_frame(instances=[{"region": [5, 5, 0, 9], "parts": None}]), "expected a positive size"),
    "a frame the recording does not know": (edit_recording(frames={}), "expected a field '0', found none"),
    "a newer version": (edit_recording(version=99), "expected version 1, got 99"),
    "another category": (edit_recording(category="laptop"), "but .* holds 'laptop'"),
    "other parts": (edit_recording(parts=["base", "screen"]), "knows the parts base, lid"),
    "not JSON": (write("recording.json", "{"), "expected JSON"),
    "JSON of another kind": (write("scene_camera.json", "[]"), "expected a JSON object"),
    "binary as JSON": (lambda folder: (folder / "scene_gt.json").write_bytes(b"\xff\xfe"), "expected JSON"),
    "a colour picture cut off": (cut("rgb/000002.png"), "cut off or damaged"),
    "a depth picture cut off": (cut("depth/000002.png", 0.9), "cut off or damaged"),
    "an empty picture": (cut("rgb/000002.png", 0.0), "expected a PNG or JPEG picture"),
    "damage inside a picture": (scramble("rgb/000002.png"), "cut off or damaged"),
    "truth that is not rigid": (
        edit_json("scene_gt.json", lambda d: {key: [e | {"cam_R_m2c": [2.0] * 9} for e in v] for key, v in d.items()}),
        "expected a rotation",
    ),
}  # fmt: skip
