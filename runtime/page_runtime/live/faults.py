"""What is raised unforeseen while a frame is worked on: it costs that frame, or one object in it, and not the loop."""

from __future__ import annotations

import sysconfig
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from page_runtime.bundle_fields import BundleError
from page_runtime.image_files import SourceError
from page_runtime.live.locate import RegionError

# Frames in a row from which nothing came but faults: a second of a camera's.
MOST_FAILING = 30
# These say what was given and the way out, and hold for every further frame.
FORESEEN = (SourceError, BundleError, RegionError)
PACKAGE = Path(__file__).resolve().parents[1]
_LIBRARIES = tuple({Path(sysconfig.get_path(name)).resolve() for name in ("stdlib", "purelib", "platlib")})

T = TypeVar("T")


class FramesFailing(RuntimeError):
    """Every frame fails: there is nothing to wait for. `__cause__` is what the last one raised."""


@dataclass(frozen=True, eq=False, slots=True)
class FrameFault:
    """An exception that cost a frame (`subject` empty), or the object or place in it that `subject` names. frame: its
    index in the source. As text a sentence with the exception's type and where it was raised."""

    frame: int
    subject: str
    error: Exception

    @property
    def kind(self) -> tuple[str, str]:
        """Type and place: the same for what is the same mistake in another frame."""
        return type(self.error).__name__, _place(self.error)

    @property
    def reason(self) -> str:
        """What was raised and where, without the frame."""
        name, place = self.kind
        return f"{name} at {place}: {' '.join(str(self.error).split()) or 'without a word'}"

    def __str__(self) -> str:
        return f"frame {self.frame}{self.subject and f', {self.subject}'}: {self.reason}"


def attempt(work: Callable[[], T], *, frame: int, subject: str = "") -> T | FrameFault:
    """What `work` gives, or what became of it. Errors that are FORESEEN are raised."""
    try:
        return work()
    except FORESEEN:
        raise
    except Exception as error:
        # Whatever one strange frame makes a stage or a library raise; a programming error shows by its type and place.
        return FrameFault(frame, subject, error)


def _place(error: Exception) -> str:
    """FILE:LINE in FUNCTION, where our own code, or the caller's, stood when it was raised."""
    frames = traceback.extract_tb(error.__traceback__)
    own = [one for one in frames if not _is_library(Path(one.filename).resolve())] or frames
    if not own:
        return "an unknown place"
    path = Path(own[-1].filename).resolve()
    name = path.relative_to(PACKAGE.parent) if path.is_relative_to(PACKAGE) else path.name
    return f"{name}:{own[-1].lineno} in {own[-1].name}"


def _is_library(path: Path) -> bool:
    return not path.is_relative_to(PACKAGE) and any(path.is_relative_to(folder) for folder in _LIBRARIES)
