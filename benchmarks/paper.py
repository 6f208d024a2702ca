"""The figures of the paper's Tables I to XI, as it prints them.

Rotations are mean errors in degrees, translations in metres, IoU in percent, one figure for each part in the paper's
order. Its data (ArtImage, ReArtMix, RobotArm) and evaluation (rotations folded and capped) are not ours: beside our
figures they say what was claimed, no more.
"""

from __future__ import annotations

from dataclasses import dataclass

OURS = "PAGE"


@dataclass(frozen=True, slots=True)
class Row:
    """rotation_deg, translation_m, iou: of the parts in order; () where the table has none. accuracy: of the part
    segmentation, a share."""

    category: str
    method: str
    rotation_deg: tuple[float, ...] = ()
    translation_m: tuple[float, ...] = ()
    iou: tuple[float, ...] = ()
    accuracy: float | None = None


@dataclass(frozen=True, slots=True)
class PaperTable:
    """number: roman. data: what the paper measured on."""

    number: str
    title: str
    data: str
    rows: tuple[Row, ...]


TABLE_1 = PaperTable("I", "comparison with other methods", "ArtImage, synthetic", (
    Row("laptop", "A-NCSH", (5.3, 5.4), (0.054, 0.043), (56.7, 40.2)),
    Row("laptop", "DenseFusion", (5.4, 4.3), (0.062, 0.061), (43.5, 24.1)),
    Row("laptop", "PoseCNN", (5.1, 4.7), (0.047, 0.056), (49.2, 36.7)),
    Row("laptop", "6-PACK", (5.0, 4.5), (0.046, 0.037), (52.3, 41.1)),
    Row("laptop", "CPPF", (4.7, 4.5), (0.043, 0.032), (59.2, 44.3)),
    Row("laptop", "ASMM", (4.9, 4.4), (0.048, 0.042), (58.1, 43.5)),
    Row("laptop", OURS, (4.0, 1.7), (0.014, 0.019), (64.6, 50.4)),
    Row("eyeglasses", "A-NCSH", (3.5, 18.3, 18.2), (0.043, 0.286, 0.283), (52.5, 40.2, 39.6)),
    Row("eyeglasses", "DenseFusion", (4.9, 7.5, 7.5), (0.062, 0.103, 0.104), (46.8, 41.5, 38.4)),
    Row("eyeglasses", "PoseCNN", (4.2, 8.2, 9.3), (0.058, 0.142, 0.158), (43.2, 39.8, 36.5)),
    Row("eyeglasses", "6-PACK", (3.7, 6.8, 7.4), (0.046, 0.098, 0.101), (47.2, 45.1, 39.9)),
    Row("eyeglasses", "CPPF", (3.3, 5.8, 5.9), (0.038, 0.086, 0.125), (54.1, 42.8, 43.7)),
    Row("eyeglasses", "ASMM", (3.5, 6.1, 6.4), (0.041, 0.235, 0.236), (51.2, 43.1, 41.5)),
    Row("eyeglasses", OURS, (3.2, 5.2, 5.1), (0.027, 0.075, 0.071), (58.6, 46.5, 51.7)),
    Row("dishwasher", "A-NCSH", (4.0, 4.8), (0.059, 0.123), (84.3, 56.2)),
    Row("dishwasher", "DenseFusion", (6.0, 6.2), (0.104, 0.142), (66.5, 38.9)),
    Row("dishwasher", "PoseCNN", (6.5, 7.1), (0.128, 0.153), (61.7, 49.0)),
    Row("dishwasher", "6-PACK", (9.3, 8.7), (0.135, 0.146), (55.4, 35.1)),
    Row("dishwasher", "CPPF", (5.8, 5.4), (0.078, 0.095), (80.1, 62.4)),
    Row("dishwasher", "ASMM", (12.5, 4.6), (0.146, 0.184), (43.8, 28.6)),
    Row("dishwasher", OURS, (3.9, 4.3), (0.055, 0.079), (89.3, 67.6)),
    Row("scissors", "A-NCSH", (2.0, 2.6), (0.035, 0.021), (45.8, 44.8)),
    Row("scissors", "DenseFusion", (3.9, 3.4), (0.048, 0.039), (35.6, 34.5)),
    Row("scissors", "PoseCNN", (4.1, 4.2), (0.055, 0.046), (33.1, 32.6)),
    Row("scissors", "6-PACK", (3.8, 6.2), (0.047, 0.066), (37.2, 34.5)),
    Row("scissors", "CPPF", (3.2, 5.7), (0.024, 0.045), (44.9, 38.2)),
    Row("scissors", "ASMM", (3.6, 4.7), (0.047, 0.060), (38.4, 29.0)),
    Row("scissors", OURS, (1.9, 5.4), (0.013, 0.032), (47.9, 48.6)),
    Row("drawer", "A-NCSH", (2.8, 3.3, 3.5, 2.7), (0.041, 0.145, 0.137, 0.072), (90.5, 82.1, 79.4, 83.7)),
    Row("drawer", "DenseFusion", (4.4, 4.4, 4.4, 4.4), (0.111, 0.143, 0.144, 0.115), (75.8, 73.4, 70.2, 71.3)),
    Row("drawer", "PoseCNN", (3.7, 3.7, 4.3, 4.2), (0.058, 0.122, 0.131, 0.087), (78.2, 71.8, 69.5, 70.3)),
    Row("drawer", "6-PACK", (3.2, 5.2, 4.7, 4.9), (0.122, 0.103, 0.110, 0.138), (81.9, 71.2, 73.4, 70.7)),
    Row("drawer", "CPPF", (2.9, 4.3, 4.4, 4.0), (0.076, 0.243, 0.136, 0.152), (83.5, 72.8, 70.6, 74.5)),
    Row("drawer", "ASMM", (3.2, 3.6, 3.5, 3.8), (0.124, 0.178, 0.175, 0.121), (80.3, 74.2, 75.7, 74.4)),
    Row("drawer", OURS, (2.8, 2.8, 2.8, 2.8), (0.010, 0.017, 0.015, 0.013), (91.8, 87.6, 85.0, 86.2)),
))  # fmt: skip

TABLE_2 = PaperTable("II", "ablations", "ArtImage, scissors", (
    Row("scissors", "keypoints: FPS", (11.2, 12.6), (0.086, 0.112)),
    Row("scissors", "keypoints: box", (9.8, 10.5), (0.042, 0.085)),
    Row("scissors", "keypoints: pre-defined", (1.9, 5.4), (0.013, 0.032)),
    Row("scissors", "fusion: concatenation", (2.6, 7.1), (0.025, 0.056)),
    Row("scissors", "fusion: dense", (2.3, 6.5), (0.020, 0.045)),
    Row("scissors", "fusion: PAGE", (1.9, 5.4), (0.013, 0.032)),
    Row("scissors", "3 keypoints", (1.9, 5.4), (0.013, 0.032)),
    Row("scissors", "4 keypoints", (1.8, 5.2), (0.011, 0.031)),
    Row("scissors", "5 keypoints", (1.7, 5.1), (0.010, 0.027)),
    Row("scissors", "prediction: direct regression", (10.5, 15.4), (0.135, 0.237)),
    Row("scissors", "prediction: scoring", (1.7, 5.1), (0.010, 0.027)),
    Row("scissors", "voting: 6-PACK", (7.8, 8.5), (0.068, 0.064)),
    Row("scissors", "voting: PAGE", (1.7, 5.1), (0.010, 0.027)),
))  # fmt: skip

TABLE_3 = PaperTable("III", "semi-synthetic scenes", "ReArtMix", (
    Row("box", "A-NCSH", (4.1, 3.5), (0.023, 0.034)),
    Row("box", OURS, (4.4, 1.3), (0.015, 0.017)),
    Row("stapler", "A-NCSH", (5.1, 6.4), (0.034, 0.041)),
    Row("stapler", OURS, (2.6, 3.1), (0.027, 0.031)),
    Row("cutter", "A-NCSH", (3.1, 3.4), (0.017, 0.021)),
    Row("cutter", OURS, (1.4, 1.4), (0.015, 0.016)),
    Row("scissors", "A-NCSH", (5.7, 5.4), (0.013, 0.015)),
    Row("scissors", OURS, (1.6, 1.3), (0.018, 0.012)),
    Row("drawer", "A-NCSH", (3.4, 3.6), (0.022, 0.021)),
    Row("drawer", OURS, (1.2, 1.2), (0.013, 0.017)),
))  # fmt: skip

TABLE_4 = PaperTable("IV", "colour and part segmentation", "ArtImage, synthetic", (
    Row("eyeglasses", "depth", (5.3, 8.1, 8.5), (0.062, 0.112, 0.123), accuracy=0.97),
    Row("eyeglasses", "depth and colour", (3.2, 5.2, 5.1), (0.027, 0.075, 0.071), accuracy=0.99),
    Row("scissors", "depth", (3.9, 7.3), (0.039, 0.058), accuracy=0.96),
    Row("scissors", "depth and colour", (1.9, 5.4), (0.013, 0.032), accuracy=0.98),
    Row("laptop", "depth", (6.7, 4.2), (0.072, 0.053), accuracy=0.95),
    Row("laptop", "depth and colour", (4.0, 1.7), (0.014, 0.019), accuracy=0.97),
    Row("dishwasher", "depth", (6.1, 7.5), (0.086, 0.102), accuracy=0.98),
    Row("dishwasher", "depth and colour", (3.9, 4.3), (0.055, 0.079), accuracy=0.99),
    Row("drawer", "depth", (4.4, 4.4, 4.4, 4.4), (0.031, 0.263, 0.272, 0.243), accuracy=0.94),
    Row("drawer", "depth and colour", (2.8, 2.8, 2.8, 2.8), (0.010, 0.017, 0.015, 0.013), accuracy=0.98),
))  # fmt: skip

TABLE_5 = PaperTable("V", "an arm of seven parts", "RobotArm, real", (
    Row("arm", "A-NCSH", (7.6, 7.8, 10.1, 10.3, 10.8, 15.7, 22.3),
        (0.011, 0.042, 0.066, 0.060, 0.075, 0.232, 0.399)),
    Row("arm", OURS, (3.7, 3.4, 3.5, 4.6, 5.5, 12.1, 19.8), (0.003, 0.006, 0.011, 0.013, 0.018, 0.089, 0.167)),
))  # fmt: skip

TABLE_6 = PaperTable("VI", "weights of segmentation and radius loss", "ArtImage, scissors", (
    Row("scissors", "tau 0.9, 0.1", (8.8, 12.8), (0.123, 0.227)),
    Row("scissors", "tau 0.75, 0.25", (3.2, 9.8), (0.045, 0.086)),
    Row("scissors", "tau 0.5, 0.5", (2.1, 5.9), (0.023, 0.040)),
    Row("scissors", "tau 0.25, 0.75", (1.9, 5.4), (0.013, 0.032)),
    Row("scissors", "tau 0.1, 0.9", (1.8, 5.3), (0.013, 0.030)),
))  # fmt: skip

TABLE_7 = PaperTable("VII", "weights of the KP-Estimator's losses", "ArtImage, scissors", (
    Row("scissors", "lambda 0.2, 0.4, 0.4", (3.8, 8.5), (0.068, 0.142)),
    Row("scissors", "lambda 0.4, 0.3, 0.3", (2.1, 5.8), (0.019, 0.077)),
    Row("scissors", "lambda 0.6, 0.2, 0.2", (1.9, 5.4), (0.013, 0.032)),
    Row("scissors", "lambda 0.8, 0.1, 0.1", (1.9, 5.3), (0.014, 0.032)),
))  # fmt: skip

# By how much of a part is hidden: its heading says visibility too, its text calls the last row the extreme occlusion.
TABLE_8 = PaperTable("VIII", "self-occlusion", "ArtImage, drawer", (
    Row("drawer", "0 to 40 %", (2.2,), (0.013,)),
    Row("drawer", "40 to 80 %", (2.7,), (0.013,)),
    Row("drawer", "80 to 100 %", (3.1,), (0.016,)),
))  # fmt: skip

TABLE_9 = PaperTable("IX", "noise on the points", "ArtImage, laptop", (
    Row("laptop", "Gaussian, CPPF", (4.9, 3.6), (0.039, 0.066)),
    Row("laptop", "Gaussian, PAGE", (4.3, 1.9), (0.019, 0.030)),
    Row("laptop", "scaling, CPPF", (4.9, 4.5), (0.036, 0.036)),
    Row("laptop", "scaling, PAGE", (4.1, 1.7), (0.016, 0.028)),
    Row("laptop", "offset, CPPF", (7.8, 4.3), (0.089, 0.053)),
    Row("laptop", "offset, PAGE", (4.4, 1.8), (0.015, 0.023)),
))  # fmt: skip

# Table X: variance of the radii of three keypoints, laptop.
RADIUS_VARIANCE = {"pre-defined": (0.039, 0.063, 0.027), "FPS": (0.193, 0.115, 0.104)}
# Table XI: frames a second on an RTX 4090, and the times in the text of section VII.
FRAMES_PER_S = {"DenseFusion": 4.54, "ASMM": 5.13, OURS: 6.25}
TIME_MS = {"DenseFusion": (220.0, 10.0), "ASMM": (195.0, 10.0), OURS: (160.0, 10.0)}

TABLES = (TABLE_1, TABLE_2, TABLE_3, TABLE_4, TABLE_5, TABLE_6, TABLE_7, TABLE_8, TABLE_9)


def rows_of(table: PaperTable, category: str) -> tuple[Row, ...]:
    """The table's rows of a category, () where it has none."""
    return tuple(row for row in table.rows if row.category == category)
