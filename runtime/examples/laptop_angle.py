"""How far a laptop is open, as a stream: a line for every frame, smoothed, silent where the angle is not known.

python runtime/examples/laptop_angle.py tests/data/laptop --bundle runtime/bundles/laptop.onnx
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Iterator
from math import degrees

from page_runtime import Network, RecordedFrame, estimate, open_source

PROCESS_SIGMA_RAD = 0.2  # how far the lid may have moved between two frames


def hinge_angles(network: Network, frames: Iterable[RecordedFrame]) -> Iterator[tuple[float, float, float]]:
    """(timestamp_s, angle rad, sigma rad) of every frame whose hinge has a state.

    A Kalman filter of one number: the estimate carries its own standard deviation, so nothing is tuned but
    PROCESS_SIGMA_RAD.
    """
    angle, variance = 0.0, float("inf")
    for recorded in frames:
        variance += PROCESS_SIGMA_RAD**2
        for instance in recorded.instances:
            if instance.region is None:
                continue
            (hinge,) = estimate(network, recorded.frame, instance.region, max_looks=1).joints
            if hinge.value is None or hinge.sigma is None:
                continue  # hinge.reason says why
            gain = 1.0 if variance == float("inf") else variance / (variance + hinge.sigma**2)
            angle += gain * (hinge.value - angle)
            variance = hinge.sigma**2 if gain == 1.0 else (1.0 - gain) * variance
            yield recorded.frame.timestamp_s, angle, variance**0.5


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recording")
    parser.add_argument("--bundle", required=True)
    options = parser.parse_args()
    for timestamp_s, angle, sigma in hinge_angles(Network(options.bundle), open_source(options.recording)):
        print(f"{timestamp_s:.3f} s  {degrees(angle):6.1f} deg  +- {degrees(sigma):.1f}", flush=True)


if __name__ == "__main__":
    main()
