"""What a training run is made of; no torch here, so that a command line can show the defaults without loading it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal, get_args

Fusion = Literal["gated", "concatenated", "dense", "depth"]
# rho of the scorer in bundles and evaluations: of the size of the radii's errors.
VOXEL_M = 0.005
SEGMENTATION_WEIGHT = 0.25
RADIUS_WEIGHT = 0.75


@dataclass(frozen=True, slots=True)
class Augmentation:
    """How far a sample is changed. The probabilities and sigmas were set once by eye, not tuned.

    scale_sigma: of the object's size (its distance follows, so the picture stays right). turn_sigma_rad: of a small
    rotation of the points alone. jitter: share of samples whose points get independent noise of a standard deviation up
    to jitter_limit_m, small ones more often, and their neighbours anew. colour: gains and offsets of the picture.
    """

    flip_probability: float = 0.5
    scale_sigma: float = 0.08
    turn_sigma_rad: float = 0.12
    jitter_probability: float = 0.12
    jitter_limit_m: float = 0.03
    gain_sigma: float = 0.25
    tint_sigma: float = 0.12
    offset_sigma: float = 0.08
    noise_sigma: float = 0.03
    shuffle_probability: float = 0.15
    gray_probability: float = 0.15
    blank_probability: float = 0.05


@dataclass(frozen=True, slots=True)
class TrainingConfig:
    """Everything a run depends on besides the cached frames.

    fusion: how colour joins geometry; all but "gated" are the paper's comparisons. segmentation_weight,
    radius_weight: tau 1 and 2 of Eq. 19. samples: frames seen in all, repeats
    included. start_from: a checkpoint or kept weights, of any category, whose averaged network this run begins with,
    instead of random weights. also_from: a second cache, that of `page-train import`, and also_share, the share of
    samples drawn from it. halve_every: samples after which the learning rate halves (the paper: 20 epochs
    from 1e-3), None for half a cosine. patience: validations without a better total that end the run, None for none.
    """

    category: str
    fusion: Fusion = "gated"
    segmentation_weight: float = SEGMENTATION_WEIGHT
    radius_weight: float = RADIUS_WEIGHT
    samples: int = 100_000
    batch_size: int = 12
    dense_points: int = 512
    learning_rate: float = 2e-3
    weight_decay: float = 1e-4
    warmup_share: float = 0.02
    gradient_clip: float = 5.0
    average_decay: float = 0.999
    start_from: str | None = None
    also_from: str | None = None
    also_share: float = 0.5
    halve_every: int | None = None
    patience: int | None = None
    seed: int = 1
    threads: int = 1
    validate_every: int = 500
    save_every: int = 100
    augmentation: Augmentation = field(default_factory=Augmentation)

    def __post_init__(self) -> None:
        for name in (
            "samples",
            "batch_size",
            "dense_points",
            "halve_every",
            "patience",
            "validate_every",
            "save_every",
        ):
            value = getattr(self, name)
            if value is not None and value < 1:
                raise ValueError(f"{name}: expected at least 1, got {value}")
        if self.fusion not in get_args(Fusion):
            raise ValueError(f"fusion: expected one of {', '.join(get_args(Fusion))}, got {self.fusion!r}")
        if min(self.segmentation_weight, self.radius_weight) <= 0.0:
            raise ValueError(
                f"segmentation_weight, radius_weight: expected > 0, got {self.segmentation_weight} and "
                f"{self.radius_weight}"
            )
        if not 0.0 <= self.also_share <= 1.0:
            raise ValueError(f"also_share: expected a share in [0, 1], got {self.also_share}")
