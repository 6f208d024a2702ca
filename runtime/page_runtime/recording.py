"""The project's recording: a BOP scene folder, and recording.json for what BOP cannot say.

    rgb/000000.png (or .jpg)   colour
    depth/000000.png           uint16 in units of depth_scale
    mask_visib/000000_000000.png  visible pixels of gt entry 0, 1, ... of a frame (where the writer knew them)
    scene_camera.json          cam_K, depth_scale (mm a unit), cam_R_w2c and cam_t_w2c (mm) of a placed camera
    scene_gt.json              cam_R_m2c, cam_t_m2c (mm), obj_id = 1 + index of the part
    scene_gt_info.json         bbox_visib, px_count_visib, visib_fract where known
    calibration.json           what the camera says of itself (where it was recorded)
    recording.json             version, category, parts, joint states, extents (m), regions (px), timestamps (s)

BOP tools read it as it is: each part is a BOP object. Poses are of the canonical part frames (`page-runtime inspect`).
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from page_runtime.capture.documents import METRES_PER_MM
from page_runtime.geometry import Array
from page_runtime.image_files import (
    PNG_SMALL,
    PngEffort,
    SourceError,
    read_header,
    write_color,
    write_depth,
    write_mask,
)
from page_runtime.recorded import RecordedFrame, require_central
from page_runtime.sampling import check_region

RECORDING_VERSION = 1
RECORDING_FILE = "recording.json"
JOURNAL_FILE = "journal.jsonl"
CALIBRATION_FILE = "calibration.json"
FORMAT = "page-edge recording"

# Of one frame: its entries of scene_camera.json, scene_gt.json, scene_gt_info.json and recording.json.
FrameDocuments = tuple[dict[str, Any], list[dict[str, Any]], list[dict[str, Any]], dict[str, Any]]
Masks = Sequence[Sequence[NDArray[np.bool_]]]


class RecordingWriter:
    """Writes frames into a folder that appears, complete, when the `with` block ends, and not at all if it fails.

    Until then it is .NAME.partial beside it; a killed process leaves that behind, and finish_recording makes a
    recording of it. category: None, with no part names, where nothing is known of the objects. depth_unit_mm:
    resolution of stored depth; 1 is what depth cameras deliver and reaches 65 m, 0.1 reaches 6.5 m. color_suffix:
    ".png" keeps every value, ".jpg" is a tenth of the size. effort: PNG_FAST where a camera would not wait.
    """

    def __init__(
        self,
        path: Path,
        *,
        category: str | None,
        part_names: Sequence[str],
        depth_unit_mm: float = 1.0,
        color_suffix: Literal[".png", ".jpg"] = ".png",
        effort: PngEffort = PNG_SMALL,
    ) -> None:
        self.path = Path(path)
        if self.path.exists():
            raise FileExistsError(f"{self.path}: exists already; a recording never overwrites, give another name")
        self.category = category
        self.part_names = tuple(part_names)
        self.depth_unit_mm = depth_unit_mm
        self.color_suffix = color_suffix
        self.effort = effort
        self._partial = self.path.with_name(f".{self.path.name}.partial")
        self._frames: list[FrameDocuments] = []

    def __enter__(self) -> RecordingWriter:
        shutil.rmtree(self._partial, ignore_errors=True)
        for name in ("rgb", "depth"):
            (self._partial / name).mkdir(parents=True)
        self._note({"version": RECORDING_VERSION, "category": self.category, "parts": list(self.part_names)})
        return self

    def _note(self, line: dict[str, Any]) -> None:
        """One more line in the journal, from which a recording that was cut short can be finished."""
        with (self._partial / JOURNAL_FILE).open("a", encoding="utf-8") as file:
            file.write(json.dumps(line, allow_nan=False) + "\n")

    def keep_calibration(self, text: str) -> None:
        """Store what the camera says of itself, JSON text, beside the frames; the first time it is told."""
        if not (self._partial / CALIBRATION_FILE).exists():
            # Whole or not there, whenever the process is killed.
            growing = self._partial / f".{CALIBRATION_FILE}"
            growing.write_text(text, encoding="utf-8")
            growing.rename(self._partial / CALIBRATION_FILE)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if kind is not None:
            shutil.rmtree(self._partial, ignore_errors=True)
            return
        _write_documents(
            self._partial,
            {"version": RECORDING_VERSION, "category": self.category, "parts": list(self.part_names)},
            self._frames,
        )
        self._partial.rename(self.path)

    def write(self, recorded: RecordedFrame, *, masks: Masks | None = None) -> int:
        """Append a frame and return its number. masks: per instance and part, (H,W) bool of its visible pixels."""
        frame, index = recorded.frame, len(self._frames)
        self._check(recorded, masks)
        name = f"{index:06d}"
        write_color(self._partial / "rgb" / (name + self.color_suffix), frame.color, effort=self.effort)
        depth_path, metres_per_unit = self._partial / "depth" / f"{name}.png", self.depth_unit_mm * METRES_PER_MM
        write_depth(depth_path, frame.depth_m, metres_per_unit=metres_per_unit, effort=self.effort)
        camera: dict[str, Any] = {"cam_K": frame.camera.K.ravel().tolist(), "depth_scale": self.depth_unit_mm}
        if not np.array_equal(frame.camera.T_camera_world, np.eye(4)):
            camera |= _pose_fields(frame.camera.T_camera_world, "cam_R_w2c", "cam_t_w2c")
        gt: list[dict[str, Any]] = []
        gt_info: list[dict[str, Any]] = []
        instances = []
        for i, instance in enumerate(recorded.instances):
            parts: list[dict[str, Any]] = []
            for k, truth in enumerate(instance.truths or ()):
                mask = None if masks is None else np.asarray(masks[i][k], dtype=bool)
                if mask is not None:
                    (self._partial / "mask_visib").mkdir(exist_ok=True)
                    write_mask(self._partial / "mask_visib" / f"{name}_{len(gt):06d}.png", mask)
                parts.append({
                    "gt": len(gt),
                    "extents_m": truth.extents_m.tolist(),
                    "joint_state": truth.joint_state,
                })  # fmt: skip
                gt.append(_pose_fields(truth.T_camera_part, "cam_R_m2c", "cam_t_m2c") | {"obj_id": k + 1})
                gt_info.append(_visibility(mask, truth.visible_share))
            instances.append({
                "region": None if instance.region is None else [int(value) for value in instance.region],
                "parts": parts if instance.truths else None,
            })  # fmt: skip
        facts = {
            "timestamp_s": frame.timestamp_s,
            "size_px": [frame.camera.width, frame.camera.height],
            "instances": instances,
        }
        if frame.skew_s:
            facts["skew_s"] = frame.skew_s
        self._frames.append((camera, gt, gt_info, facts))
        self._note({"camera": camera, "gt": gt, "gt_info": gt_info, "frame": facts})
        return index

    def _check(self, recorded: RecordedFrame, masks: Masks | None) -> None:
        camera = recorded.frame.camera
        require_central(camera, where=f"{self.path}, frame {len(self._frames)}")
        for instance in recorded.instances:
            if instance.region is not None:
                check_region(instance.region, camera.width, camera.height)
            names = tuple(truth.name for truth in instance.truths or ())
            if names and names != self.part_names:
                raise ValueError(f"RecordingWriter: expected truths of the parts {self.part_names}, got {names}")
        if masks is not None and [len(parts) for parts in masks] != [len(i.truths or ()) for i in recorded.instances]:
            raise ValueError("RecordingWriter: expected one mask for every part of every instance")


def _pose_fields(T_a_b: Array, rotation: str, translation: str) -> dict[str, Any]:
    return {rotation: T_a_b[:3, :3].ravel().tolist(), translation: (T_a_b[:3, 3] / METRES_PER_MM).tolist()}


def _visibility(mask: NDArray[np.bool_] | None, visible_share: float | None) -> dict[str, Any]:
    info: dict[str, Any] = {}
    if visible_share is not None:
        info["visib_fract"] = float(visible_share)
    if mask is not None:
        rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
        info["px_count_visib"] = int(mask.sum())
        info["bbox_visib"] = (
            [int(columns[0]), int(rows[0]), int(np.ptp(columns)) + 1, int(np.ptp(rows)) + 1]
            if len(rows)
            else [-1, -1, -1, -1]
        )
    return info


def _one_frame_a_line(document: dict[str, Any]) -> str:
    lines = []
    for key, value in document.items():
        text = _one_frame_a_line(value).rstrip("\n") if key == "frames" else json.dumps(value, allow_nan=False)
        lines.append(f"{json.dumps(key)}: {text}")
    return "{\n" + ",\n".join(lines) + "\n}\n"


def _write_documents(folder: Path, head: dict[str, Any], frames: Sequence[FrameDocuments]) -> None:
    """The four documents of a recording whose pictures are there; its journal is not needed any more."""
    columns = [{str(index): frame[column] for index, frame in enumerate(frames)} for column in range(4)]
    for name, document in (
        ("scene_camera.json", columns[0]),
        ("scene_gt.json", columns[1]),
        ("scene_gt_info.json", columns[2]),
        (RECORDING_FILE, head | {"frames": columns[3]}),
    ):
        (folder / name).write_text(_one_frame_a_line(document), encoding="utf-8")
    (folder / JOURNAL_FILE).unlink()


def is_unfinished(folder: Path) -> bool:
    """Whether the folder is what a RecordingWriter leaves behind when its process is killed."""
    return (folder / JOURNAL_FILE).is_file() and not (folder / RECORDING_FILE).exists()


def finish_recording(folder: Path) -> tuple[int, int]:
    """Make a recording of an unfinished folder: every frame whose pictures are whole, up to the first that is not.

    Returns the numbers of frames kept and left out. Raises SourceError when not one can be kept.
    """
    lines = (folder / JOURNAL_FILE).read_text(encoding="utf-8", errors="replace").splitlines()
    head: dict[str, Any] | None = None
    frames: list[FrameDocuments] = []
    for line in lines:
        try:
            entry = json.loads(line)
            if head is None:
                head = entry
                continue
            for picture in _pictures_of(folder, len(frames), len(entry["gt"])):
                read_header(picture)
            frames.append((entry["camera"], entry["gt"], entry["gt_info"], entry["frame"]))
        except (SourceError, ValueError, KeyError, TypeError):
            break
    if head is None or not frames:
        raise SourceError(f"{folder}: not one frame was finished; there is nothing to recover")
    left_out = 0
    for file in [*(folder / "rgb").iterdir(), *(folder / "depth").iterdir(), *(folder / "mask_visib").glob("*.png")]:
        if int(file.stem.partition("_")[0]) >= len(frames):
            left_out += file.parent.name == "rgb"
            file.unlink()
    _write_documents(folder, head, frames)
    return len(frames), left_out


def _pictures_of(folder: Path, index: int, masks: int) -> list[Path]:
    color = sorted((folder / "rgb").glob(f"{index:06d}.*"))
    found = [folder / "mask_visib" / f"{index:06d}_{k:06d}.png" for k in range(masks)]
    if not color:
        raise SourceError(f"{folder}: no colour picture {index}")
    return [color[0], folder / "depth" / f"{index:06d}.png", *(mask for mask in found if mask.exists())]
