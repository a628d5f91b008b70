# SPDX-License-Identifier: GPL-3.0-or-later
"""Render photographs of an object on a table as a phone takes them, without cameras or masks, and the ground truth of the object.

OUT/photos/ is what `irgspp reconstruct` gets. OUT/truth/ has, of the object alone, what scripts/render_dataset.py writes: test views with
all layers and lights, and surface points; and true cameras, masks and exposures of the photographs (transforms.json).
scripts/align_truth.py moves it into the world of a run.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

import bpy
import numpy as np
from irgspp.core.errors import InputError
from irgspp.core.scene.camera import Camera
from irgspp.irgspp_addon.world.light_to_world import world_from_map
from PIL import Image
from render_dataset import load_scene, log, orbit, render_test, reported, write_lights, write_meta, write_transforms
from scenes import cycles_ground_truth, phone
from scenes.catalogue import SCENES
from scenes.dataset_files import write_surface
from scenes.table import add_desk

LOWEST = 5.0  # elevation of the lowest test view, degrees
SEED = 5


def arguments(argv: list[str] | None) -> argparse.Namespace:
    """Parse the command line; `argv` is that of the process where None."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("blend", nargs="?", type=Path, help=".blend file with the object (default: the built-in scene that --scene names)")
    parser.add_argument("--scene", choices=SCENES, default="relief", help="built-in scene; default: relief")
    parser.add_argument("-o", "--output", type=Path, required=True, help="folder to write, must not exist or be empty")
    parser.add_argument("--photographs", dest="train", type=int, default=40, help="number of photographs")
    parser.add_argument("--size", type=int, nargs=2, default=(640, 480), metavar=("W", "H"), help="of the photographs; default: 640 480")
    parser.add_argument("--samples", type=int, default=8, help="Cycles samples per pixel of the photographs, then denoised")
    parser.add_argument("--test", type=int, default=8, help="test views, with ground truth")
    parser.add_argument("--resolution", type=int, default=256, help="of the test views")
    parser.add_argument("--test-samples", type=int, default=48, help="Cycles samples per pixel of the test views, then denoised")
    parser.add_argument("--light", help="lat-long EXR or a built-in light; default: the World of the .blend file, or sky")
    parser.add_argument("--relight", nargs="*", help="more lights for the test views; default: studio sunset")
    parser.add_argument("--light-height", type=int, default=256, help="rows of built-in and baked light maps")
    parser.add_argument("--points", type=int, default=20_000, help="surface samples for mesh scores")
    parser.add_argument("--threads", type=int, default=0, help="of Cycles; default: 0, as many as the machine has")
    parsed = parser.parse_args(argv)
    parsed.name = parsed.blend.stem if parsed.blend else parsed.scene
    return parsed


def render_photographs(
    scene: bpy.types.Scene, surroundings: list[bpy.types.Object], cameras: list[Camera], folder: Path
) -> list[dict[str, object]]:
    """Render the photographs and the object's masks.

    Args:
        scene: object and surroundings under the World of the photographs.
        surroundings: what does not belong to the object.
        cameras: of the photographs.
        folder: of the capture.

    Returns:
        The frames of truth/transforms.json.
    """
    random, frames = np.random.default_rng(SEED), []
    for i, camera in enumerate(cameras):
        log(f"photograph {i + 1} of {len(cameras)}")
        name, shot = f"IMG_{i + 1:04d}", phone.draw_shot(random)
        cycles_ground_truth.place_camera(scene, camera)
        scene.cycles.seed = i
        radiance = cycles_ground_truth.render_image(scene)["rgba"][..., :3]
        phone.save_photograph(folder / "photos" / f"{name}.jpg", radiance, shot, random)
        alpha = object_alpha(scene, surroundings)
        Image.fromarray(np.round(255 * np.clip(alpha, 0, 1)).astype(np.uint8)).save(folder / "truth" / "masks" / f"{name}.png")
        frame = {"file_path": f"../photos/{name}.jpg", "mask_path": f"masks/{name}.png", "transform_matrix": camera.to_world.tolist()}
        frames.append(frame | {"exposure_gain": shot.gain, "white_balance": shot.white_balance.tolist(), "orientation": 1})
    return frames


def object_alpha(scene: bpy.types.Scene, surroundings: list[bpy.types.Object]) -> np.ndarray:
    """Render the coverage (H, W) of the object alone, which the surroundings may hide."""
    for thing in surroundings:
        thing.is_holdout = True
    scene.render.film_transparent = True
    alpha = cycles_ground_truth.render_image(scene)["rgba"][..., 3]
    scene.render.film_transparent = False
    for thing in surroundings:
        thing.is_holdout = False
    return alpha


def write_truth_cameras(path: Path, camera: Camera, frames: list[dict[str, object]]) -> None:
    """Write truth/transforms.json: the lens, which distorts nothing, and a frame for each photograph."""
    lens = {"camera_model": "OPENCV", "w": camera.width, "h": camera.height, "k1": 0.0, "k2": 0.0, "p1": 0.0, "p2": 0.0}
    lens |= {"fl_x": camera.fx, "fl_y": camera.fy, "cx": camera.cx, "cy": camera.cy}
    path.write_text(json.dumps(lens | {"frames": frames}, indent=1))


def render_capture(args: argparse.Namespace) -> None:
    """Render photographs and truth.

    Raises:
        InputError: where the folder is not empty.
    """
    if args.output.exists() and any(args.output.iterdir()):
        raise InputError(args.output, "is not empty", "name a new folder")
    truth = args.output / "truth"
    of_truth = argparse.Namespace(**{**vars(args), "output": truth})
    for folder in (args.output / "photos", truth / "masks"):
        folder.mkdir(parents=True)
    scene = load_scene(args.blend, args.scene)
    triangles = cycles_ground_truth.world_triangles(scene)
    corners = triangles.reshape(-1, 3)
    centre = (corners.min(0) + corners.max(0)) / 2
    radius = float(np.linalg.norm(corners - centre, axis=-1).max())
    surroundings = add_desk(corners)
    cycles_ground_truth.prepare(scene, args.samples, SEED, args.threads, transparent=False)
    lights = write_lights(scene, of_truth)
    worlds = {name: world_from_map(truth / "envs" / f"{name}.exr", name) for name in lights}
    cameras = phone.handheld_cameras(args.train, centre, radius, tuple(args.size), np.random.default_rng(SEED))
    scene.world = worlds[lights[0]]
    write_truth_cameras(truth / "transforms.json", cameras[0], render_photographs(scene, surroundings, cameras, args.output))
    nothing = np.zeros((0, 3))
    write_surface(truth, cycles_ground_truth.visible_points(triangles, cameras, args.points, SEED), triangles, (nothing, nothing))
    for thing in surroundings:
        bpy.data.objects.remove(thing)
    scene.render.film_transparent, scene.cycles.samples = True, args.test_samples
    test = orbit(args.test, 0.37, centre, radius, args.resolution, LOWEST)
    write_transforms(truth / "transforms_test.json", test, "./test/r_{:03d}/rgba")
    render_test(scene, test, worlds, truth / "test")
    write_meta(of_truth, lights, corners, scene)
    _add_to_meta(truth / "meta.json", {"bounding_radius": radius, "mean_camera_distance": phone.DISTANCE * radius})


def _add_to_meta(path: Path, values: dict[str, float]) -> None:
    """Add lengths that scorers of captures measure by."""
    path.write_text(json.dumps(json.loads(path.read_text()) | values, indent=1))


def main(argv: list[str] | None = None) -> int:
    """Render the capture and return the exit status."""
    args = arguments(argv)
    return reported(lambda: render_capture(args))


if __name__ == "__main__":
    sys.exit(main())
