"""Reports of a training as TensorBoard events, beside what every run folder has."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from torch.utils.tensorboard import SummaryWriter

if TYPE_CHECKING:
    from page_training.train import Report


class EventLog:
    """Scalars of training and validation, and the picture of each validation, in `folder`."""

    def __init__(self, folder: Path) -> None:
        self._writer = SummaryWriter(str(folder))

    def add(self, report: Report) -> None:
        self._writer.add_scalar("speed/frames_per_s", report.samples_per_s, report.step)
        for kind, losses in (("training", report.losses), ("validation", report.validation or {})):
            for name, value in losses.items():
                self._writer.add_scalar(f"{kind}/{name}", value, report.step)
        if report.picture is not None:
            self._writer.add_image("validation", report.picture, report.step, dataformats="HWC")

    def close(self) -> None:
        self._writer.close()
