"""A training run's folder: enough to repeat it, to go on with it, to see how it went; and when it ends."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from torch import nn

from page_training.cache import make_shard
from page_training.categories import CATEGORIES
from page_training.checkpoint import load_checkpoint
from page_training.cli import main
from page_training.config import TrainingConfig
from page_training.network import network_for
from page_training.optimization import optimizers_for, set_learning_rate
from page_training.records import open_shards, shard_path
from page_training.run_folder import validation_totals
from page_training.train import Report, train
from page_training.validation import validation_picture

BOX = CATEGORIES["box"]
SHORT = {"category": "box", "batch_size": 2, "dense_points": 64, "validate_every": 1, "save_every": 1}


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("cache")
    for split in ("train", "validation"):
        make_shard(BOX, split, 0, shard_path(root, "box", split, 0), size=4)
    return root


def test_a_folder_holds_what_repeats_the_run_and_its_best_network(cache: Path, tmp_path: Path) -> None:
    reports: list[Report] = []
    run = tmp_path / "run"
    train(TrainingConfig(samples=6, **SHORT), BOX, cache, run, reports.append)
    again = TrainingConfig(**(json.loads((run / "config.json").read_text()) | {"augmentation": _augmentation(run)}))
    assert again == TrainingConfig(samples=6, **SHORT)
    train(TrainingConfig(samples=8, **SHORT), BOX, cache, run, reports.append)
    starts = [json.loads(line) for line in (run / "environment.jsonl").read_text().splitlines()]
    assert [start["step"] for start in starts] == [0, 3]
    for start in starts:
        assert {"command", "commit", "scenes_version", "versions", "machine"} <= start.keys()
    totals = [report.validation["total"] for report in reports if report.validation is not None]
    assert totals == validation_totals(run, 4)
    assert totals[:1] == validation_totals(run, 1)
    best = int(np.argmin(totals))
    assert load_checkpoint(run / "best.pt", BOX)["samples"] == 2 * (best + 1)
    picture = cv2.imread(str(run / "validation.png"))
    assert reports[-1].picture is not None
    assert picture is not None
    assert np.array_equal(picture[..., ::-1], reports[-1].picture)


def _augmentation(run: Path):
    from page_training.config import Augmentation

    return Augmentation(**json.loads((run / "config.json").read_text())["augmentation"])


def test_a_run_ends_when_patience_is_lost_and_stays_ended(
    cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    totals = iter([5.0, 4.0, 4.5, 4.1, 3.0, 2.0])
    monkeypatch.setattr("page_training.train.validation_losses", lambda *_: {"total": next(totals)})
    steps: list[int] = []
    config = TrainingConfig(samples=20, patience=2, **SHORT)
    for _ in range(2):
        train(config, BOX, cache, tmp_path, lambda report: steps.append(report.step))
        assert steps == [1, 2, 3, 4]
    patient = TrainingConfig(samples=12, patience=3, **SHORT)
    train(patient, BOX, cache, tmp_path, lambda report: steps.append(report.step))
    assert steps == [1, 2, 3, 4, 5, 6]


def test_the_learning_rate_halves_at_every_so_many_samples() -> None:
    network = nn.Linear(20, 20)
    config = TrainingConfig("box", samples=1000, batch_size=10, halve_every=200, warmup_share=0.0, learning_rate=0.8)
    optimizers = optimizers_for(network, config)
    rates = []
    for step in range(100):
        set_learning_rate(optimizers, step, 100, config)
        rates.append(optimizers[0].param_groups[0]["lr"])
    # One step rises; then 20 steps a level.
    assert rates[1:] == pytest.approx([0.8 * 0.5 ** (step // 20) for step in range(1, 100)])


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"samples": 0}, "samples: expected at least 1, got 0"),
        ({"patience": 0}, "patience: expected at least 1, got 0"),
        ({"halve_every": -5}, "halve_every: expected at least 1, got -5"),
        ({"also_share": 1.5}, "also_share: expected a share"),
    ],
)
def test_settings_that_cannot_be_are_refused(wrong: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        TrainingConfig("box", **wrong)


def test_the_picture_shows_parts_where_the_network_sees_them(cache: Path) -> None:
    """A network that takes all points for one part paints all of them in that part's colour."""
    shards = open_shards(cache, "box", "validation")
    pictures = []
    for part in (0, 1, 2):
        torch.manual_seed(0)
        network = network_for(BOX)
        nn.init.zeros_(network.parts.weight)
        network.parts.bias.data = 9.0 * torch.nn.functional.one_hot(torch.tensor(part), 3).float()
        pictures.append(validation_picture(network, shards, BOX))
    height = pictures[0].shape[0] // 3
    red, green, background = (picture[height : 2 * height].astype(int) for picture in pictures)
    assert np.array_equal(background, pictures[0][:height] // 2)
    painted = (red != background).any(axis=-1)
    assert 0.1 < painted.mean() < 0.9
    assert (red[painted] == (255, 64, 64)).all()
    assert (green[painted] == (64, 220, 64)).all()


def test_tensorboard_events_hold_scalars_and_pictures(cache: Path, tmp_path: Path) -> None:
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    run = tmp_path / "run"
    arguments = ["pose", "box", "--samples", "2", "--batch-size", "2", "--cache", str(cache), "--run", str(run)]
    assert main([*arguments, "--tensorboard"]) == 0
    events = EventAccumulator(str(run / "events"))
    events.Reload()
    assert {"training/total", "validation/total", "speed/frames_per_s"} <= set(events.Tags()["scalars"])
    assert events.Tags()["images"] == ["validation"]
    last = json.loads((run / "history.jsonl").read_text().splitlines()[-1])
    assert events.Scalars("validation/total")[-1].value == pytest.approx(last["validation"]["total"])
