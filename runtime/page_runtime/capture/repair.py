"""Recordings that were never finished, or damaged, made playable with all that can still be read."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path

from page_runtime.capture.mcap_file import McapFile
from page_runtime.capture.mcap_recording import SUFFIX, McapWriter
from page_runtime.capture.playback import open_source
from page_runtime.capture.ros_messages import Message
from page_runtime.image_files import SourceError
from page_runtime.recording import finish_recording, is_unfinished


@dataclass(frozen=True, slots=True)
class Repaired:
    """What a repair came to. frames: that can be played. missed: what is lost, by reason."""

    path: Path
    frames: int
    missed: dict[str, int]


def repair(path: Path, target: Path | None = None) -> Repaired:
    """Write a whole copy of the damaged MCAP file, or of the unfinished recording folder, `path`.

    target: its name; by default NAME.repaired beside it. The damaged one stays as it is. SourceError when nothing can
    be recovered, or `path` is of another kind.
    """
    if path.is_dir() and is_unfinished(path):
        goal = target or path.with_name(f"{path.name.removeprefix('.').removesuffix('.partial')}.repaired")
        _require_new(goal)
        shutil.copytree(path, goal)
        try:
            frames, lost = finish_recording(goal)
        except BaseException:
            shutil.rmtree(goal, ignore_errors=True)
            raise
        return Repaired(goal, frames, {"frames whose pictures were not finished": lost} if lost else {})
    files = [path] if path.is_file() else sorted(path.glob(f"*{SUFFIX}"))
    if len(files) != 1 or files[0].suffix.lower() != SUFFIX:
        raise SourceError(
            f"{path}: expected an .mcap file, a bag's folder with one in it, or the unfinished folder of a recording "
            "(.NAME.partial); nothing else can be repaired"
        )
    goal = target or path.with_name(f"{path.name.removesuffix(SUFFIX)}.repaired{SUFFIX}")
    _require_new(goal)
    return _repair_mcap(files[0], goal)


def _require_new(target: Path) -> None:
    if target.exists():
        raise FileExistsError(f"{target}: exists already; nothing is ever overwritten, give another name with --out")


def _repair_mcap(path: Path, target: Path) -> Repaired:
    damaged = McapFile(path)
    kinds = {channel.topic: channel for channel in damaged.channels}
    if not damaged.messages or any(channel.encoding != "cdr" for channel in kinds.values()):
        raise SourceError(f"{path}: no ROS 2 message in it can be read; there is nothing to recover")
    try:
        with McapWriter(target) as writer:
            for name, data in damaged.attachments.items():
                writer.attach(name, data)
            for ref in damaged.messages:
                writer.write(Message(ref.topic, kinds[ref.topic].kind, ref.log_time_ns, damaged.read(ref)))
        played = open_source(target)
    except BaseException:
        target.unlink(missing_ok=True)
        raise
    finally:
        damaged.close()
    return Repaired(target, len(played), {**damaged.missed, **played.counts.unpaired})
