"""page-runtime devices: the cameras that can be used."""

from __future__ import annotations

import json
import sys
from dataclasses import asdict

from page_runtime.capture.frame_service import DeviceUnavailable
from page_runtime.capture.oak import WHAT_TO_CHECK, connected_devices
from page_runtime.commands.terminal import table


def devices(*, as_json: bool) -> None:
    """List OAK cameras on standard output; DeviceUnavailable when there is none."""
    found = connected_devices()
    if as_json:
        sys.stdout.write(json.dumps([asdict(device) for device in found]) + "\n")
    elif found:
        rows = [(f"oak:{d.device_id}", d.name, d.platform, d.protocol, d.state) for d in found]
        sys.stdout.write(table(("source", "name", "platform", "protocol", "state"), rows))
    if not found:
        raise DeviceUnavailable(f"no OAK camera found; {WHAT_TO_CHECK}")
