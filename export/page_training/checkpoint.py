"""Checkpoints of a run, and the small part of one that is worth keeping.

A checkpoint carries the category it was trained for, keypoints and all: weights mean nothing for another set.
Keys: average (the averaged network), category (JSON of category_document), config (JSON), step, samples (frames
seen, those of the run it was started from included); a run's own also network and optimizers.
"""

from __future__ import annotations

import json
import pickle
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from torch import nn

from page_runtime.category import Category
from page_runtime.category_document import category_document, category_from
from page_training.categories import BUILT_IN, CATEGORIES
from page_training.network import PageNetwork

# Weights whose shape follows the number of parts.
PER_PART = {
    "coarse_parts.weight",
    "coarse_parts.bias",
    "refiner.part",
    "refiner.known.weight",
    "parts.weight",
    "parts.bias",
}
KEPT = ("average", "category", "config", "step", "samples")


def save_checkpoint(path: Path, **state: Any) -> None:
    """Write a checkpoint whole or not at all; OSError where it cannot be written, and the one before stays."""
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_suffix(".partial")
    try:
        torch.save(state, partial)
    except (RuntimeError, OSError) as error:
        partial.unlink(missing_ok=True)
        # torch raises a RuntimeError of many lines for a full disk.
        reason = str(error).splitlines()[0]
        raise OSError(
            f"checkpoint {path}: cannot be written ({reason}); is the disk full? The last one is whole, and the same "
            "command goes on from it"
        ) from error
    partial.rename(path)


# What torch raises for files that are none of its own depends on their bytes.
_UNREADABLE = (RuntimeError, pickle.UnpicklingError, EOFError, LookupError, ValueError, TypeError, AttributeError)


def load_checkpoint(path: Path, category: Category | None = None) -> dict[str, Any]:
    """A checkpoint or kept weights, of exactly `category` if given. ValueError says what is wrong with the file.

    Weights only, so a foreign file cannot run code.
    """
    try:
        state = torch.load(path, map_location="cpu", weights_only=True)
    except (*_UNREADABLE, OSError) as error:
        # Not torch's own words: they advise to load the file in a way that lets it run code.
        raise ValueError(
            f"checkpoint {path}: torch cannot read it as weights; expected a .pt file of page-train"
        ) from error
    missing = set(KEPT) - (state.keys() if isinstance(state, dict) else set())
    if missing:
        raise ValueError(f"checkpoint {path}: expected one written by page-train, got a file without {sorted(missing)}")
    if category is not None and _trained_for(state) != json.loads(json.dumps(_as_trained(category_document(category)))):
        name = _trained_for(state).get("category")
        if _differs_in_focus_alone(state, category):
            raise ValueError(
                f"checkpoint {path}: trained on other samples of {name!r} than are taken now, as its objects are thin; "
                "begin a new run with it (--from, with another --run)"
            )
        raise ValueError(
            f"checkpoint {path}: trained for {name!r} with other parts, keypoints or sizes than {category.name!r} has "
            "now; train anew, or use the release that trained it"
        )
    return state


def trained_category(state: dict[str, Any]) -> Category:
    """The category a loaded checkpoint was trained for: a built-in one with the joints this release gives it and no
    templates, one of the user's own with those it had then, whatever is of that name where this runs."""
    document = json.loads(state["category"])
    if document["category"] not in BUILT_IN:
        return category_from(document)
    category = category_from(_trained_for(state))
    now = CATEGORIES[category.name]
    # Who learned from both kinds of samples knows the first, too; not the other way round.
    return replace(category, joints=now.joints, focused=category.focused and now.focused)


def _differs_in_focus_alone(state: dict[str, Any], category: Category) -> bool:
    """Or not at all."""
    now = json.loads(json.dumps(_as_trained(category_document(category))))
    return _trained_for(state) | {"focused": True} == now | {"focused": True}


def _trained_for(state: dict[str, Any]) -> dict[str, Any]:
    return _as_trained(json.loads(state["category"]))


def _as_trained(document: dict[str, Any]) -> dict[str, Any]:
    """Without joints and templates, which no weight knows of."""
    return {**document, "joints": [], "parts": [{**part, "template": None} for part in document["parts"]]}


def load_average(network: nn.Module, state: dict[str, Any], path: Path) -> None:
    """Put a checkpoint's averaged weights into `network`; ValueError when they are those of another architecture."""
    try:
        network.load_state_dict(state["average"])
    except RuntimeError as error:
        raise ValueError(
            f"checkpoint {path}: its weights are of another network than this release's; train anew, or use the "
            "release that trained it"
        ) from error


def load_start(network: PageNetwork, category: Category, path: Path) -> int:
    """Begin with the averaged weights at `path`; returns how many frames of this category they have seen.

    Those of the same category are taken whole, whether it was focused then or not. Of another category, everything that
    does not depend on how many parts there are: what surfaces, edges and colours look like need not be learned again.
    ValueError for weights of another architecture.
    """
    state = load_checkpoint(path)
    if _differs_in_focus_alone(state, category):
        load_average(network, state, path)
        return int(state["samples"])
    if _trained_for(state)["category"] == category.name:
        load_checkpoint(path, category)
    other, own = state["average"], network.state_dict()
    differing = {name for name, value in own.items() if name not in other or other[name].shape != value.shape}
    if other.keys() != own.keys() or not differing <= PER_PART:
        raise ValueError(
            f"checkpoint {path}: its weights are of another network than this release's; start from a release's own"
        )
    with torch.no_grad():
        for name, value in own.items():
            if name not in differing:
                value.copy_(other[name])
        # Features first, then a column for each part and the background.
        shared = own["refiner.known.weight"].shape[1] - network.num_parts - 1
        own["refiner.known.weight"][:, :shared] = other["refiner.known.weight"][:, :shared]
    return 0


def keep_weights(checkpoint: Path, path: Path) -> None:
    """Of a checkpoint keep what a later run or an export needs: a quarter of the size."""
    state = load_checkpoint(checkpoint)
    save_checkpoint(path, **{name: state[name] for name in KEPT})
