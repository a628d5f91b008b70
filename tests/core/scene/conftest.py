# SPDX-License-Identifier: GPL-3.0-or-later
"""Fixture: a small mesh with UVs, materials and textures."""

import numpy as np
import pytest
import trimesh
from irgspp.core.scene.mesh import Mesh


@pytest.fixture
def mesh() -> Mesh:
    body, rng = trimesh.creation.icosphere(2), np.random.default_rng(0)
    count = len(body.vertices)
    layers = body.vertices, body.vertices, rng.random((count, 2)), body.faces, rng.random((count, 3)), rng.random(count), rng.random(count)
    vertices, normals, uvs, faces, albedo, roughness, metallic = (np.asarray(x) for x in layers)
    shapes = {"albedo": (16, 16, 3), "roughness": (16, 16), "metallic": (16, 16), "normal": (16, 16, 3)}
    textures = {name: rng.integers(0, 256, shape, dtype=np.uint8) for name, shape in shapes.items()}
    floats = (x.astype(np.float32) for x in (vertices, normals, uvs))
    return Mesh(*floats, faces.astype(np.int32), *(x.astype(np.float32) for x in (albedo, roughness, metallic)), textures=textures)
