"""Procedural RGB-D scenes of articulated objects with exact truth: all the training data there is."""

from page_training.scenes.kinds import CATEGORIES
from page_training.scenes.scene import Scene, sample_scene
from page_training.scenes.view import PartTruth, SceneView, full_view, training_view

__all__ = ["CATEGORIES", "PartTruth", "Scene", "SceneView", "full_view", "sample_scene", "training_view"]
