# SPDX-License-Identifier: GPL-3.0-or-later
"""Refinement: stochastic gradient descent on materials, normals and light by the rendering equation at single pixels (as IRGS).

Each step shades few pixels with many light samples: the absolute error of a noisy estimate is biased, so that noise costs more than
fewer pixels do. Held-back views judge the result: a refinement that does not improve them is discarded.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import torch

from ....io.srgb import encode_srgb
from ....machine.backend import by_warp, random_generator
from ....rendering.secondary_rays import SecondaryTracer
from ....scene.camera import Camera
from ....scene.gaussians import Gaussians
from ....scene.reconstruction import Reconstruction
from ....settings.schema import SecondStageSettings
from ....shading.environment_lookup import from_light_frame, lookup, solid_angles, to_light_frame
from ....shading.rendering_equation import reflect_light
from ....shading.sampling import LightDistribution, Samples, draw
from ....surface.normal_images import SURFACE_WEIGHT
from ...common.finite_check import check_due, require_finite
from ...common.light_map import light_variation
from ...common.nearest_neighbours import nearest_neighbours
from ...common.optimizer import GaussianOptimizer, Rate
from ..held_back import held_back
from ..metal import METALLIC_THRESHOLD, is_all_metal
from .pixel_gbuffer import CachedHits, RasterizedViews
from .pixel_pool import PixelPool, facing_side

TEST_PIXELS, TEST_SAMPLES = 3000, (16, 32, 16)  # pixels and light samples per pixel of a test
QUADRATIC_ERROR = 1e-2  # encoded error below which the loss is quadratic
# Of cosine, visible-normal and light samples. With fewer light samples, the noise of a lamp biases the loss so that lamps darken.
SAMPLE_FRACTIONS = {"low-gloss": (0.25, 0.25, 0.5), "metal": (0.125, 0.5, 0.375)}
METAL_PIXEL_SHARE = 0.4  # further pixels, as a share, that show the metal parts of other objects: they know most of the light
MIN_METAL_PIXELS = 100  # pixels of metal in the pool for which this is done
METAL_LIGHT_RATE = 3.0  # factor of the light's learning rate for metals, all of whose radiance is reflected light
NEIGHBOURS = 4  # over which materials are smoothed
ALBEDO_DECAY = 8.0  # exponential decay of similarity with the difference in albedo
SMOOTHED_GAUSSIANS = 8192  # Gaussians compared with their neighbours in one step
MIN_RADIANCE = 1e-4  # least radiance of the light's texels, whose logarithm is optimised


class Refinement:
    """Gradient descent from one start, with its test on held-back views.

    Attributes:
        start: reconstruction at the start.
        pool: pixels of the training views.
        optimizer: Gaussians and light.
        light: (H, 2H, 3) log radiance.
        gbuffer: normals and materials of pixels.
        tested: pixels of the held-back views, or of all views where there are few.
        trained: pixels of the other views.
        counts: cosine, visible-normal and light samples per pixel.
        done: steps done.
    """

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
        """Prepare the optimisation.

        Args:
            reconstruction: start.
            pool: pixels of the training views.
            tracer: visibility and indirect light.
            settings: schedule, samples and weights.
            seed: seed of the random choice of pixels and samples.
            cameras: cameras of the pool's views, to rasterise whole views in each step, for comparison; empty: use the pool's hit lists.
        """
        self.start, self.pool, self.tracer, self.settings = reconstruction, pool, tracer, settings
        self.generator = random_generator(reconstruction.environment.device, seed)
        g = reconstruction.gaussians
        self.light = reconstruction.environment.clamp_min(MIN_RADIANCE).log().contiguous().requires_grad_()
        metal = is_all_metal(g)
        # A higher rate of the albedo pays with `albedo_smoothness` alone, which removes its noise.
        table = {"albedo": Rate(2e-2, 0.1), "roughness": Rate(1e-2, 0.1)}
        table["light"] = Rate(5e-3 * (METAL_LIGHT_RATE if metal else 1.0), 0.1)
        # The reflections in the first stage have determined a metal's normals; noisy gradients would only scatter them, and a metallic
        # slightly below 1 would explain their errors as diffuse light.
        if not metal:
            table |= {"metallic": Rate(1e-2, 0.1), "quaternion": Rate(settings.normal_rate, 0.1)}
        self.optimizer = GaussianOptimizer(g, table, {"light": self.light})
        radius = reconstruction.bound.radius
        self.gbuffer = RasterizedViews(pool, cameras, radius) if cameras else CachedHits(pool, facing_side(g, pool))
        held = held_back(pool.views).to(pool.number.device)[pool.number]
        tested = torch.nonzero(held if held.any() else ~held)[:, 0]
        self.tested = tested[_shuffled(len(tested), self.generator)[:TEST_PIXELS]]
        self.trained = torch.nonzero(~held)[:, 0]
        self._metal = self.trained[:0] if metal else self.trained[self._are_metal(self.trained)]
        self.counts = split_samples(settings.samples, SAMPLE_FRACTIONS["metal" if metal else "low-gloss"])
        self._neighbours, self._similarity = similar_neighbours(g)
        self.done = 0

    @property
    def device(self) -> torch.device:
        """Device of the tensors."""
        return self.light.device

    def run(self, on_step: Callable[[int], object] = lambda done: None) -> None:
        """Do all steps of the schedule.

        Args:
            on_step: called with the number of steps done; it may raise, and ends the run early by returning True.

        Raises:
            IrgsppError: a value is not finite.
        """
        while self.done < self.settings.iterations:
            self.step()
            if on_step(self.done):
                return

    def step(self) -> None:
        """Do one step of the schedule."""
        loss = self._loss()
        if check_due(loss, self.done + 1):
            if not loss.isfinite():
                self.optimizer.check_finite()  # names the parameter where it is one
            require_finite({"the second stage's loss": loss}, f"at iteration {self.done + 1}")
        loss.backward()
        self.optimizer.step(self.done / self.settings.iterations)
        self.done += 1

    def reschedule(self, iterations: int) -> None:
        """Continue with a schedule of another length in steps."""
        self.settings = replace(self.settings, iterations=iterations)

    def test(self) -> float:
        """Return the PSNR in dB of the shaded pixels of the held-back views without the noise of the samples, which are always the same."""
        generator = random_generator(self.device, 0)
        squared = torch.cat([self.errors(pixels, TEST_SAMPLES, generator)[0] for pixels in self.tested.split(1000)])
        return -10 * math.log10(max(float(squared.mean()), 1e-10))

    @torch.no_grad()
    def errors(self, pixels: torch.Tensor, counts: tuple[int, int, int], generator: torch.Generator) -> tuple[torch.Tensor, torch.Tensor]:
        """Compare pixels with the images by two independent estimates, whose noise does not count as an error.

        Args:
            pixels: (B,) indices in the pool.
            counts: cosine, visible-normal and light samples per pixel.
            generator: random generator of the samples.

        Returns:
            (B,) product of both encoded differences, mean over the colours: the squared error on average, negative where noise prevails;
            and (B,) irradiance / pi, mean over the colours.
        """
        light, differences, materials = self.light.detach().exp(), [], self._materials(pixels)
        for _ in range(2):
            view, normal, albedo, roughness, metallic, samples, incoming = self._lit(pixels, materials, counts, light, generator)
            diffuse, specular = reflect_light(view, normal, albedo, roughness, metallic, samples, incoming, conserving=True)
            differences.append(self._difference(diffuse + specular, pixels))
        white, none = torch.ones_like(albedo), torch.zeros_like(metallic)
        irradiance, _ = reflect_light(view, normal, white, roughness, none, samples, incoming, conserving=False)
        return (differences[0] * differences[1]).mean(1), irradiance.mean(1)

    def result(self) -> Reconstruction:
        """Return the current reconstruction."""
        g = self.optimizer.gaussians
        refined = self.start.relabelled(g.material.detach().clone(), self.light.detach().exp())
        return replace(refined, gaussians=replace(refined.gaussians, quaternion=g.quaternion.detach().clone()))

    @torch.no_grad()
    def _are_metal(self, pixels: torch.Tensor) -> torch.Tensor:
        """Return (B,) bool, True for pixels (B,) that show metal."""
        return torch.cat([self._materials(part)[3] > METALLIC_THRESHOLD for part in pixels.split(5000)])

    def _loss(self) -> torch.Tensor:
        """Compute the loss of one step: Charbonnier loss of encoded radiance, smoothness of materials and light, white balance."""
        light = self.light.exp()
        pixels = self.gbuffer.choose_pixels(self.trained, self.settings.pixels, self.generator)
        if len(self._metal) > MIN_METAL_PIXELS:
            further = self.gbuffer.choose_pixels(self._metal, round(METAL_PIXEL_SHARE * self.settings.pixels), self.generator)
            pixels = torch.cat([pixels, further])
        difference = self._difference(self._shade(pixels, self.counts, light, self.generator), pixels)
        loss = (difference.square() + QUADRATIC_ERROR**2).sqrt().mean()
        return loss + self._smoothness() + self.settings.light_smoothness * light_variation(self.light) + self._white_balance(light)

    def _difference(self, colour: torch.Tensor, pixels: torch.Tensor) -> torch.Tensor:
        """Return encoded differences (B, 3) from the image; at saturated pixels an excess counts as 0."""
        difference = encode_srgb(colour.clamp_min(1e-5)) - self.pool.colour[pixels]
        return torch.where(self.pool.saturated[pixels] & (difference > 0), 0.0, difference)

    def _shade(self, pixels: torch.Tensor, counts: tuple[int, int, int], light: torch.Tensor, generator: torch.Generator) -> torch.Tensor:
        """Estimate the linear radiance (B, 3) of pixels by the rendering equation, with `counts` samples of each strategy.

        A light that turns relative to the object is sampled and reflected in its own frame, that of the pixel's view.
        """
        diffuse, specular = reflect_light(*self._lit(pixels, self._materials(pixels), counts, light, generator), conserving=True)
        return diffuse + specular

    def _lit(
        self,
        pixels: torch.Tensor,
        materials: tuple[torch.Tensor, ...],
        counts: tuple[int, int, int],
        light: torch.Tensor,
        generator: torch.Generator,
    ) -> tuple[Any, ...]:
        """Return view, normal, albedo, roughness, metallic, light samples and incoming light of pixels, as `reflect_light` takes them."""
        normal, albedo, roughness, metallic = materials
        rotation = None if self.pool.rotations is None else self.pool.rotations[self.pool.number[pixels]]
        origin = self.tracer.above(self.pool.point[pixels], normal.detach())
        view, normal = to_light_frame(self.pool.view[pixels], rotation), to_light_frame(normal, rotation)
        distribution = LightDistribution(light.detach())
        samples = draw(view, normal.detach(), roughness.detach(), counts, distribution, generator, self.settings.sampling)
        return view, normal, albedo, roughness, metallic, samples, self._incoming(origin, normal.detach(), samples, light, rotation)

    def _materials(self, pixels: torch.Tensor) -> tuple[torch.Tensor, ...]:
        """Return normal (B, 3), albedo (B, 3), roughness and metallic (B,) of pixels."""
        at = self.gbuffer.sums(self.optimizer.gaussians, pixels)
        albedo, roughness, metallic = (at[:, 3:] / self.pool.opacity[pixels, None]).split([3, 1, 1], 1)
        normal = torch.nn.functional.normalize(at[:, :3], dim=1)
        if self.pool.surface_normal is not None:
            other = self.pool.surface_normal[pixels]
            mixed = torch.nn.functional.normalize((1 - SURFACE_WEIGHT) * normal + SURFACE_WEIGHT * other, dim=1)
            normal = torch.where(other.any(1, keepdim=True), mixed, normal)
        return normal, albedo, roughness[:, 0], metallic[:, 0]

    def _incoming(
        self, origin: torch.Tensor, normal: torch.Tensor, samples: Samples, light: torch.Tensor, rotation: torch.Tensor | None
    ) -> torch.Tensor:
        """Return the incoming radiance (B, N, 3) of samples, V L + indirect; 0 below the horizon.

        Normals and samples are in the frame of the light; `rotation` (B, 3, 3) leads there from the world, that of the origins (B, 3).
        """
        direction = samples.direction
        if by_warp(direction):  # all rays, those below with zero direction: the host would wait for their number
            facing = direction @ normal[..., None] > 0
            ray = torch.where(facing, direction, 0.0).view(-1, 3)
            turned = None if rotation is None else rotation.repeat_interleave(direction.shape[1], 0)
            starts = origin[:, None].expand_as(direction).reshape(-1, 3)
            return torch.where(facing, self._trace(starts, ray, light, turned).view_as(direction), 0.0)
        above = torch.nonzero((direction @ normal[..., None])[..., 0].flatten() > 0)[:, 0]
        ray, pixel = direction.view(-1, 3)[above], above // direction.shape[1]
        turned = None if rotation is None else rotation[pixel]
        radiance = self._trace(origin[pixel].contiguous(), ray.contiguous(), light, turned)
        return torch.zeros(direction.numel() // 3, 3).index_copy(0, above, radiance).view_as(direction)

    def _trace(self, origin: torch.Tensor, ray: torch.Tensor, light: torch.Tensor, rotation: torch.Tensor | None) -> torch.Tensor:
        """Return V L + indirect (R, 3) along rays (R, 3) in the frame of the light, to which `rotation` (R, 3, 3) leads from the world."""
        visible, indirect = self.tracer.look(origin, from_light_frame(ray, rotation).contiguous())
        return lookup(light, ray) * visible[:, None] + (indirect if self.settings.indirect else 0.0)

    def _smoothness(self) -> torch.Tensor:
        """Return the weighted mean difference of materials between neighbours of similar albedo."""
        pick = _shuffled(len(self._similarity), self.generator)[:SMOOTHED_GAUSSIANS]
        materials, around = self.optimizer.gaussians.materials(), self._neighbours[pick]
        # gather, not [around]: the gradient of indexing is summed in an order that depends on the threads.
        others = materials.gather(1, around.reshape(1, -1).expand(len(materials), -1)).view(-1, *around.shape)
        difference = (materials[:, pick, None] - others).abs() * self._similarity[pick]
        albedo, roughness, metallic = difference.mean((1, 2)).split([3, 1, 1])
        s = self.settings
        return s.albedo_smoothness * albedo.mean() + s.roughness_smoothness * roughness[0] + s.metallic_smoothness * metallic[0]

    def _white_balance(self, light: torch.Tensor) -> torch.Tensor:
        """Return the weighted deviation of the mean light (H, 2H, 3), over solid angle, from grey."""
        height, width = light.shape[:2]
        angles = solid_angles(height, width, device=light.device)
        mean = (light * angles[:, None, None]).sum((0, 1)) / (4 * math.pi)
        return self.settings.white_balance * (mean - mean.mean()).abs().mean()


def _shuffled(count: int, generator: torch.Generator) -> torch.Tensor:
    """Return the numbers below `count` in random order, on the generator's device: the host does not wait for it."""
    return torch.randperm(count, generator=generator, device=generator.device)


def similar_neighbours(gaussians: Gaussians) -> tuple[torch.Tensor, torch.Tensor]:
    """Return the nearest Gaussians of each, indices (N, K), and the similarity of their albedo, (N, K) in 0..1."""
    position, albedo = gaussians.position.T, gaussians.materials().detach()[:3].T
    index = nearest_neighbours(position, position, NEIGHBOURS + 1)[:, 1:]
    return index, torch.exp(-ALBEDO_DECAY * (albedo[:, None] - albedo[index]).abs().sum(-1))


def split_samples(samples: int, fractions: tuple[float, float, float]) -> tuple[int, int, int]:
    """Split a number of samples over the three sampling strategies, at least one each.

    Args:
        samples: number of samples.
        fractions: fractions of cosine, visible-normal and light samples; the last takes what remains.
    """
    cosine, normal = (max(1, round(samples * fraction)) for fraction in fractions[:2])
    return cosine, normal, max(1, samples - cosine - normal)
