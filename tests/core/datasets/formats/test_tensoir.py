# SPDX-License-Identifier: GPL-3.0-or-later
"""TensoIR's scenes with damaged descriptions, and with links in the ground truth that lead out of the folder."""

import json

import numpy as np
import pytest
from irgspp.core.datasets.load import load_dataset
from irgspp.core.evaluation.ground_truth import load_scene_truth, load_truth
from PIL import Image
from refused import refused


def tensoir_scene(folder):
    for split in ("train", "test"):
        for i in range(3):
            view = folder / f"{split}_{i:03d}"
            view.mkdir(parents=True)
            pose = np.eye(4)
            pose[:3, 3] = 0.1 * i, 0, 4
            matrix = ",".join(map(str, pose.reshape(-1)))
            (view / "metadata.json").write_text(json.dumps({"cam_transform_mat": matrix, "cam_angle_x": 0.7, "imw": 16, "imh": 16}))
            for name in ("rgba", "albedo", "normal", "rgba_city"):
                Image.new("RGBA", (16, 16), (90, 90, 200, 255)).save(view / f"{name}.png")
    return folder


@pytest.mark.parametrize("name", ["rgba", "albedo", "normal", "rgba_city"])
def test_links_out_of_the_folder_among_truth(tmp_path, name):
    scene = tensoir_scene(tmp_path / "scene")
    Image.new("RGBA", (16, 16)).save(tmp_path / "secret.png")
    file = scene / "test_001" / f"{name}.png"
    file.unlink()
    file.symlink_to(tmp_path / "secret.png")
    with refused("leads out", name):
        data = load_dataset(scene)
        truth = load_scene_truth(scene, data.to_world)
        for view in data.test:
            load_truth(view, truth, data.to_world)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda m: m.update(cam_transform_mat="1,2,3"), ["16"]),
        (lambda m: m.update(cam_transform_mat="a," * 16), ["metadata"]),
        (lambda m: m.pop("imw"), ["imw"]),
        (lambda m: m.update(imw=-3), ["size"]),
        (lambda m: m.update(cam_angle_x="wide"), ["number"]),
        (lambda m: m.update(cam_transform_mat=",".join(["nan"] * 16)), ["not finite"]),
    ],
)
def test_damaged_descriptions_of_tensoir(tmp_path, change, words):
    scene = tensoir_scene(tmp_path)
    file = scene / "train_001" / "metadata.json"
    content = json.loads(file.read_text())
    change(content)
    file.write_text(json.dumps(content))
    with refused(r"train_001.metadata\.json", *words):
        load_dataset(scene)
