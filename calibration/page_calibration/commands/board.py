"""page-calibrate board: a board to print at its true size."""

from __future__ import annotations

import base64
import sys
from pathlib import Path
from typing import Any

import cv2

from page_calibration.commands.inputs import board_of, require_places, write_text

PIXELS_PER_SQUARE = 120


def board(*, out: Path, **options: Any) -> None:
    """An SVG in millimetres with a white margin of one square. What came out of the printer is still to be measured."""
    made = board_of({"board": options.pop("board"), **options})
    require_places(out, None)
    _, data = cv2.imencode(".png", made.picture(PIXELS_PER_SQUARE))
    side = made.square_m * 1e3
    width, height = made.columns * side, made.rows * side
    text = (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width + 2 * side:g}mm" height="{height + 2 * side:g}mm" '
        f'viewBox="0 0 {width + 2 * side:g} {height + 2 * side:g}"><rect width="100%" height="100%" fill="white"/>'
        f'<image x="{side:g}" y="{side:g}" width="{width:g}" height="{height:g}" style="image-rendering:pixelated" '
        f'href="data:image/png;base64,{base64.b64encode(data.tobytes()).decode()}"/>'
        f'<text x="{side:g}" y="{height + 1.7 * side:g}" font-size="{0.25 * side:g}">{made}</text></svg>\n'
    )
    write_text(out, text)
    sys.stdout.write(f"{out}: {made}; print at 100 %, glue it to something flat, and measure a square\n")
