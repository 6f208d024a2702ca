"""Checkpoints of a run, and the small part of one that is worth keeping.

A checkpoint carries the category it was trained for, keypoints and all: weights mean nothing for another set.
Keys: average (the averaged network), category (JSON of bundle.category_document), config (JSON), step, samples (frames
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

from page_runtime.bundle import category_document, category_from
from page_runtime.category import Category
from page_training.categories import category_named, known_categories

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


def load_checkpoint(path: Path, category: Category | None = None) -> dict[str, Any]:
    """A checkpoint or kept weights, of exactly `category` if given. ValueError says what is wrong with the file.

    Weights only, so a foreign file cannot run code.
    """
    try:
        state = torch.load(path, map_location="cpu", weights_only=True)
    except (RuntimeError, pickle.UnpicklingError, EOFError, OSError) as error:
        # Not torch's own words: they advise to load the file in a way that lets it run code.
        raise ValueError(
            f"checkpoint {path}: torch cannot read it as weights; expected a .pt file of page-train"
        ) from error
    missing = set(KEPT) - (state.keys() if isinstance(state, dict) else set())
    if missing:
        raise ValueError(f"checkpoint {path}: expected one written by page-train, got a file without {sorted(missing)}")
    if category is not None and _trained_for(state) != json.loads(json.dumps(_as_trained(category_document(category)))):
        name = _trained_for(state).get("category")
        raise ValueError(
            f"checkpoint {path}: trained for {name!r} with other parts, keypoints or sizes than {category.name!r} has "
            "now; train anew, or use the release that trained it"
        )
    return state


def trained_category(state: dict[str, Any]) -> Category:
    """The category a loaded checkpoint was trained for, with the joints this release gives it and no templates.

    One of the user's own that is not there any more keeps the joints it was trained with.
    """
    category = category_from(_trained_for(state))
    if category.name in known_categories():
        return replace(category, joints=category_named(category.name).joints)
    return replace(category, joints=category_from(json.loads(state["category"])).joints)


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


def keep_weights(checkpoint: Path, path: Path) -> None:
    """Of a checkpoint keep what a later run or an export needs: a quarter of the size."""
    state = load_checkpoint(checkpoint)
    save_checkpoint(path, **{name: state[name] for name in KEPT})
