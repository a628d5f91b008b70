# SPDX-License-Identifier: GPL-3.0-or-later
"""Mitsuba's inverse rendering in a process of its own: `python -m benchmarks.mitsuba_inverse FOLDER`; see peer_inverse.py.

Adam through path replay (`prb`) optimises albedo, roughness and metallic of the vertices and the logarithm of the light map, from random
pixels of all photographs at once. FOLDER/arrays.npz has the mesh, and of each pixel that shows the object alone its view, corner, colour
and whether it is saturated. FOLDER/answer.json gets iterations and seconds of each state, FOLDER/<name>_<number>.npy are the states.
"""

# pyright: reportMissingImports=false, reportAttributeAccessIssue=false, reportCallIssue=false, reportArgumentType=false
# pyright: reportGeneralTypeIssues=false, reportOperatorIssue=false
# (Mitsuba is optional, and its types depend on the variant)

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from .mitsuba_child import read_request

CORNER = 1e-2  # encoded difference below which the loss is quadratic
DARKEST = 1e-4  # lowest value of a texel, and of radiance before encoding
LAST = 0.1  # final fraction of the learning rates
LEAST = {"vertex_albedo": 0.005, "vertex_roughness": 0.05}  # lower bounds
VALUES = {"vertex_albedo": 3, "vertex_roughness": 1, "vertex_metallic": 1}  # channels of the vertices' attributes


def main(folder: Path) -> None:
    """Answer the request in a folder."""
    request, arrays = read_request(folder)
    Descent(arrays, request).step(0.0)  # compiles
    states = Descent(arrays, request).run(folder)
    (folder / "answer.json").write_text(json.dumps({"states": states}), encoding="utf-8")


class Descent:
    """Gradient descent on the materials and the light of a scene."""

    def __init__(self, arrays: dict[str, np.ndarray], request: dict[str, Any]) -> None:
        from . import mitsuba_pixels, mitsuba_scene

        self.request, self.random = request, np.random.default_rng(request["seed"])
        self.colour, self.saturated = arrays["pixel_colour"], arrays["pixel_saturated"]
        shape = mitsuba_scene.mesh_shape(arrays, mitsuba_scene.material(arrays, "ours"))
        light = {"type": "envmap", "bitmap": mi.Bitmap(arrays["light"]), "to_world": mi.ScalarTransform4f(mitsuba_scene.MAP_TO_WORLD)}
        integrator = {"type": "prb", "max_depth": request["bounces"] + 2, "hide_emitters": True}
        self.scene = mi.load_dict({"type": "scene", "integrator": integrator, "object": shape, "light": light})
        self.sensor = mitsuba_pixels.PixelSensor.make(arrays, request["pixels"])
        self.parameters = mi.traverse(self.scene)
        self.adam = mi.ad.Adam(lr=1e-2, mask_updates=True)
        for name in VALUES:
            self.adam[name] = mi.Float(self.parameters[f"object.{name}"])
        self.adam["light"] = dr.log(dr.maximum(mi.TensorXf(arrays["light"]), DARKEST))
        self.columns = _seam(arrays["light"].shape)
        self._update_scene()

    def run(self, folder: Path) -> list[dict[str, float]]:
        """Iterate until the last of the budgets in seconds is spent, and save the state at each.

        Args:
            folder: folder for the states.

        Returns:
            Budget, seconds, iterations and loss of each state.
        """
        budgets, states, done, spent = list(self.request["budgets"]), [], 0, 0.0
        while budgets:
            began = time.perf_counter()
            loss = self.step(spent / self.request["budgets"][-1])
            spent, done = spent + time.perf_counter() - began, done + 1
            while budgets and spent >= budgets[0]:
                self._save(folder, len(states))
                states.append({"budget": budgets.pop(0), "seconds": spent, "iterations": done, "loss": loss})
        return states

    def step(self, spent: float) -> float:
        """Do one iteration and return its loss.

        Args:
            spent: fraction of the time that is spent, which lowers the learning rates.
        """
        rates = {name: rate * LAST**spent for name, rate in self.request["rates"].items()}
        self.adam.set_learning_rate(rates)
        chosen = self.random.integers(len(self.colour), size=self.request["pixels"], dtype=np.uint32)
        self.sensor.choose(chosen)
        seed = int(self.random.integers(1 << 30))
        image = mi.render(self.scene, self.parameters, sensor=self.sensor, spp=self.request["samples"], seed=seed)
        loss = self._photometric(image, chosen) + self.request["light_smoothness"] * _variation(self.adam["light"])
        dr.backward(loss)
        self.adam.step()
        self._update_scene()
        return float(loss.array[0])

    def _photometric(self, image: mi.TensorXf, chosen: np.ndarray) -> mi.TensorXf:
        """Return the loss of our second stage: encoded differences, of which those above a saturated pixel are 0."""
        target = mi.Float(np.ascontiguousarray(self.colour[chosen].ravel()))
        saturated = mi.Bool(np.ascontiguousarray(self.saturated[chosen].ravel()))
        difference = _encoded(image.array) - target
        difference = dr.select(saturated & (difference > 0), 0, difference)
        return mi.TensorXf(dr.mean(dr.sqrt(dr.square(difference) + CORNER**2)))

    def _update_scene(self) -> None:
        """Write the parameters into the scene, clipped to their ranges."""
        for name in VALUES:
            self.adam[name] = dr.clip(self.adam[name], LEAST.get(name, 0.0), 1.0)
            self.parameters[f"object.{name}"] = self.adam[name]
        height, width, _ = self.adam["light"].shape
        texels = dr.gather(mi.Float, dr.exp(self.adam["light"]).array, self.columns)
        self.parameters["light.data"] = mi.TensorXf(texels, (height, width + 1, 3))
        self.parameters.update()

    def _save(self, folder: Path, number: int) -> None:
        """Write the current materials and light as NPY files."""
        for name, size in VALUES.items():
            np.save(folder / f"{name}_{number}.npy", np.array(self.adam[name]).reshape(-1, size).squeeze())
        np.save(folder / f"light_{number}.npy", np.exp(np.array(self.adam["light"])))


def _encoded(linear: mi.Float) -> mi.Float:
    """Return sRGB-encoded values with a finite slope at 0 and no limit at 1."""
    safe = dr.maximum(linear, DARKEST)
    return dr.select(safe <= 0.0031308, 12.92 * safe, 1.055 * dr.power(safe, 1 / 2.4) - 0.055)


def _variation(light: mi.TensorXf) -> mi.TensorXf:
    """Return the mean squared difference of neighbours of a log light map (H, W, 3), wrapped in the row."""
    inner, seam, down = light[:, 1:] - light[:, :-1], light[:, :1] - light[:, -1:], light[1:] - light[:-1]
    return dr.mean(dr.square(inner)) + dr.mean(dr.square(seam)) / light.shape[1] + dr.mean(dr.square(down))


def _seam(shape: tuple[int, ...]) -> mi.UInt32:
    """Return indices that repeat the first column of a map at its end, as Mitsuba stores it."""
    index = np.arange(np.prod(shape), dtype=np.uint32).reshape(shape)
    return mi.UInt32(np.concatenate([index, index[:, :1]], 1).ravel())


if __name__ == "__main__":
    main(Path(sys.argv[1]))
