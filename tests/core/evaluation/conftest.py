# SPDX-License-Identifier: GPL-3.0-or-later
"""The embedded dataset with its ground truth, and predictions that equal the ground truth."""

from pathlib import Path

import irgspp.core
import numpy as np
import pytest
from irgspp.core.datasets.load import load_dataset
from irgspp.core.evaluation.ground_truth import Truth, load_scene_truth, load_truth
from irgspp.core.evaluation.view_metrics import Prediction
from irgspp.core.io.srgb import decode_srgb
from irgspp.core.scene.dataset import View
from irgspp.core.scene.gbuffer import GBuffer

DEMO = Path(irgspp.core.__file__).parent / "demo_data"


def premultiplied(image: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """Convert encoded colour times alpha, as in Truth, to linear premultiplied RGBA."""
    straight = image / np.maximum(alpha, 1e-6)[..., None]
    return np.concatenate([decode_srgb(straight) * alpha[..., None], alpha[..., None]], -1).astype(np.float32)


def perfect(view: View, truth: Truth) -> Prediction:
    """Return the prediction of a perfect reconstruction."""
    shaded = premultiplied(truth.image, truth.alpha)
    radiance = shaded[..., :3] / np.maximum(truth.alpha, 1e-6)[..., None]
    assert truth.depth is not None and truth.normal is not None and truth.albedo is not None
    assert truth.roughness is not None and truth.metallic is not None
    layers = (truth.alpha, truth.depth, truth.normal, radiance, truth.albedo, truth.roughness, truth.metallic)
    return Prediction(GBuffer(view.camera, *layers), shaded, {n: premultiplied(p, truth.alpha) for n, p in truth.relit.items()})


@pytest.fixture(scope="session")
def demo():
    """Path, dataset, ground truth of the scene and of the views, and perfect predictions."""
    dataset = load_dataset(DEMO)
    scene = load_scene_truth(DEMO, dataset.to_world)
    truths = [load_truth(view, scene, dataset.to_world) for view in dataset.test]
    return DEMO, dataset, scene, truths, [perfect(v, t) for v, t in zip(dataset.test, truths, strict=True)]
