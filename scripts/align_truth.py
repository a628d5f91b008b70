# SPDX-License-Identifier: GPL-3.0-or-later
"""Move the ground truth of a capture into the world of a run, so that `irgspp evaluate RUN DATASET` can compare both.

The world of a run whose cameras were found is known up to a similarity. It is fitted to the camera centres; CAPTURE is what
scripts/render_capture.py wrote.
"""

from __future__ import annotations

import argparse
import json
import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch
import trimesh
from irgspp.core.errors import InputError, IrgsppError
from irgspp.core.io.exr import read_exr, read_exr_rgb, rgb_channels, write_exr
from irgspp.core.scene.camera import Camera
from irgspp.core.scene.camera_files import load_run_cameras
from irgspp.core.scene.similarity import moved_points, scale_of
from irgspp.core.shading.environment_lookup import lookup, texel_directions

FEWEST = 4  # cameras with which the similarity is fitted
FAR, ROUNDS = 3.0, 10  # cameras further off than this many medians are left out of the fit, which is repeated


def fitted_similarity(source: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Fit the similarity (4, 4) that moves points (P, 3) onto others (Procrustes), without those that are far off.

    Raises:
        InputError: too few points.
    """
    if len(source) < FEWEST:
        raise InputError("cameras", f"only {len(source)} of the run's are in the truth, too few to align them")
    kept = np.ones(len(source), bool)
    for _ in range(ROUNDS):
        similarity, _, _ = trimesh.registration.procrustes(source[kept], target[kept], reflection=False)
        off = np.linalg.norm(moved_points(source, similarity) - target, axis=1)
        again = off <= max(FAR * float(np.median(off)), np.sort(off)[FEWEST - 1])
        if (again == kept).all():
            break
        kept = again
    return similarity


def truth_to_run(run: Path, truth: Path) -> np.ndarray:
    """Return the similarity (4, 4) from the truth's world to the run's.

    Args:
        run: run folder.
        truth: truth/ of the capture.
    """
    true = {Path(frame["file_path"]).stem: frame for frame in _content(truth / "transforms.json")["frames"]}
    placed = {Path(one.name).stem: one.camera.centre for one in load_run_cameras(run / "cameras.json")}
    both = sorted(true.keys() & placed.keys())
    centres = np.array([np.array(true[name]["transform_matrix"])[:3, 3] for name in both]).reshape(-1, 3)
    return fitted_similarity(centres, np.array([placed[name] for name in both]).reshape(-1, 3))


def turned_light(image: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    """Return a light map (H, W, 3) after a rotation (3, 3) of the world."""
    height, width = image.shape[:2]
    before = texel_directions(height, width).reshape(-1, 3) @ torch.from_numpy(rotation.astype(np.float32))
    return lookup(torch.from_numpy(np.ascontiguousarray(image, np.float32)), before).view(height, width, 3).numpy()


def align(run: Path, capture: Path, output: Path) -> None:
    """Write the truth of a capture as a dataset in the world of a run.

    Args:
        run: run folder.
        capture: folder with photos/ and truth/.
        output: folder to write, must not exist.

    Raises:
        InputError: where a file is missing, or the folder exists.
    """
    if output.exists():
        raise InputError(output, "exists", "name a new folder")
    truth = capture / "truth"
    for needed in (capture / "photos", *(truth / name for name in ("test", "envs", "meta.json", "surface_points.npz"))):
        if not needed.exists():
            raise InputError(needed, "is missing", "give a folder of scripts/render_capture.py")
    similarity = truth_to_run(run, truth)
    rotation, scale = similarity[:3, :3] / scale_of(similarity), scale_of(similarity)
    shutil.copytree(truth / "test", output / "test")
    shutil.copytree(capture / "photos", output / "train")
    shutil.copy(truth / "meta.json", output / "meta.json")
    (output / "envs").mkdir()
    for light in sorted((truth / "envs").glob("*.exr")):
        write_exr(output / "envs" / light.name, rgb_channels(turned_light(read_exr_rgb(light), rotation)))
    for view in sorted((output / "test").iterdir()):
        write_exr(view / "normal.exr", rgb_channels((read_exr_rgb(view / "normal.exr") @ rotation.T).astype(np.float32)))
        _scale_depth(view / "depth.exr", scale)
    points = np.load(truth / "surface_points.npz")
    moved = {"points": moved_points(points["points"], similarity), "normals": points["normals"].astype(np.float32) @ rotation.T}
    np.savez_compressed(output / "surface_points.npz", **{name: array.astype(np.float32) for name, array in moved.items()})
    _move_cameras(truth / "transforms_test.json", output / "transforms_test.json", similarity, lambda path: path)
    _move_cameras(truth / "transforms.json", output / "transforms_train.json", similarity, lambda path: f"train/{Path(path).name}")


def _scale_depth(path: Path, scale: float) -> None:
    """Multiply the depths of a file."""
    write_exr(path, {"Z": (read_exr(path)["Z"] * scale).astype(np.float32)})


def _move_cameras(source: Path, target: Path, similarity: np.ndarray, renamed: Callable[[str], str]) -> None:
    """Write a transforms file with moved cameras and renamed images."""
    content = _content(source)
    frames = []
    for frame in content["frames"]:
        camera = Camera(1, 1, 1.0, 1.0, 0.5, 0.5, np.array(frame["transform_matrix"])).moved(similarity)
        frames.append({"file_path": renamed(frame["file_path"]), "transform_matrix": camera.to_world.tolist()})
    target.write_text(json.dumps({**content, "frames": frames}, indent=1))


def _content(path: Path) -> dict[str, Any]:
    """Return the content of a JSON file; raise InputError where it can't be read."""
    try:
        return json.loads(path.read_text("utf-8"))
    except (OSError, ValueError) as error:
        raise InputError(path, f"can't be read ({error})", "give a folder of scripts/render_capture.py") from error


def main(argv: list[str] | None = None) -> int:
    """Align and return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path, help="run folder")
    parser.add_argument("capture", type=Path, help="folder of scripts/render_capture.py")
    parser.add_argument("-o", "--output", type=Path, required=True, help="dataset to write, must not exist")
    args = parser.parse_args(argv)
    try:
        align(args.run, args.capture, args.output)
    except IrgsppError as error:
        print(error, file=sys.stderr)
        return error.exit_status
    return 0


if __name__ == "__main__":
    sys.exit(main())
