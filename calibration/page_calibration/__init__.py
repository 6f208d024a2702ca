"""page_calibration: where K, R and t come from.

    calibration = read_calibration("eeprom.json")        # any format
    T_color_depth = calibration.transform("color", "depth")
    text = written(calibration, "kalibr").text           # .lost says what Kalibr cannot hold

Importing the package loads none of it: each name brings its module when it is first used.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from page_calibration.board import Board, View, find_board
    from page_calibration.calibration import CalibratedCamera, Calibration, CalibrationError
    from page_calibration.check import check_pair
    from page_calibration.formats.registry import read_calibration, written
    from page_calibration.hand_eye import solve_hand_eye
    from page_calibration.intrinsics import calibrate_intrinsics
    from page_calibration.registered_check import check_frames
    from page_calibration.stereo import calibrate_stereo

_MODULE_OF_NAME = {
    "Board": "board",
    "CalibratedCamera": "calibration",
    "Calibration": "calibration",
    "CalibrationError": "calibration",
    "View": "board",
    "calibrate_intrinsics": "intrinsics",
    "calibrate_stereo": "stereo",
    "check_frames": "registered_check",
    "check_pair": "check",
    "find_board": "board",
    "read_calibration": "formats.registry",
    "solve_hand_eye": "hand_eye",
    "written": "formats.registry",
}

__all__ = [
    "Board",
    "CalibratedCamera",
    "Calibration",
    "CalibrationError",
    "View",
    "calibrate_intrinsics",
    "calibrate_stereo",
    "check_frames",
    "check_pair",
    "find_board",
    "read_calibration",
    "solve_hand_eye",
    "written",
]


def __getattr__(name: str) -> Any:
    if name not in _MODULE_OF_NAME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULE_OF_NAME[name]}"), name)


def __dir__() -> list[str]:
    return sorted(__all__)
