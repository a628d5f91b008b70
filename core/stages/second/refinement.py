# SPDX-License-Identifier: GPL-3.0-or-later
"""The second stage's last part: materials, normals and light by stochastic gradients of the rendering equation, pixel by pixel.

Each step shades a few pixels with many light samples: absolute errors of noisy estimates are biased, so noise costs more than pixels.
Views that are held back have the last word: what does not serve them is not kept.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch
from scipy.spatial import KDTree

from ...io.srgb import encode_srgb
from ...machine.backend import by_warp
from ...rendering.secondary_rays import SecondaryTracer
from ...scene.camera import Camera
from ...scene.gaussians import METALLIC, Gaussians
from ...scene.reconstruction import Reconstruction
from ...settings.schema import SecondStageSettings
from ...shading.environment_lookup import lookup
from ...shading.rendering_equation import reflect_light
from ...shading.sampling import LightDistribution, Samples, draw
from ..common.finite_check import due, require_finite
from ..common.optimizer import GaussianOptimizer, Rate
from .pixel_gbuffer import CachedHits, RasterizedViews
from .pixel_pool import PixelPool

HOLD_BACK = 8  # every so many views one is held back
TEST_PIXELS, TEST_SAMPLES = 3000, (16, 32, 16)
CORNER = 1e-2  # encoded; below it errors count squared
SHARES = {"low-gloss": (0.5, 0.25, 0.25), "metal": (0.125, 0.5, 0.375)}  # of cosine, visible-normal and light samples
MOSTLY_METAL = 0.5  # mean metallic above which the object is metal all over
METAL_PACE = 3.0  # how much faster the light goes where all one sees is reflections of the light
NEIGHBOURS = 4
LIKE = 8.0  # fall of likeness with the difference in albedo
SMOOTHED = 8192  # Gaussians whose neighbours are looked at in one step
DARKEST = 1e-4  # of a light's texels: their logarithm is optimised


class Refinement:
    """Gradient descent on `reconstruction` and how well it does."""

    def __init__(
        self,
        reconstruction: Reconstruction,
        pool: PixelPool,
        tracer: SecondaryTracer,
        settings: SecondStageSettings,
        seed: int,
        *,
        cameras: Sequence[Camera] = (),
    ) -> None:
        """`cameras`: of the pool's views, which are then drawn anew in each step, for comparison."""
        self.start, self.pool, self.tracer, self.settings = reconstruction, pool, tracer, settings
        self.generator = torch.Generator().manual_seed(seed)
        g = reconstruction.gaussians
        self.light = reconstruction.environment.clamp_min(DARKEST).log().contiguous().requires_grad_()
        metal = is_metal(g)
        table = {name: Rate(1e-2, 0.1) for name in ("albedo", "roughness")}
        table["light"] = Rate(5e-3 * (METAL_PACE if metal else 1.0), 0.1)
        # A metal's normals were found by what they reflect; noise that sharp would only scatter them, and a metal that is a little less
        # of one would explain their errors as diffuse light.
        if not metal:
            table |= {"metallic": Rate(1e-2, 0.1), "quaternion": Rate(settings.normal_rate, 0.1)}
        self.optimizer = GaussianOptimizer(g, table, {"light": self.light})
        radius = reconstruction.bound.radius
        self.surface = RasterizedViews(pool, cameras, radius) if cameras else CachedHits(pool, facing_side(g, pool))
        views = int(pool.number.max()) + 1
        held = (pool.number % HOLD_BACK == HOLD_BACK // 2) if views >= HOLD_BACK else torch.zeros_like(pool.number, dtype=torch.bool)
        tested = torch.nonzero(held if held.any() else ~held)[:, 0]
        self.tested = tested[torch.randperm(len(tested), generator=self.generator)[:TEST_PIXELS].to(tested.device)]
        self.trained = torch.nonzero(~held)[:, 0]
        self.counts = split(settings.samples, SHARES["metal" if metal else "low-gloss"])
        self._neighbours, self._likeness = likeness(g)
        self.done = 0

    def run(self, step=lambda done: None) -> None:
        """All steps; `step` is told how many are done, may raise, and ends the run where it returns True."""
        while self.done < self.settings.iterations:
            self.step()
            if step(self.done):
                return

    def step(self) -> None:
        """One step of the schedule."""
        loss = self._loss()
        if due(loss, self.done + 1):
            if not loss.isfinite():
                self.optimizer.check_finite()  # names the parameter where it is one
            require_finite({"the second stage's loss": loss}, f"at iteration {self.done + 1}")
        loss.backward()
        self.optimizer.step(self.done / self.settings.iterations)
        self.done += 1

    def paced(self, iterations: int) -> None:
        """Go on with a schedule of another length."""
        self.settings = replace(self.settings, iterations=iterations)

    def test(self) -> float:
        """PSNR in dB of shaded pixels of the held-back views, always by the same samples."""
        light, generator = self.light.detach().exp(), torch.Generator().manual_seed(0)
        error = []
        with torch.no_grad():
            for pixels in self.tested.split(1000):
                colour = self._shade(pixels, TEST_SAMPLES, light, generator)
                error.append((self._difference(colour, pixels)).square().mean(1))
        return -10 * math.log10(max(float(torch.cat(error).mean()), 1e-10))

    def result(self) -> Reconstruction:
        """The reconstruction as it is now."""
        g = self.optimizer.gaussians
        refined = self.start.relabelled(g.material.detach().clone(), self.light.detach().exp())
        return replace(refined, gaussians=replace(refined.gaussians, quaternion=g.quaternion.detach().clone()))

    def _loss(self) -> torch.Tensor:
        light = self.light.exp()
        pixels = self.surface.chosen(self.trained, self.settings.pixels, self.generator)
        difference = self._difference(self._shade(pixels, self.counts, light, self.generator), pixels)
        loss = (difference.square() + CORNER**2).sqrt().mean()
        return loss + self._smoothness() + self.settings.light_smoothness * variation(self.light) + self._white_balance(light)

    def _difference(self, colour: torch.Tensor, pixels: torch.Tensor) -> torch.Tensor:
        """Encoded differences (B, 3); what exceeds a saturated pixel is none."""
        difference = encode_srgb(colour.clamp_min(1e-5)) - self.pool.colour[pixels]
        return torch.where(self.pool.saturated[pixels] & (difference > 0), 0.0, difference)

    def _shade(self, pixels: torch.Tensor, counts: tuple[int, int, int], light: torch.Tensor, generator: torch.Generator) -> torch.Tensor:
        """(B, 3) linear radiance of pixels by the rendering equation."""
        view, (normal, albedo, roughness, metallic) = self.pool.view[pixels], self._materials(pixels)
        distribution = LightDistribution(light.detach())
        samples = draw(view, normal.detach(), roughness.detach(), counts, distribution, generator, self.settings.sampling)
        incoming = self._incoming(self.pool.point[pixels], normal.detach(), samples, light)
        diffuse, specular = reflect_light(view, normal, albedo, roughness, metallic, samples, incoming, conserving=True)
        return diffuse + specular

    def _materials(self, pixels: torch.Tensor) -> tuple[torch.Tensor, ...]:
        """Normal (B, 3), albedo (B, 3), roughness and metallic (B,) of pixels."""
        at = self.surface.sums(self.optimizer.gaussians, pixels)
        albedo, roughness, metallic = (at[:, 3:] / self.pool.opacity[pixels, None]).split([3, 1, 1], 1)
        return torch.nn.functional.normalize(at[:, :3], dim=1), albedo, roughness[:, 0], metallic[:, 0]

    def _incoming(self, point: torch.Tensor, normal: torch.Tensor, samples: Samples, light: torch.Tensor) -> torch.Tensor:
        """(B, N, 3) V L + indirect, 0 below the horizon."""
        direction = samples.direction
        if by_warp(direction):  # all rays, those below as ones that go nowhere: their number would have to be waited for
            over = direction @ normal[..., None] > 0
            ray = torch.where(over, direction, 0.0).view(-1, 3)
            origin = self.tracer.above(point, normal)[:, None].expand_as(direction).reshape(-1, 3)
            return torch.where(over, self._seen(origin, ray, light).view_as(direction), 0.0)
        above = torch.nonzero((direction @ normal[..., None])[..., 0].flatten() > 0)[:, 0]
        ray = direction.view(-1, 3)[above]
        origin = self.tracer.above(point, normal)[above // direction.shape[1]]
        radiance = self._seen(origin.contiguous(), ray.contiguous(), light)
        return torch.zeros(direction.numel() // 3, 3).index_copy(0, above, radiance).view_as(direction)

    def _seen(self, origin: torch.Tensor, ray: torch.Tensor, light: torch.Tensor) -> torch.Tensor:
        """(R, 3) V L + indirect along rays (R, 3)."""
        free, indirect = self.tracer.look(origin, ray)
        return lookup(light, ray) * free[:, None] + (indirect if self.settings.indirect else 0.0)

    def _smoothness(self) -> torch.Tensor:
        """Differences of materials between neighbours of like albedo."""
        pick = torch.randperm(len(self._likeness), generator=self.generator)[:SMOOTHED].to(self._likeness.device)
        materials, around = self.optimizer.gaussians.materials(), self._neighbours[pick]
        # gather, not [around]: the gradient of an index adds up in whatever order the threads come.
        others = materials.gather(1, around.reshape(1, -1).expand(len(materials), -1)).view(-1, *around.shape)
        jump = (materials[:, pick, None] - others).abs() * self._likeness[pick]
        albedo, roughness, metallic = jump.mean((1, 2)).split([3, 1, 1])
        s = self.settings
        return s.albedo_smoothness * albedo.mean() + s.roughness_smoothness * roughness[0] + s.metallic_smoothness * metallic[0]

    def _white_balance(self, light: torch.Tensor) -> torch.Tensor:
        """How coloured the light is on the whole."""
        mean = light.mean((0, 1))
        return self.settings.white_balance * (mean - mean.mean()).abs().mean()


def is_metal(gaussians: Gaussians) -> bool:
    """True where most of the surfels are metal."""
    return float(gaussians.materials()[METALLIC].mean()) > MOSTLY_METAL


def facing_side(gaussians: Gaussians, pool: PixelPool) -> torch.Tensor:
    """(N,) +1 or -1, by which normals are multiplied to look at those who see them."""
    index, weight, start = (torch.as_tensor(a).cpu() for a in (pool.lists.index, pool.lists.weight, pool.lists.start))
    ray = torch.repeat_interleave(torch.arange(pool.count), start.diff())
    cosine = (gaussians.normals().detach().cpu()[:, index.long()] * pool.view.cpu()[ray].T).sum(0) * weight
    total = np.bincount(index.numpy(), cosine.numpy(), gaussians.count)
    return torch.from_numpy(np.where(total < 0, -1.0, 1.0).astype(np.float32)).to(pool.view.device)


def likeness(gaussians: Gaussians) -> tuple[torch.Tensor, torch.Tensor]:
    """The nearest Gaussians of each, (N, K), and how alike their albedo is, (N, K) in 0..1."""
    position, albedo = gaussians.position.detach().T.cpu().numpy(), gaussians.materials().detach()[:3].T
    _, nearest = KDTree(position).query(position, k=NEIGHBOURS + 1)
    index = torch.from_numpy(np.asarray(nearest)[:, 1:]).to(albedo.device)
    return index, torch.exp(-LIKE * (albedo[:, None] - albedo[index]).abs().sum(-1))


def split(samples: int, shares: tuple[float, float, float]) -> tuple[int, int, int]:
    """So many samples in three parts, at least one each."""
    cosine, normal = (max(1, round(samples * share)) for share in shares[:2])
    return cosine, normal, max(1, samples - cosine - normal)


def variation(light: torch.Tensor) -> torch.Tensor:
    """Mean squared difference of neighbours of a log light map."""
    return (light - torch.roll(light, 1, 1)).square().mean() + (light[1:] - light[:-1]).square().mean()
