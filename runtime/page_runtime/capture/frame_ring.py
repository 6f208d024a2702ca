"""Frames in memory that two processes share: a ring of slots, one writer, one reader.

The writer never waits: it fills slot after slot and says in a message which one is new. A slot begins with the number
of the frame in it, written before the pixels: a reader that finds another number after copying knows that the slot was
taken for a newer frame meanwhile.
"""

from __future__ import annotations

import mmap
import os
import threading
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from page_runtime.image_files import depth_in_metres

SLOTS = 4
HEADER_BYTES = 64
Depth = NDArray[np.uint16] | NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class SlotContent:
    """Where a frame lies. metres_per_unit: of uint16 depth; None: depth is float32 metres."""

    slot: int
    number: int
    slot_bytes: int
    width: int
    height: int
    metres_per_unit: float | None

    @property
    def color_bytes(self) -> int:
        """Size of the colour picture, which comes first."""
        return self.width * self.height * 3

    @property
    def depth_type(self) -> type[np.uint16] | type[np.float32]:
        """Of the stored depth values."""
        return np.float32 if self.metres_per_unit is None else np.uint16


class RingWriter:
    """The writing end; `memory` is the descriptor of shared memory, sized by the first frame."""

    def __init__(self, memory: int) -> None:
        self._memory = memory
        self._map: mmap.mmap | None = None
        self._slot_bytes = 0
        self._number = 0
        self._fence = threading.Lock()

    def write(self, color: NDArray[np.uint8], depth: Depth, *, metres_per_unit: float | None) -> SlotContent:
        """Copy a frame in; ValueError when it is larger than the first one."""
        height, width = color.shape[:2]
        needed = HEADER_BYTES + color.nbytes + -color.nbytes % 8 + depth.nbytes
        if self._map is None:
            self._slot_bytes = needed + -needed % mmap.PAGESIZE
            os.ftruncate(self._memory, SLOTS * self._slot_bytes)
            self._map = mmap.mmap(self._memory, SLOTS * self._slot_bytes)
        if needed > self._slot_bytes:
            raise ValueError(
                f"RingWriter: expected frames no larger than the first ({self._slot_bytes} bytes), got {width}x{height}"
                f" ({needed} bytes); open the source anew to change the resolution"
            )
        self._number += 1
        slot = self._number % SLOTS
        content = SlotContent(slot, self._number, self._slot_bytes, width, height, metres_per_unit)
        number, color_place, depth_place = _views(self._map, content)
        number[0] = self._number
        # A lock's release and acquire order memory: no processor may show the pixels before the number.
        with self._fence:
            pass
        with self._fence:
            pass
        np.copyto(color_place, color)
        np.copyto(depth_place, depth)
        return content


class RingReader:
    """The reading end."""

    def __init__(self, memory: int) -> None:
        self._memory = memory
        self._map: mmap.mmap | None = None

    def read(self, content: SlotContent) -> tuple[NDArray[np.uint8], NDArray[np.float32]] | None:
        """color (H,W,3) uint8 RGB and depth_m (H,W) float32 of one frame, copied out; None when it was overwritten."""
        if self._map is None:
            self._map = mmap.mmap(self._memory, SLOTS * content.slot_bytes, prot=mmap.PROT_READ)
        number, color_place, depth_place = _views(self._map, content)
        color = color_place.copy()
        if content.metres_per_unit is None:
            depth_m = depth_place.astype(np.float32, copy=True)
        else:
            depth_m = depth_in_metres(depth_place.view(np.uint16), metres_per_unit=content.metres_per_unit)
        return (color, depth_m) if int(number[0]) == content.number else None

    def close(self) -> None:
        """Give the memory back."""
        if self._map is not None:
            self._map.close()
            self._map = None


def _views(
    memory: mmap.mmap, content: SlotContent
) -> tuple[NDArray[np.uint64], NDArray[np.uint8], NDArray[np.uint16 | np.float32]]:
    begin = content.slot * content.slot_bytes
    pixels = content.width * content.height
    number = np.frombuffer(memory, np.uint64, 1, begin)
    color = np.frombuffer(memory, np.uint8, pixels * 3, begin + HEADER_BYTES)
    depth_begin = begin + HEADER_BYTES + content.color_bytes + -content.color_bytes % 8
    depth = np.frombuffer(memory, content.depth_type, pixels, depth_begin)
    shape = content.height, content.width
    return number, color.reshape(*shape, 3), depth.reshape(shape)
