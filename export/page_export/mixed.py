"""Which groups of layers may be computed in 8 bits: each measured alone, then the least harmful of those that pay
together, as far as poses allow."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from page_export.bundle_writer import bundle_bytes, write_file
from page_export.optimisation import AS_QUICK, THREADS, Measured, TrueSample, measure
from page_export.variants import Forms, Layer
from page_runtime.bundle import BundleMetadata

# Regions the search looks at, one round; none of those the table is measured on.
SEARCH_FRAMES = 24


@dataclass(frozen=True, slots=True)
class GroupCost:
    """A group of layers in 8 bits, the rest as it is. saved_bytes: of the file. time: of a forward pass, of the
    original's, the worse of one and two threads. error, failures: as of `Measured`, and of the original."""

    name: str
    layers: int
    multiplications: float
    saved_bytes: int
    time: float
    error: float
    more_failures: float

    @property
    def pays(self) -> bool:
        """Whether it is quicker by more than measurements differ."""
        return self.time < 1.0 / AS_QUICK

    def harmless(self, bound: float) -> bool:
        """Whether its poses are within the limit."""
        return self.error <= bound and self.more_failures <= 0.01


@dataclass(frozen=True, slots=True)
class Search:
    """groups: from the least harmful on. chosen: names of those that are in 8 bits together; none where none pays."""

    groups: tuple[GroupCost, ...]
    chosen: tuple[str, ...]

    def document(self) -> dict[str, Any]:
        """In JSON's types."""
        return {"groups": [asdict(group) for group in self.groups], "chosen": list(self.chosen)}


def grouped(layers: Sequence[Layer]) -> dict[str, list[Layer]]:
    """Layers that work on the same number of places: convolutions by the size of their map, products by their rows."""
    groups: dict[str, list[Layer]] = {}
    for layer in layers:
        groups.setdefault(layer.works_on, []).append(layer)
    return groups


def search(
    bundle: Path,
    metadata: BundleMetadata,
    forms: Forms,
    samples: Sequence[TrueSample],
    folder: Path,
    *,
    bound: float,
    on_sample: Callable[[], None] = lambda: None,
) -> Search:
    """Measure each group alone and, from the least harmful on, those that pay together; folder: for the trials."""
    groups = grouped(forms.layers)

    def measured(trials: dict[str, list[str]]) -> list[Measured]:
        paths = {"": bundle}
        for number, (name, layers) in enumerate(trials.items()):
            paths[name] = folder / f"{number}.onnx"
            write_file(bundle_bytes(forms.static(layers), metadata), paths[name])
        return measure(paths, samples, rounds=1, on_sample=on_sample)

    original, *alone = measured({name: [one.name for one in layers] for name, layers in groups.items()})
    costs = sorted(
        (
            GroupCost(
                one.name,
                len(groups[one.name]),
                sum(layer.multiplications for layer in groups[one.name]),
                original.size_bytes - one.size_bytes,
                max(one.latency[threads].p50_ms / original.latency[threads].p50_ms for threads in THREADS),
                one.error,
                one.failures - original.failures,
            )
            for one in alone
        ),
        key=lambda cost: cost.error,
    )
    taken = [cost.name for cost in costs if cost.pays and cost.harmless(bound)]
    chosen: tuple[str, ...] = tuple(taken[:1])
    if len(taken) > 1:
        # The first k of them for every k: what each adds to the error is seen where it adds it.
        prefixes = {str(k): [one.name for name in taken[:k] for one in groups[name]] for k in range(1, len(taken) + 1)}
        original, *together = measured(prefixes)
        held = [one for one in together if not one.refused(bound, original.failures)]
        quickest = min(held, key=lambda one: one.latency[THREADS[-1]].p50_ms, default=None)
        chosen = () if quickest is None else tuple(taken[: int(quickest.name)])
    return Search(tuple(costs), chosen)
