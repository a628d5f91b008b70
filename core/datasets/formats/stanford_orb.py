# SPDX-License-Identifier: GPL-3.0-or-later
"""Conventions of Stanford-ORB: aligned captures of an object under several lights, with masks, and ground truth in folders of its own."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from ...io.image import image_size
from ...io.safe_paths import inside, plain_name
from ..parsed_dataset import Frame, ParsedDataset, find_mask
from .transforms import find_listed_image, load_transforms, parse_frames


def add_novel_views(parsed: ParsedDataset) -> ParsedDataset:
    """Add the test views of the object's other captures to a Stanford-ORB scene; their cameras are given in the scene's own frame.

    Raises:
        InputError: if transforms_novel.json is damaged or leads out of the collection.
    """
    file = parsed.source.with_name("transforms_novel.json")
    if not file.is_file():
        return parsed
    content, root = load_transforms(file), parsed.root.resolve().parent
    scenes = [plain_name(f"{file}, frame {i}", entry.get("scene_name")) for i, entry in enumerate(content["frames"])]
    images = [find_listed_image(root / scene, e["file_path"]) for scene, e in zip(scenes, content["frames"], strict=True)]
    size = next((image_size(p) for p in images if p is not None), parsed.train[0].lens.size)
    frames = parse_frames(file, content, images, size)
    return replace(parsed, novel=[_other(f, scene, root) for f, scene in zip(frames, scenes, strict=True)])


def ground_truth_folder(image: Path) -> Path:
    """Return the folder ground_truth/SCENE of the collection that an image blender_*/SCENE/test/NAME belongs to.

    Raises:
        InputError: if it leads out of ground_truth.
    """
    scene = image.resolve().parent.parent
    truth = scene.parent.parent / "ground_truth"
    return inside(truth / scene.name, truth)


def _other(frame: Frame, scene: str, root: Path) -> Frame:
    mask = None if frame.image is None else find_mask(frame.image, frame.image.parent)
    if frame.image is not None:
        inside(frame.image, root)
    return replace(frame, listed=f"{scene}/{frame.listed.removeprefix('./')}", mask=mask, light=scene)
