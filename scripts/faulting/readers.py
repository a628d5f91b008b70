# SPDX-License-Identifier: GPL-3.0-or-later
"""Readers of files from elsewhere, with valid files to start from."""

from __future__ import annotations

import json
import pickle
import shutil
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import torch
from formats import WRITERS
from formats.source import load_source
from irgspp.core.batch.jobs import read_jobs
from irgspp.core.cli.parser import check_words
from irgspp.core.datasets.formats.colmap_model import read_points as read_colmap_points
from irgspp.core.datasets.load import load_dataset_cameras
from irgspp.core.datasets.sparse_points import read_points
from irgspp.core.errors import InputError
from irgspp.core.evaluation.surface_truth import rendered_points
from irgspp.core.io.exr import exr_size, read_exr_rgb, write_exr
from irgspp.core.io.image import image_size, read_image, read_mask
from irgspp.core.io.safe_pickle import read_pickle
from irgspp.core.pipeline import DEMO_DATA
from irgspp.core.scene.edited_mesh import load_edited_mesh
from irgspp.core.scene.environment_files import read_environment
from irgspp.core.scene.gaussians import Gaussians, load_gaussians, save_gaussians
from irgspp.core.scene.mesh import Mesh
from irgspp.core.scene.mesh_ply import load_mesh_ply, save_mesh_ply
from irgspp.core.scene.surface import Surface
from irgspp.core.scene.surface_ply import load_surface_ply, save_surface_ply
from irgspp.core.settings.schema import DataSettings
from PIL import Image

from . import photographs
from .runs import read_checkpoint, read_layer, read_state, write_run

IMAGES = ("picture.png", "grey.png", "palette.png", "deep.png", "picture.jpg")
EXRS = ("zip.exr", "half.exr", "piz.exr", "grey.exr")


@dataclass(frozen=True)
class Reader:
    """Reader of files.

    Attributes:
        name: name of the reader.
        files: files, of which one at a time is broken.
        make: writes valid files into a folder.
        read: reads a folder whose given file is broken.
        text: True for text files.
    """

    name: str
    files: tuple[str, ...]
    make: Callable[[Path], None]
    read: Callable[[Path, Path], object]
    text: bool = False


def write_scene(format: str, folder: Path) -> None:
    """Write five views and few points of the demonstration in the layout of a dataset.

    Args:
        format: name of the layout.
        folder: folder of the files.
    """
    source = load_source(DEMO_DATA)
    points = {"points": source.points[:60], "normals": source.normals[:60]}
    few = replace(source, name="scene", train=source.train[::10], test=source.test[:1], **points)
    made, _ = WRITERS[format](few, folder.parent / "made")
    shutil.copytree(made, folder, dirs_exist_ok=True)
    shutil.rmtree(folder.parent / "made")


def write_colmap(folder: Path, text: bool) -> None:
    """Write a sparse model of five views with points.

    Args:
        folder: folder of the files.
        text: True for the text format, False for the binary one.
    """
    write_scene("ref-real", folder)
    model = next(f.parent for f in sorted(folder.rglob("cameras.*")))
    suffix = ".txt" if text else ".bin"
    if not (model / f"cameras{suffix}").is_file():
        _converted(model, text)
    for file in [f for f in model.iterdir() if f.suffix != suffix]:
        file.unlink()
    if model != folder / "sparse" / "0":
        (folder / "sparse").mkdir(exist_ok=True)
        model.rename(folder / "sparse" / "0")


def _converted(model: Path, text: bool) -> None:
    """Convert a binary model to text."""
    from formats import colmap_files
    from irgspp.core.datasets.formats import colmap_model

    assert text, "the writer makes binary models"
    cameras = colmap_model.read_cameras(model / "cameras.bin")
    images = colmap_model.read_images(model / "images.bin")
    points = read_colmap_points(model / "points3D.bin")
    assert colmap_files
    lines = [f"{n} {c.model} {c.width} {c.height} {' '.join(map(repr, c.parameters))}" for n, c in cameras.items()]
    (model / "cameras.txt").write_text("# cameras\n" + "\n".join(lines) + "\n")
    lines = [f"{i} {' '.join(map(repr, (*m.quaternion, *m.translation)))} {m.camera} {m.name}\n" for i, m in enumerate(images, 1)]
    (model / "images.txt").write_text("# images\n" + "\n".join(lines) + "\n")
    rows = zip(points.position.tolist(), points.colour.tolist(), strict=True)
    lines = [f"{i} {' '.join(map(repr, p))} {' '.join(map(str, c))} 0.5 1 2 2 3" for i, (p, c) in enumerate(rows, 1)]
    (model / "points3D.txt").write_text("# points\n" + "\n".join(lines) + "\n")


def read_dataset(folder: Path, file: Path) -> object:
    """Read a dataset as commands do before they decode images: its description, and the cameras.

    Args:
        folder: folder of the dataset.
        file: broken file, unused.
    """
    return load_dataset_cameras(folder, "all", DataSettings())


def write_transforms(folder: Path) -> None:
    """Write a transforms.json with all that the format's variants have, and its images."""
    write_scene("nerfstudio", folder)
    for file in folder.glob("transforms*.json"):
        content = json.loads(file.read_text())
        content["frames"][0] |= {"fl_x": 70.0, "k1": 0.01, "camera_model": "OPENCV"}
        file.write_text(json.dumps(content, indent=0))


def write_plys(folder: Path) -> None:
    """Write points, Gaussians and meshes, binary and ASCII."""
    random = np.random.default_rng(0)
    values = (torch.from_numpy(random.normal(size=s).astype(np.float32)) for s in ((3, 4), (4, 4), (2, 4), (4,), (16, 3, 4), (5, 4)))
    save_gaussians(Gaussians(*values), folder / "gaussians.ply")
    corners = random.random((4, 3)).astype(np.float32)
    faces = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    mesh = Mesh(corners, corners, corners[:, :2], faces, corners, corners[:, 0], corners[:, 1])
    save_mesh_ply(mesh, folder / "mesh.ply")
    save_surface_ply(Surface(mesh.vertices, mesh.normals, mesh.faces, 0.1), folder / "fine_surface.ply")
    head = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
    vertices = "".join(f"{x} {y} {z}\n" for x, y, z in corners.tolist())
    (folder / "points.ply").write_text(head + "end_header\n" + vertices)
    face = "element face 2\nproperty list uchar int vertex_indices\nend_header\n"
    (folder / "edited.ply").write_text(head + face + vertices + "3 0 1 2\n4 0 1 2 3\n")


def read_ply(folder: Path, file: Path) -> object:
    """Read a file by every reader of PLY files.

    Args:
        folder: folder of the file, unused.
        file: file to read.
    """
    return _all([lambda f=f: f(file) for f in (read_points, load_gaussians, load_mesh_ply, load_surface_ply, load_edited_mesh)])


def _all(reads: list[Callable[[], object]]) -> list[object]:
    """Return the results of several readers; raise the last InputError where all refuse the file."""
    results, refused = [], InputError("", "")
    for read in reads:
        try:
            results.append(read())
        except InputError as error:
            refused = error
    if not results:
        raise refused
    return results


def write_exrs(folder: Path) -> None:
    """Write float and half images with several compressions."""
    import OpenEXR

    pixels = np.random.default_rng(0).random((12, 16, 3)).astype(np.float32)
    channels = {name: pixels[..., i] for i, name in enumerate("RGB")}
    write_exr(folder / "zip.exr", channels)
    write_exr(folder / "half.exr", channels, half=True)
    write_exr(folder / "grey.exr", {"Y": pixels[..., 0]})
    header = {"compression": OpenEXR.PIZ_COMPRESSION, "type": OpenEXR.scanlineimage}
    with OpenEXR.File(header, {name: np.ascontiguousarray(c) for name, c in channels.items()}) as file:
        file.write(str(folder / "piz.exr"))


def write_hdrs(folder: Path) -> None:
    """Write images with and without run lengths, of aspect 2:1 and others."""
    random = np.random.default_rng(0)
    cv2.imwrite(str(folder / "light.hdr"), random.random((16, 32, 3)).astype(np.float32))
    cv2.imwrite(str(folder / "small.hdr"), random.random((4, 6, 3)).astype(np.float32))  # too narrow for run lengths


def write_images(folder: Path) -> None:
    """Write PNG files of every kind that occurs, and a JPEG."""
    pixels = np.random.default_rng(0).integers(0, 256, (12, 16, 4)).astype(np.uint8)
    Image.fromarray(pixels).save(folder / "picture.png")
    Image.fromarray(pixels[..., 0]).save(folder / "grey.png")
    Image.fromarray(pixels[..., :3]).quantize(8).save(folder / "palette.png", transparency=3)
    Image.fromarray(pixels[..., 0].astype(np.uint16) * 257).save(folder / "deep.png")
    Image.fromarray(pixels[..., :3]).save(folder / "picture.jpg")


def read_any_image(folder: Path, file: Path) -> object:
    """Read an image's size, its pixels, a mask, and a light map.

    Args:
        folder: folder of the file, unused.
        file: file to read.
    """
    return _all([lambda f=f: f(file) for f in (image_size, read_image, read_mask, read_environment)])


def write_toml(folder: Path) -> None:
    """Write a list of jobs."""
    (folder / "jobs.toml").write_text(
        '[defaults]\npreset = "draft"\nset = ["first.iterations=5"]\n\n[[job]]\ndataset = "a"\noutput = "runs/a"\nseed = 3\n'
        'after = ["evaluate -o {output}/e", "export -o {name}.glb"]\n\n[[job]]\nname = "b"\ndataset = "b"\noutput = "runs/b"\n'
    )


def write_points(folder: Path) -> None:
    """Write surface samples as scripts/render_dataset.py writes them."""
    normals = np.eye(3, dtype=np.float16)
    np.savez_compressed(folder / "surface_points.npz", points=np.eye(3, dtype=np.float32), normals=normals)


def write_pickles(folder: Path) -> None:
    """Write cameras as GlossySynthetic has them, in several protocols."""
    for protocol in (0, 2, 4, 5):
        value = [np.arange(12.0).reshape(3, 4), {"a": np.float32(2), "b": [1, "x", (None, True)]}]
        (folder / f"{protocol}.pkl").write_bytes(pickle.dumps(value, protocol))


MODEL = "sparse/0"
READERS = (
    Reader(
        "COLMAP binary",
        tuple(f"{MODEL}/{n}.bin" for n in ("cameras", "images", "points3D")),
        lambda f: write_colmap(f, False),
        read_dataset,
    ),
    Reader(
        "COLMAP text",
        tuple(f"{MODEL}/{n}.txt" for n in ("cameras", "images", "points3D")),
        lambda f: write_colmap(f, True),
        read_dataset,
        True,
    ),
    Reader("transforms.json", ("transforms.json",), write_transforms, read_dataset, True),
    Reader("PLY", ("points.ply", "gaussians.ply", "mesh.ply", "fine_surface.ply", "edited.ply"), write_plys, read_ply),
    Reader("EXR", EXRS, write_exrs, lambda _, file: (exr_size(file), read_exr_rgb(file))),
    Reader("HDR", ("light.hdr", "small.hdr"), write_hdrs, lambda _, file: read_environment(file)),
    Reader("PNG and JPEG", IMAGES, write_images, read_any_image),
    Reader("run.json", ("run/run.json",), write_run, read_state, True),
    Reader("checkpoints", ("run/checkpoint/geometry.pt", "run/checkpoint/first_stage.pt"), write_run, read_checkpoint),
    Reader("layers of a run", ("run/reflections.npz", "run/cameras.json"), write_run, read_layer),
    Reader("job TOML", ("jobs.toml",), write_toml, lambda _, file: read_jobs(file, check_words), True),
    Reader("Metashape XML", ("cameras.xml",), lambda f: write_scene("metashape", f), read_dataset, True),
    Reader("RealityCapture CSV", ("cameras.csv",), lambda f: write_scene("realitycapture", f), read_dataset, True),
    Reader("true points", ("surface_points.npz",), write_points, lambda folder, _: rendered_points(folder)),
    Reader("pickles", ("0.pkl", "2.pkl", "4.pkl", "5.pkl"), write_pickles, lambda _, file: read_pickle(file)),
    Reader("photographs", photographs.PHOTOGRAPHS, photographs.write_photographs, photographs.read_photograph),
    Reader("given masks", photographs.MASKS, photographs.write_masks, photographs.read_given_mask),
    Reader("videos", photographs.VIDEOS, photographs.write_videos, photographs.read_video),
)
