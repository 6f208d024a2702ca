"""Training samples on disk: shards of fixed-size records, written once, read at random through a memory map."""

from __future__ import annotations

import hashlib
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from page_runtime.content_hash import sha256_of
from page_runtime.neighbours import GROUP_SIZE, INTERPOLATION_SIZE, LEVELS
from page_training.categories import BUILT_IN, own_folder

# Raise it with every change to scenes, sensor or sampling: frames of different versions must not mix.
SCENES_VERSION = 3
# Of categories whose own scenes, regions or samples changed since.
CATEGORY_VERSIONS = {"arm": 4, "box": 4, "cutter": 4, "eyeglasses": 5}
NEIGHBOUR_TABLES = ("group1", "group2", "group3", "up1", "up2", "up3")
IMAGE_SIZE = 224
SHARD_SIZE = 256
SPLITS = ("train", "validation", "test")


def record_type(num_parts: int) -> np.dtype[Any]:
    """One sample. Points are centred, metres; labels num_parts = background; T_center_part in the centred frame."""
    return np.dtype([
        ("image", np.uint8, (IMAGE_SIZE, IMAGE_SIZE, 3)),
        ("points", np.float32, (LEVELS[0], 3)),
        ("pixels", np.float32, (LEVELS[0], 2)),
        ("normals", np.int8, (LEVELS[0], 3)),
        ("labels", np.uint8, (LEVELS[0],)),
        ("group1", np.int16, (LEVELS[1], GROUP_SIZE)),
        ("group2", np.int16, (LEVELS[2], GROUP_SIZE)),
        ("group3", np.int16, (LEVELS[3], GROUP_SIZE)),
        ("up1", np.int16, (LEVELS[0], INTERPOLATION_SIZE)),
        ("up2", np.int16, (LEVELS[1], INTERPOLATION_SIZE)),
        ("up3", np.int16, (LEVELS[2], INTERPOLATION_SIZE)),
        ("T_center_part", np.float32, (num_parts, 4, 4)),
        ("extents_m", np.float32, (num_parts, 3)),
        ("visible_share", np.float32, (num_parts,)),
    ])  # fmt: skip


def scenes_version(category: str) -> int:
    """Of the frames that `page-train scenes` makes of this category now."""
    return CATEGORY_VERSIONS.get(category, SCENES_VERSION)


def shard_path(root: Path, category: str, split: str, shard: int) -> Path:
    """Where a shard lives under the cache folder; a category of the user's own, made again, has another place."""
    return root / f"{category}-v{scenes_version(category)}{_mark(category)}" / f"{split}-{shard:04d}.npy"


def other_frames(root: Path, category: str) -> list[Path]:
    """Folders of frames that another make of the user's own category, or another release, left under `root`."""
    current = shard_path(root, category, SPLITS[0], 0).parent
    return sorted(path for path in root.glob(f"{category}-v*") if path != current and path.is_dir())


def _mark(category: str) -> str:
    """What tells frames of one make of the user's own category from those of another; empty for built-in ones."""
    files = [own_folder(category) / name for name in ("category.json", "models.npz")]
    if category in BUILT_IN or not all(file.is_file() for file in files):
        return ""
    return "-" + _short_hash(*((file.absolute(), file.stat().st_mtime_ns, file.stat().st_size) for file in files))


@lru_cache(maxsize=32)
def _short_hash(*files: tuple[Path, int, int]) -> str:
    return hashlib.sha256("".join(sha256_of(path) for path, _, _ in files).encode()).hexdigest()[:8]


def open_shards(root: Path, category: str, split: str) -> list[NDArray[Any]]:
    """Memory maps of all shards there are at the moment, in order; ValueError for one that is none."""
    return [_opened(path) for path in sorted(shard_path(root, category, split, 0).parent.glob(f"{split}-*.npy"))]


def _opened(path: Path) -> NDArray[Any]:
    try:
        shard = np.load(path, mmap_mode="r")
    except (ValueError, EOFError, OSError) as error:
        raise ValueError(f"shard {path}: cannot be read ({error}); delete it and make it anew") from error
    if shard.ndim != 1 or not len(shard) or set(shard.dtype.names or ()) != set(record_type(1).names or ()):
        raise ValueError(f"shard {path}: expected records of page-train, got {shard.dtype}; delete it and make it anew")
    return shard


def fault_of(record: Any) -> str | None:
    """What makes a record one that cannot be learned from, None for a sound one."""
    num_parts = record["extents_m"].shape[0]
    for name in ("points", "pixels", "T_center_part", "extents_m"):
        if not np.isfinite(record[name]).all():
            return f"{name} are not finite"
    if (record["extents_m"] <= 0.0).any():
        return f"extents_m are {record['extents_m'].tolist()}"
    if record["labels"].max() > num_parts:
        return f"a label is {record['labels'].max()}, of {num_parts} parts"
    for name, count in zip(NEIGHBOUR_TABLES, (*LEVELS[:3], *LEVELS[1:]), strict=True):
        if record[name].min() < 0 or record[name].max() >= count:
            return f"{name} names points beyond the {count} there are"
    return None
