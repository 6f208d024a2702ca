"""page-calibrate: where K, R and t come from, in every format, and whether they fit what was recorded."""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path

from page_runtime.cli import EXIT_BAD_INPUT, EXIT_INTERRUPTED, Parser
from page_runtime.commands.usage import UsageError

EXIT_DOES_NOT_FIT = 1
FORMATS = (
    "page", "oak", "ros", "ros-json", "ros-ini", "kalibr", "open3d", "open3d-parameters", "bop", "bop-scene",
    "tum", "opencv",
)  # fmt: skip


def main(arguments: list[str] | None = None) -> int:
    """Run page-calibrate; returns the exit code: 0 done, 1 `check` found what does not fit, 2 bad input (nothing was
    written), 130 interrupted."""
    os.environ.setdefault("OPENCV_LOG_LEVEL", "SILENT")
    try:
        options = vars(_parser().parse_args(arguments))
        command = options.pop("command").replace("-", "_")
        return _call(command, options)
    except (UsageError, OSError) as error:
        return _refuse(error)
    except KeyboardInterrupt:
        sys.stderr.write("page-calibrate: interrupted\n")
        return EXIT_INTERRUPTED


def _call(command: str, options: dict[str, object]) -> int:
    """The command's function with its options; errors in what it was given become one sentence."""
    from importlib import import_module

    from page_calibration.calibration import CalibrationError
    from page_runtime.image_files import SourceError

    try:
        return getattr(import_module(f"page_calibration.commands.{command}"), command)(**options) or 0
    except (CalibrationError, SourceError) as error:
        return _refuse(error)


def _refuse(error: Exception) -> int:
    sys.stderr.write(f"page-calibrate: {' '.join(str(error).split())}\n")
    return EXIT_BAD_INPUT


def _parser() -> argparse.ArgumentParser:
    parser = Parser(prog="page-calibrate", description=__doc__)
    commands = parser.add_subparsers(required=True, metavar="COMMAND", dest="command")

    def command(name: str, description: str) -> argparse.ArgumentParser:
        return commands.add_parser(name, help=description, description=description)

    def output(sub: argparse.ArgumentParser, *, required: bool = True) -> None:
        sub.add_argument("-o", "--out", metavar="FILE", type=Path, required=required, help="the camera.json to write")
        sub.add_argument("--report", metavar="FILE", type=Path, help="write a one-page HTML report here")

    def calibration(sub: argparse.ArgumentParser) -> None:
        sub.add_argument("--camera", metavar="FILE", type=Path, required=True, help="its calibration, any format")
        sub.add_argument("--frame", metavar="NAME", help="which camera of it (default: the only one)")

    board = command("board", "write a board to print, in millimetres, as SVG")
    _board_options(board)
    board.add_argument("-o", "--out", metavar="FILE", type=Path, required=True, help="the .svg file to write")

    inspect = command("inspect", "say what a calibration holds, in metres and OpenCV axes")
    inspect.add_argument("path", metavar="FILE", type=Path, help="a calibration of any format")
    inspect.add_argument("--size", metavar="WxH", type=_size, help="the picture size, for formats that do not say")

    convert = command("convert", "bring a calibration into another format")
    convert.add_argument("path", metavar="FILE", type=Path, help="a calibration of any format")
    convert.add_argument("-o", "--out", metavar="FILE", type=Path, required=True, help="the file to write")
    convert.add_argument("--to", choices=FORMATS, default="page", help="default: page, the project's camera.json")
    convert.add_argument("--frame", metavar="NAME", help="only this camera of it")
    convert.add_argument("--size", metavar="WxH", type=_size, help="the picture size, for formats that do not say")
    convert.add_argument(
        "--delivered",
        metavar="WxH",
        type=_size,
        help="K of the picture a device delivers: scaled to cover this size, cut",
    )
    convert.add_argument("--allow-loss", action="store_true", help="write although the format cannot hold all of it")

    camera = command("camera", "calibrate K and lens of one camera from pictures of a board")
    camera.add_argument("source", metavar="SOURCE", help="a folder of pictures, a video, or the number of a camera")
    _board_options(camera)
    camera.add_argument("--lens", choices=("plumb-bob", "rational", "fisheye"), default="plumb-bob", help="its model")
    camera.add_argument("--name", default="camera", help="the camera's name in camera.json")
    camera.add_argument("--views", metavar="N", type=int, default=25, help="views to take from a video or camera")
    output(camera)

    stereo = command("stereo", "calibrate where two cameras are to each other")
    stereo.add_argument("first", metavar="PICTURES_A", type=Path, help="a folder; pictures of one moment have one name")
    stereo.add_argument("second", metavar="PICTURES_B", type=Path, help="the other camera's folder")
    stereo.add_argument("--cameras", metavar="FILE", type=Path, nargs=2, required=True, help="their calibrations")
    _board_options(stereo)
    output(stereo)

    extrinsics = command("extrinsics", "find where a camera that stands still is, from a board")
    extrinsics.add_argument("pictures", metavar="PICTURES", type=Path, help="a folder; camera and board stand still")
    calibration(extrinsics)
    _board_options(extrinsics)
    extrinsics.add_argument(
        "--board-pose", metavar="FILE", type=Path, help='{"T_world_board": 4x4}: where the board is'
    )
    extrinsics.add_argument("--world", metavar="NAME", default="world", help="the world frame's name")
    output(extrinsics)

    hand_eye = command("hand-eye", "find where a camera is on a robot's hand, or before the robot")
    hand_eye.add_argument(
        "--robot", metavar="POSES", type=Path, required=True, help="T_base_hand: JSON, or ViSP's folder"
    )
    hand_eye.add_argument(
        "--target", metavar="POSES", type=Path, help="T_camera_target: JSON, or a folder of ViSP poses"
    )
    hand_eye.add_argument("--pictures", metavar="FOLDER", type=Path, help="pictures of a board, instead of --target")
    hand_eye.add_argument("--mount", choices=("eye-in-hand", "eye-to-hand"), default="eye-in-hand")
    calibration(hand_eye)
    _board_options(hand_eye, required=False)
    output(hand_eye)

    register = command("register", "raw colour and depth pictures to a folder that page-runtime plays")
    register.add_argument(
        "path", metavar="RAW", type=Path, help="a folder with color/ and depth/ as the cameras took them"
    )
    register.add_argument("--camera", metavar="FILE", type=Path, required=True, help="the calibration of both cameras")
    register.add_argument(
        "--frames", metavar=("COLOR", "DEPTH"), nargs=2, default=("color", "depth"), help="their names"
    )
    register.add_argument("-o", "--out", metavar="FOLDER", type=Path, required=True, help="the folder to write")

    check = command("check", "does this calibration fit this recording? exit code 1 when it does not")
    check.add_argument(
        "path", metavar="RECORDING", type=Path, help="raw color/ and depth/, or a source page-runtime plays"
    )
    check.add_argument("--camera", metavar="FILE", type=Path, help="the calibration (default: the recording's own)")
    check.add_argument("--frames", metavar=("COLOR", "DEPTH"), nargs=2, default=("color", "depth"), help="their names")
    check.add_argument("--report", metavar="FILE", type=Path, help="write a one-page HTML report here")
    return parser


def _board_options(sub: argparse.ArgumentParser, *, required: bool = True) -> None:
    sub.add_argument("--board", choices=("charuco", "chessboard"), default="charuco")
    sub.add_argument("--squares", metavar="CxR", type=_size, required=required, help="columns x rows of squares")
    sub.add_argument("--square-mm", metavar="MM", type=float, required=required, help="side of a square, measured")
    sub.add_argument("--marker-mm", metavar="MM", type=float, default=0.0, help="side of a marker (charuco)")
    sub.add_argument("--dictionary", metavar="NAME", default="5X5_100", help="of the markers (default: 5X5_100)")
    sub.add_argument("--legacy", action="store_true", help="a charuco board printed before OpenCV 4.6")


def _size(text: str) -> tuple[int, int]:
    try:
        width, height = (int(value) for value in text.lower().split("x"))
    except ValueError:
        raise argparse.ArgumentTypeError(f"expected WIDTHxHEIGHT, got {text!r}") from None
    if width < 1 or height < 1:
        raise argparse.ArgumentTypeError(f"expected WIDTHxHEIGHT, got {text!r}")
    return width, height


if __name__ == "__main__":
    sys.exit(main())
