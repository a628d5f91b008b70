# SPDX-License-Identifier: GPL-3.0-or-later
"""Render a dataset with exact ground truth from a .blend file, or from one of the built-in scenes."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable
from pathlib import Path

import bpy
import numpy as np
from irgspp.core.errors import InputError, IrgsppError
from irgspp.core.io.exr import read_exr_rgb, rgb_channels, write_exr
from irgspp.core.scene.camera import Camera, look_at
from irgspp.core.shading.procedural_lights import LIGHTS
from irgspp.irgspp_addon.world.light_to_world import bake_world, world_from_map
from scenes import cycles_ground_truth
from scenes.catalogue import SCENES
from scenes.dataset_files import save_photograph, write_layers, write_surface
from scenes.table import add_table

ANGLE_X = 0.6911112070083618  # horizontal field of view of the NeRF-synthetic cameras
LENS_RADII = 4 / 1.3  # camera distance in object radii
SEED = 7
ABOVE_TABLE = 12.0  # elevation of the lowest camera where the object stands on a table, degrees


def arguments(argv: list[str] | None) -> argparse.Namespace:
    """Parse the command line; `argv` is that of the process where None."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("blend", nargs="?", type=Path, help=".blend file (default: the built-in scene that --scene names)")
    parser.add_argument("--scene", choices=SCENES, default="demo", help="built-in scene; default: demo, that of the embedded dataset")
    parser.add_argument("-o", "--output", type=Path, required=True, help="folder to write, must not exist or be empty")
    parser.add_argument("--resolution", type=int, default=200)
    parser.add_argument("--train", type=int, default=64, help="training views")
    parser.add_argument("--test", type=int, default=16, help="test views, with ground truth")
    parser.add_argument("--samples", type=int, default=64, help="Cycles samples per pixel, then denoised")
    parser.add_argument("--light", help="lat-long EXR or one of " + ", ".join(LIGHTS) + "; default: the World of the .blend file, or sky")
    parser.add_argument("--relight", nargs="*", help="more lights for the test views; default: studio sunset")
    parser.add_argument("--light-height", type=int, default=128, help="rows of built-in and baked light maps")
    parser.add_argument("--points", type=int, default=10_000, help="surface samples for mesh scores")
    parser.add_argument("--name", help="name of the scene (default: that of the .blend file or of the built-in scene)")
    parser.add_argument("--hdr", action="store_true", help="write photographs as linear EXR files, too")
    parser.add_argument(
        "--table", action="store_true", help="photographs of the object on a table, with the light map behind, without masks"
    )
    parser.add_argument("--threads", type=int, default=0, help="of Cycles; default: 0, as many as the machine has")
    return parser.parse_args(argv)


def orbit(count: int, phase: float, centre: np.ndarray, radius: float, resolution: int, lowest: float = -30.0) -> list[Camera]:
    """Return cameras on an even spiral over the sphere from an elevation to the top, all looking at the centre.

    Args:
        count: number of cameras.
        phase: offset along the spiral, in cameras.
        centre: centre of the object (3,).
        radius: radius of the object.
        resolution: pixels along a side of the image.
        lowest: elevation of the lowest camera in degrees.
    """
    focal = 0.5 * resolution / np.tan(0.5 * ANGLE_X)
    cameras = []
    for i in range(count):
        z = 1.0 - (1.0 - np.sin(np.radians(lowest))) * (i + 0.5) / count
        azimuth = (i + phase) * np.pi * (3 - np.sqrt(5))
        away = np.array([np.sqrt(1 - z * z) * np.cos(azimuth), np.sqrt(1 - z * z) * np.sin(azimuth), z])
        to_world = look_at(centre + away * radius * LENS_RADII, centre)
        cameras.append(Camera(resolution, resolution, focal, focal, resolution / 2, resolution / 2, to_world))
    return cameras


def load_scene(path: Path | None, name: str) -> bpy.types.Scene:
    """Open a .blend file, or build a built-in scene where the path is None.

    Args:
        path: .blend file.
        name: name of the built-in scene.

    Raises:
        InputError: where there is no such file, or Blender can't open it.
    """
    if path is None:
        SCENES[name]()
    elif not path.is_file():
        raise InputError(path, "no such file")
    else:
        try:
            bpy.ops.wm.open_mainfile(filepath=str(path.resolve()))
        except RuntimeError as error:
            raise InputError(path, f"Blender can't open it ({error})") from error
    return bpy.context.scene


def write_lights(scene: bpy.types.Scene, args: argparse.Namespace) -> list[str]:
    """Write the light maps into envs/.

    Args:
        scene: scene whose World is baked where no light is given.
        args: parsed options.

    Returns:
        Names of the lights, the training light first.
    """
    folder = args.output / "envs"
    folder.mkdir(parents=True)
    relights = ["studio", "sunset"] if args.relight is None else args.relight
    names = []
    if args.light is None and scene.world is not None:
        bake_world(scene, folder / "world.exr", args.light_height)
        names.append("world")
    for light in ([args.light or "sky"] if not names else []) + relights:
        name = light if light in LIGHTS else Path(light).stem
        pixels = LIGHTS[light](args.light_height, 2 * args.light_height) if light in LIGHTS else read_exr_rgb(Path(light))
        write_exr(folder / f"{name}.exr", rgb_channels(np.clip(pixels, 0, 65504)), half=True)
        names.append(name)
    return names


def write_transforms(path: Path, cameras: list[Camera], pattern: str) -> None:
    """Write the cameras as a transforms.json.

    Args:
        path: file to write.
        cameras: cameras in order.
        pattern: format of the image's path with the camera's number.
    """
    frames = [{"file_path": pattern.format(i), "transform_matrix": camera.to_world.tolist()} for i, camera in enumerate(cameras)]
    path.write_text(json.dumps({"camera_angle_x": ANGLE_X, "frames": frames}, indent=1))


def render_train(scene: bpy.types.Scene, cameras: list[Camera], folder: Path, hdr: bool = False) -> None:
    """Render the training views.

    Args:
        scene: scene with its World.
        cameras: training cameras.
        folder: folder to make.
        hdr: write EXR files, too.
    """
    folder.mkdir()
    for i, camera in enumerate(cameras):
        log(f"training view {i + 1} of {len(cameras)}")
        cycles_ground_truth.place_camera(scene, camera)
        scene.cycles.seed = i
        save_photograph(folder / f"r_{i:03d}.png", cycles_ground_truth.render_image(scene)["rgba"], hdr)


def render_test(scene: bpy.types.Scene, cameras: list[Camera], worlds: dict[str, bpy.types.World], folder: Path, hdr: bool = False) -> None:
    """Render every test view under every light, and once its material layers, which do not depend on the light.

    Args:
        scene: scene to render.
        cameras: test cameras.
        worlds: Worlds by name of the light.
        folder: folder of the views.
        hdr: write EXR files, too.
    """
    for n, (name, world) in enumerate(worlds.items()):
        scene.world = world
        for i, camera in enumerate(cameras):
            log(f"test view {i + 1} of {len(cameras)} under {name}")
            view = folder / f"r_{i:03d}"
            view.mkdir(parents=True, exist_ok=True)
            cycles_ground_truth.place_camera(scene, camera)
            scene.cycles.seed = 1000 * (n + 1) + i
            layers = cycles_ground_truth.render_image(scene)
            save_photograph(view / ("rgba.png" if n == 0 else f"rgba_{name}.png"), layers["rgba"], hdr)
            if n == 0:
                layers |= cycles_ground_truth.render_geometry(scene, camera)
                write_layers(view, layers)


def write_meta(args: argparse.Namespace, lights: list[str], corners: np.ndarray, scene: bpy.types.Scene) -> None:
    """Write meta.json, the description of the dataset.

    Args:
        args: parsed options.
        lights: names of the lights, the training light first.
        corners: corners of all triangles (N, 3).
        scene: rendered scene.
    """
    meta = {
        "name": args.name or (args.blend.stem if args.blend else args.scene),
        "blender": bpy.app.version_string,
        "seed": SEED,
        "resolution": [args.resolution, args.resolution],
        "camera_angle_x": ANGLE_X,
        "train_views": args.train,
        "test_views": args.test,
        "samples": args.samples,
        "world_axes": "Blender: right-handed, +Z up",
        "train_light": lights[0],
        "relights": lights[1:],
        "lights": {name: {"file": f"envs/{name}.exr"} for name in lights},
        "materials": {thing.name: "textured" for thing in scene.objects if thing.type == "MESH"},
        "has_material_maps": True,
        "bbox_min": corners.min(0).tolist(),
        "bbox_max": corners.max(0).tolist(),
    }
    (args.output / "meta.json").write_text(json.dumps(meta, indent=1))


def log(text: str) -> None:
    """Print a progress line."""
    print(text, file=sys.stderr, flush=True)


def render_dataset(args: argparse.Namespace) -> None:
    """Render the whole dataset: scene, lights, cameras, images, surface points.

    Raises:
        InputError: where the folder is not empty.
    """
    if args.output.exists() and any(args.output.iterdir()):
        raise InputError(args.output, "is not empty", "name a new folder")
    scene = load_scene(args.blend, args.scene)
    triangles = cycles_ground_truth.world_triangles(scene)
    corners = triangles.reshape(-1, 3)
    around = add_table(corners) if args.table else (np.zeros((0, 3)), np.zeros((0, 3)))
    cycles_ground_truth.prepare(scene, args.samples, SEED, args.threads, transparent=not args.table)
    lights = write_lights(scene, args)
    worlds = {name: world_from_map(args.output / "envs" / f"{name}.exr", name) for name in lights}
    demo = args.blend is None and args.scene == "demo"  # its cameras look at the origin, not at the middle of the object
    centre = np.zeros(3) if demo else (corners.min(0) + corners.max(0)) / 2
    radius = 1.3 if demo else float(np.linalg.norm(corners - centre, axis=-1).max())
    lowest = ABOVE_TABLE if args.table else -30.0
    train = orbit(args.train, 0.0, centre, radius, args.resolution, lowest)
    test = orbit(args.test, 0.37, centre, radius, args.resolution, lowest)
    write_meta(args, lights, corners, scene)
    write_transforms(args.output / "transforms_train.json", train, "./train/r_{:03d}")
    write_transforms(args.output / "transforms_test.json", test, "./test/r_{:03d}/rgba")
    write_surface(args.output, cycles_ground_truth.visible_points(triangles, train, args.points, SEED), triangles, around)
    scene.world = worlds[lights[0]]
    render_train(scene, train, args.output / "train", args.hdr)
    render_test(scene, test, worlds, args.output / "test", args.hdr)


def main(argv: list[str] | None = None) -> int:
    """Render the dataset and return the exit status."""
    args = arguments(argv)
    return reported(lambda: render_dataset(args))


def reported(work: Callable[[], None]) -> int:
    """Do some work and return the exit status; an error becomes one line."""
    try:
        work()
    except IrgsppError as error:
        log(str(error))
        return error.exit_status
    return 0


if __name__ == "__main__":
    sys.exit(main())
