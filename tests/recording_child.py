"""Records into each target it is told of, in a fork that is to be killed: its process id, then the number of every
frame once it is written, then "dead"."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import recorded_toy
from page_runtime.capture.conversion import frame_writer


def main() -> None:
    for line in sys.stdin:
        process = os.fork()
        if process == 0:
            record(Path(line.strip()))
        os.waitpid(process, 0)
        print("dead", flush=True)


def record(target: Path) -> None:
    print(os.getpid(), flush=True)
    with frame_writer(target, category="box", part_names=("base", "lid")) as writer:
        for recorded in recorded_toy.endless():
            print(writer.write(recorded, calibration='{"serial": 1}'), flush=True)


if __name__ == "__main__":
    main()
