"""What may be exchanged in training: the network's heads and what they are told. Loop, data and budget stay."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from torch import Tensor

from page_runtime.category import Category
from page_training.config import Fusion
from page_training.losses import page_loss
from page_training.network import PageNetwork, network_for


@dataclass(frozen=True, slots=True)
class Approach:
    """network: an untrained one of the category. loss: of its outputs, the targets and, by name, segmentation_weight
    and radius_weight (tau 1 and 2 of Eq. 19): every term, and "total"."""

    network: Callable[[Category, Fusion], PageNetwork]
    loss: Callable[..., dict[str, Tensor]]


SCORING = Approach(network_for, page_loss)
