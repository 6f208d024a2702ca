"""A real session that keeps the samples it was given."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from page_runtime.network import Network, NetworkOutput
from page_runtime.sampling import RegionSample


class WatchedNetwork(Network):
    """`Network`, of a category that is taken for one of thin objects or not, whatever its bundle says."""

    def __init__(self, bundle: Path, *, focused: bool) -> None:
        super().__init__(bundle, threads=1)
        self.metadata = replace(self.metadata, category=replace(self.metadata.category, focused=focused))
        self.samples: list[RegionSample] = []

    def run(self, sample: RegionSample, *arguments: Any, **more: Any) -> NetworkOutput:
        """The network's answer; the sample is kept first."""
        self.samples.append(sample)
        return super().run(sample, *arguments, **more)

    def focused(self) -> list[bool]:
        """Of each sample since this was last asked, whether its points were taken where the object had been seen."""
        found = [sample.focus is not None for sample in self.samples]
        self.samples = []
        return found
