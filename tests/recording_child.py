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
        say("dead")


def say(what: object) -> None:
    sys.stdout.write(f"{what}\n")
    sys.stdout.flush()


def record(target: Path) -> None:
    say(os.getpid())
    with frame_writer(target, category="box", part_names=("base", "lid")) as writer:
        for recorded in recorded_toy.endless():
            say(writer.write(recorded, calibration='{"serial": 1}'))


if __name__ == "__main__":
    main()
