"""The colour camera: from linear light to the 8-bit picture with blur, noise and compression."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from page_training.scenes.sensor import smooth_field
from page_training.scenes.textures import Generator

# float32 in fact; NumPy's stubs widen the results of mixed arithmetic.
Floats = NDArray[np.floating]


def develop(rng: Generator, light: Floats, native: int, pasted: NDArray[np.bool_] | None) -> NDArray[np.uint8]:
    """(S,S,3) uint8 RGB of linear light (S,S,3) as a camera with `native` x `native` pixels here would
    record it.

    pasted: (S,S) bool, pixels of an object put into a real picture afterwards (mixed reality): another tint
    and exposure than the room, no blur, no noise of the camera; None for ordinary pictures.
    """
    height, width = light.shape[:2]
    small = min(native, height)
    image = light * _white_balance(rng)
    wanted = float(rng.uniform(0.36, 0.7)) / (float(image.mean()) + 1e-3)
    image = image * np.float32(wanted ** rng.uniform(0.4, 1.0) * rng.uniform(0.8, 1.2))
    if small < height:
        image = _resized(image, small, small)
    px = small / native
    recorded = _noise(rng, _tone(rng, _optics(rng, image, px)), px)
    if pasted is not None:
        tint = np.float32(rng.uniform(0.7, 1.3)) * (1 + rng.normal(0, 0.12, 3)).astype(np.float32)
        inside = _resized(pasted.astype(np.float32), image.shape[1], image.shape[0]) > 0.5
        recorded = np.where(inside[..., None], np.clip(image * tint, 0, 1), recorded)
    eight = (np.clip(recorded, 0, 1) * 255).astype(np.uint8)
    if rng.random() < 0.7:
        eight = _compressed(eight, int(rng.integers(45, 97)))
    if small < height:
        eight = np.asarray(cv2.resize(eight, (width, height), interpolation=cv2.INTER_LINEAR), np.uint8)
    return eight


def _resized(image: Floats, width: int, height: int) -> Floats:
    return np.asarray(cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA), np.float32)


def _blurred(image: Floats, sigma: float) -> Floats:
    return np.asarray(cv2.GaussianBlur(image, (0, 0), sigma), np.float32)


def _white_balance(rng: Generator) -> Floats:
    gains = 1 + rng.normal(0, 0.07, 3)
    return (gains / gains.mean()).astype(np.float32)


def _optics(rng: Generator, image: Floats, px: float) -> Floats:
    """Defocus, now and then motion, and the halo of a sharpening filter."""
    sigma = float(rng.uniform(0.35, 0.9)) if rng.random() < 0.75 else float(rng.uniform(0.9, 2.2))
    image = _blurred(image, max(sigma * px, 0.35))
    if rng.random() < 0.15:
        length = max(2, round(float(rng.uniform(3, 12)) * px))
        angle = float(rng.uniform(0, np.pi))
        kernel = np.zeros((2 * length + 1, 2 * length + 1), np.float32)
        step = (round(length / 2 * np.cos(angle)), round(length / 2 * np.sin(angle)))
        cv2.line(kernel, (length - step[0], length - step[1]), (length + step[0], length + step[1]), 1.0)
        image = np.asarray(cv2.filter2D(image, -1, kernel / kernel.sum()), np.float32)
    if rng.random() < 0.35:
        image = image + np.float32(rng.uniform(0.2, 1.0)) * (image - _blurred(image, max(1.2 * px, 0.5)))
    return image


def _tone(rng: Generator, image: Floats) -> Floats:
    """Tone curve, saturation, flare."""
    image = np.clip(image, 0, 1.6)
    image = image / (1 + np.float32(rng.uniform(0, 0.3)) * image)
    image = np.asarray(cv2.pow(image, float(rng.uniform(0.75, 1.3))), np.float32)
    grey = image.mean(axis=-1, keepdims=True)
    image = grey + (image - grey) * np.float32(rng.uniform(0.7, 1.5))
    flare = np.float32(rng.uniform(0, 0.12)) if rng.random() < 0.5 else np.float32(0)
    return image * (1 - flare) + flare


def _noise(rng: Generator, image: Floats, px: float) -> Floats:
    """Grain that grows in bright and high-gain pictures, partly smeared by the camera's own filter."""
    strength = float(rng.choice([0.004, rng.uniform(0.005, 0.02), rng.uniform(0.02, 0.06)], p=[0.3, 0.45, 0.25]))
    shape = image.shape[:2]
    cell = float(rng.uniform(1.0, 2.5)) * px
    grey = smooth_field(rng, shape, cell)[..., None]
    color = np.stack([smooth_field(rng, shape, 1.5 * cell) for _ in range(3)], axis=-1)
    return image + (grey * 0.8 + color * 0.5) * (strength * np.sqrt(np.clip(image, 0.05, 1)))


def _compressed(image: NDArray[np.uint8], quality: int) -> NDArray[np.uint8]:
    done, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])
    if not done:
        raise RuntimeError(
            f"photo: JPEG encoding of a {image.shape} {image.dtype} picture failed; expected (H,W,3) uint8"
        )
    return np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR), np.uint8)
