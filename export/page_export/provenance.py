"""Where a bundle comes from: its weights, what they were trained on, the commit it was exported from."""

from __future__ import annotations

import hashlib
import subprocess
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from torch import Tensor


def weights_sha256(weights: Mapping[str, Tensor]) -> str:
    """Of a network's state: names, types, shapes and values in the order of the names, values little-endian.

    The same of a run's checkpoint and of the weights kept from it, whatever else the two files hold.
    """
    digest = hashlib.sha256()
    for name in sorted(weights):
        values = weights[name].detach().cpu().contiguous().numpy()
        digest.update(f"{name} {values.dtype.name} {values.shape}\n".encode())
        digest.update(values.astype(values.dtype.newbyteorder("<"), copy=False).tobytes())
    return digest.hexdigest()


def trained_on(config: Mapping[str, Any]) -> str:
    """What the frames of a training were, in words, from its settings as the checkpoint has them.

    Where other weights came first, theirs are not known here: the settings name them.
    """
    imported, share = config.get("also_from"), config.get("also_share", 0.0)
    if imported is None or share == 0.0:
        frames = "procedural scenes only"
    elif share == 1.0:
        frames = f"imported frames of {Path(imported).name} only"
    else:
        frames = f"procedural scenes and imported frames of {Path(imported).name} ({100 * share:g} % of the samples)"
    began = "" if config.get("start_from") is None else "; began with the weights that the settings name as start_from"
    return frames + began


def commit(file: Path = Path(__file__)) -> str:
    """The commit that `file` is of, "-dirty" with changes, or "unknown" and why.

    A package that is installed may lie inside a work tree of something else, which does not know the file.
    """

    def git(*arguments: str) -> str:
        done = subprocess.run(
            ["git", *arguments], cwd=file.parent, capture_output=True, text=True, check=True, timeout=10
        )
        return done.stdout.strip()

    try:
        git("ls-files", "--error-unmatch", "--", file.name)
        return git("describe", "--always", "--dirty")
    except (OSError, subprocess.SubprocessError):
        return "unknown: not exported from a checkout of page-edge"
