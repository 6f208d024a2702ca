"""A trained network with what it was trained for, from a checkpoint or kept weights."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from page_runtime.category import Category
from page_training.approach import SCORING, Approach
from page_training.checkpoint import load_average, load_checkpoint, trained_category
from page_training.config import TrainingConfig
from page_training.network import PageNetwork


@dataclass(frozen=True, eq=False, slots=True)
class Trained:
    """network: the averaged one. samples: frames it has seen; config: of its last run, as its file has it."""

    network: PageNetwork
    category: Category
    samples: int
    config: dict[str, Any]


def load_trained(path: Path, approach: Approach = SCORING) -> Trained:
    """ValueError where the file is none of `page-train` or of another release's network."""
    state = load_checkpoint(path)
    category = trained_category(state)
    config = json.loads(state["config"])
    network = approach.network(category, config.get("fusion", TrainingConfig(category.name).fusion))
    load_average(network, state, path)
    return Trained(network, category, state["samples"], config)
