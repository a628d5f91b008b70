# SPDX-License-Identifier: GPL-3.0-or-later
"""The whole step on a sphere with a known pattern."""

import shutil
from dataclasses import replace

import numpy as np
import pytest
import torch
from irgspp.core.detail.albedo_detail import detailed, detailed_by_dataset
from irgspp.core.detail.evidence import Evidence
from irgspp.core.detail.photographs import object_pixels
from irgspp.core.errors import Cancelled
from irgspp.core.io.srgb import decode_srgb, encode_srgb
from irgspp.core.progress.protocol import Silent
from irgspp.core.settings.overrides import with_overrides
from irgspp.core.settings.schema import Settings
from PIL import Image
from scipy import ndimage

SEEN = slice(150, 340)  # rows of the texture that several photographs see well


class Messages(Silent):
    """Progress that keeps its messages."""

    def __init__(self):
        self.lines = []

    def message(self, text):
        self.lines.append(text)


def linear(mesh):
    return decode_srgb(mesh.textures["albedo"] / 255.0)


def psnr(a, b):
    return -10 * np.log10(((encode_srgb(a[SEEN]) - encode_srgb(b[SEEN])) ** 2).mean())


def gradient_energy(image):
    """Energy above a quarter of the highest frequency that the photographs hold, about 1.2 texels per pixel."""
    grey = encode_srgb(image[SEEN])[..., 1]
    return float(((grey - ndimage.gaussian_filter(grey, 3)) ** 2).mean())


@pytest.fixture(scope="module")
def result(written):
    progress = Messages()
    return (*detailed(written.mesh, written.reconstruction, written.photographs(), "auto", progress), progress.lines)


def test_the_texture_is_as_sharp_as_the_truth(written, result):
    mesh, report, lines = result
    assert report.applied and report.correlation > 0.9 > 0.6 > report.correlation_before
    assert psnr(linear(mesh), written.truth) > 35 > 20 > psnr(linear(written.mesh), written.truth)
    assert gradient_energy(linear(mesh)) > 0.9 * gradient_energy(written.truth)
    assert "albedo detail of 10 photographs" in lines[-1] and "texels per pixel" in lines[-1]


def test_low_frequencies_are_those_of_the_working_solution(written, result):
    new, old = (ndimage.gaussian_filter(linear(mesh)[SEEN], (30, 30, 0)) for mesh in (result[0], written.mesh))
    assert np.abs(new / old - 1).mean() < 0.04


def test_the_density_is_reported(written, result):
    report = result[1]
    assert report.pixel == pytest.approx(2 / (1.4 * 240), rel=0.1)  # the nearest point of the sphere is 2 away
    assert report.texel == pytest.approx(np.sqrt(2) * np.pi / 512, rel=0.4)
    assert 0.5 < report.seen < 1


def at_full_size(photographs):
    """Return photographs whose working resolution is that of their files."""
    frames = [replace(one.working, lens=one.lens, camera=one.working.camera.resized(*one.lens.size)) for one in photographs]
    return [replace(one, working=frame) for one, frame in zip(photographs, frames, strict=True)]


def with_gaussians(reconstruction, count):
    """Return a reconstruction with copies of its Gaussians."""
    chosen = torch.arange(count) % reconstruction.gaussians.count
    return replace(reconstruction, gaussians=reconstruction.gaussians.select(chosen))


def test_photographs_of_the_working_resolution_are_left_alone(written):
    many = with_gaussians(written.reconstruction, 60_000)
    mesh, report = detailed(written.mesh, many, at_full_size(written.photographs()), "auto", Silent())
    assert mesh is written.mesh and not report.applied and "not larger" in report.why


def test_unless_they_show_more_pixels_than_there_are_gaussians(written):
    few = with_gaussians(written.reconstruction, 10_000)
    mesh, report = detailed(written.mesh, few, at_full_size(written.photographs()), "auto", Silent())
    assert report.applied and psnr(linear(mesh), written.truth) > 33


def test_where_the_gaussians_saw_every_pixel_the_detail_must_agree_clearly_better(written, monkeypatch):
    few, photographs = with_gaussians(written.reconstruction, 10_000), at_full_size(written.photographs())
    monkeypatch.setattr(Evidence, "correlations", (0.39, 0.35))
    assert not detailed(written.mesh, few, photographs, "auto", Silent())[1].applied
    assert detailed(written.mesh, few, written.photographs(), "auto", Silent())[1].applied  # larger ones: a gain is enough


def test_pixels_that_show_the_object_follow_from_its_mesh(written):
    masks = [one.load().alpha.mean() * one.lens.width * one.lens.height for one in written.photographs()]
    assert object_pixels(written.mesh, written.photographs()) == pytest.approx(np.mean(masks), rel=0.25)


def test_photographs_of_something_else_change_nothing(written, tmp_path):
    folder = tmp_path / "other"
    shutil.copytree(written.folder, folder)
    random = np.random.default_rng(0)
    for file in sorted((folder / "train").glob("*.png")):
        image = np.asarray(Image.open(file)).copy()
        image[..., :3] = ndimage.gaussian_filter(random.integers(0, 256, image[..., :3].shape), (1, 1, 0))
        Image.fromarray(image).save(file)
    photographs = [replace_folder(one, folder) for one in written.photographs()]
    mesh, report = detailed(written.mesh, written.reconstruction, photographs, "auto", Silent())
    assert not report.applied and mesh is written.mesh


def replace_folder(photograph, folder):
    frame = photograph.working.frame
    working = replace(photograph.working, frame=replace(frame, image=folder / "train" / frame.image.name))
    return replace(photograph, working=working)


def test_missing_and_changed_photographs_are_named_in_one_line_each(written, tmp_path):
    folder = tmp_path / "fewer"
    shutil.copytree(written.folder, folder)
    for number in range(2, 10):
        (folder / "train" / f"r_{number}.png").unlink()
    settings, progress = with_overrides(Settings(), ["data.resolution=80", "data.exposure=off"]), Messages()
    mesh, report = detailed_by_dataset(written.mesh, written.reconstruction, folder, written.views(), settings, progress)
    assert mesh is written.mesh and not report.applied and "2 full-size photographs" in report.why
    assert len([line for line in progress.lines if "8 of 10 photographs" in line]) == 1


def test_a_damaged_photograph_is_left_out_with_a_line(written, tmp_path):
    folder = tmp_path / "damaged"
    shutil.copytree(written.folder, folder)
    file = folder / "train" / "r_2.png"
    file.write_bytes(file.read_bytes()[:3000])
    progress = Messages()
    photographs = [replace_folder(one, folder) for one in written.photographs()]
    mesh, report = detailed(written.mesh, written.reconstruction, photographs, "auto", progress)
    assert report.photographs == 9 and psnr(linear(mesh), written.truth) > 30
    assert len([line for line in progress.lines if "r_2.png" in line and "left out" in line]) == 1


def test_off_reads_nothing(written, tmp_path):
    settings = with_overrides(Settings(), ["surface.albedo_detail=off"])
    mesh, report = detailed_by_dataset(written.mesh, written.reconstruction, tmp_path / "gone", {}, settings, Silent())
    assert mesh is written.mesh and report.why == "turned off"


def test_it_can_be_cancelled(written):
    stopped = Silent()
    stopped.cancelled = True
    with pytest.raises(Cancelled):
        detailed(written.mesh, written.reconstruction, written.photographs(), "auto", stopped)
