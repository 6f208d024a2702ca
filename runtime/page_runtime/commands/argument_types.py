"""What options accept: functions for argparse's `type`, which say what was expected. Imports nothing heavy."""

from __future__ import annotations

import argparse

from page_runtime.machine import check_threads


def seconds_of_milliseconds(text: str) -> float:
    """Milliseconds from 0 on, as seconds."""
    try:
        value = float(text) * 1e-3
    except ValueError:
        value = -1.0
    if not 0 <= value < float("inf"):
        raise argparse.ArgumentTypeError(f"expected milliseconds from 0 on, got {text!r}")
    return value


def region(text: str) -> tuple[int, int, int, int]:
    """x,y,w,h in whole pixels."""
    try:
        x, y, width, height = (int(value) for value in text.split(","))
    except ValueError:
        raise argparse.ArgumentTypeError(f"expected four whole numbers x,y,w,h in pixels, got {text!r}") from None
    return x, y, width, height


def region_or_auto(text: str) -> tuple[int, int, int, int] | str:
    """A region, or "auto"."""
    return text if text == "auto" else region(text)


def names(text: str) -> tuple[str, ...]:
    """Names separated by commas."""
    given = tuple(name.strip() for name in text.split(","))
    if not all(given):
        raise argparse.ArgumentTypeError(f"expected names or numbers separated by commas, got {text!r}")
    return given


def positive_ms(text: str) -> float:
    """Milliseconds above 0."""
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"expected milliseconds > 0, got {text!r}")
    return value


def count(text: str) -> int:
    """A whole number from 0 on."""
    if not text.isascii() or not text.isdigit():
        raise argparse.ArgumentTypeError(f"expected a whole number from 0 on, got {text!r}")
    return int(text)


def threads(text: str) -> int:
    """A number of threads that a session may have, or 0."""
    number = count(text)
    try:
        check_threads(number)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error).removeprefix("threads: ")) from error
    return number


def positive_seconds(text: str) -> float:
    """Seconds above 0."""
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"expected seconds above 0, got {text!r}")
    return value
