"""What a format is: how it is recognised, read, and written."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from page_calibration.calibration import CalibratedCamera, Calibration
from page_calibration.formats.document import Document


@dataclass(frozen=True, slots=True)
class Read:
    """Cameras read, what the file says that has no place in a calibration, and what looks wrong."""

    cameras: tuple[CalibratedCamera, ...]
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Format:
    """name: on command lines. title: in words. suffix: of files written.

    `write` puts down what the format can hold; what it cannot is found by reading the text again (registry.written).
    """

    name: str
    title: str
    suffix: str
    recognises: Callable[[Document], bool]
    read: Callable[[Document], Read]
    write: Callable[[Calibration], str]
