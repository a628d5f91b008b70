# SPDX-License-Identifier: GPL-3.0-or-later
"""A disk's height over its neighbours: none on a sphere, that of a displaced disk, and it goes when it is thinned."""

import torch
from irgspp.core.stages.layer import layer_offset, thin


def test_no_height_on_a_sphere(splat_sphere):
    g = splat_sphere(2000)
    normal = torch.nn.functional.normalize(g.position, dim=0).T
    assert layer_offset(g.position.T.contiguous(), normal, torch.arange(2000)).abs().max() < 1e-6


def test_displaced_disk_is_found_and_pulled_back(splat_sphere):
    g = splat_sphere(2000)
    g.position[:, 700] *= 1.05
    normal = g.normals().T.contiguous()
    offset = layer_offset(g.position.T.contiguous(), normal, torch.arange(2000))
    assert abs(offset[700] - 0.05) < 0.005
    assert offset.abs().argmax() == 700
    thin(g, 1.0)
    assert abs(g.position[:, 700].norm() - 1) < 0.005


def test_transparent_disks_and_the_other_side_do_not_count(splat_sphere):
    g = splat_sphere(2000)
    behind = splat_sphere(2000)
    behind.position *= 0.98
    w, x, y, z = behind.quaternion
    behind.quaternion = torch.stack([-x, w, z, -y])  # turned over
    both = g.joined(behind)
    normal = both.normals().T.contiguous()
    assert (normal[2000:] * both.position.T[2000:]).sum(1).max() < 0  # the inner sheet looks inward
    assert layer_offset(both.position.T.contiguous(), normal, torch.arange(4000)).abs().max() < 1e-5
    ghost = splat_sphere(2000, opacity=0.1)
    ghost.position *= 1.02
    mixed = g.joined(ghost)
    thin(mixed, 1.0)
    assert (mixed.position[:, :2000].norm(dim=0) - 1).abs().max() < 1e-5
    assert (mixed.position[:, 2000:].norm(dim=0) - 1).abs().max() < 5e-3
