# SPDX-License-Identifier: GPL-3.0-or-later
"""Stanford-ORB: captures of one object under several lights, aligned, with masks, and what is true beside the images' folders."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from ...io.image import image_size
from ...io.safe_paths import inside, plain_name
from ..parsed_dataset import Frame, ParsedDataset, find_mask
from .transforms import frames_of, listed_image, load_transforms


def with_novel(capture: ParsedDataset) -> ParsedDataset:
    """The capture of such a scene, with the test views of the object's other captures, whose cameras are given in its own frame.

    Raises InputError where transforms_novel.json is damaged or leads elsewhere.
    """
    file = capture.source.with_name("transforms_novel.json")
    if not file.is_file():
        return capture
    content, root = load_transforms(file), capture.root.resolve().parent
    scenes = [plain_name(f"{file}, frame {i}", entry.get("scene_name")) for i, entry in enumerate(content["frames"])]
    images = [listed_image(root / scene, e["file_path"]) for scene, e in zip(scenes, content["frames"], strict=True)]
    size = next((image_size(p) for p in images if p is not None), capture.train[0].lens.size)
    frames = frames_of(file, content, images, size)
    return replace(capture, novel=[_other(f, scene, root) for f, scene in zip(frames, scenes, strict=True)])


def truth_folder(image: Path) -> Path:
    """ground_truth/SCENE of the collection that an image blender_*/SCENE/test/NAME belongs to; an InputError where it leads elsewhere."""
    scene = image.resolve().parent.parent
    truth = scene.parent.parent / "ground_truth"
    return inside(truth / scene.name, truth)


def _other(frame: Frame, scene: str, root: Path) -> Frame:
    mask = None if frame.image is None else find_mask(frame.image, frame.image.parent)
    if frame.image is not None:
        inside(frame.image, root)
    return replace(frame, listed=f"{scene}/{frame.listed.removeprefix('./')}", mask=mask, light=scene)
