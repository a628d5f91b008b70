# SPDX-License-Identifier: GPL-3.0-or-later
"""Model of the joint optimisation: from Gaussians and a light to the G-buffer of a view and to shaded pixels, differentiable throughout.

The G-buffer is rasterised; the rendering equation at a pixel takes visibility and indirect light from rays that are traced through the
same Gaussians, with gradients to their geometry and radiance (2DGRT). The kernels may be replaced by their float64 references.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import torch

from ....kernels.photometric import photometric_loss
from ....kernels.rasterize import COLOUR, rasterize
from ....kernels.trace import Tree, build_tree, trace
from ....rendering.deferred import ALPHA_FLOOR, SurfacePixels, composite, splat_radiance, surface_pixels
from ....rendering.secondary_rays import OFFSET, inside_bound, surroundings_surfels
from ....scene.camera import Camera
from ....scene.gaussians import Gaussians
from ....scene.reconstruction import Reconstruction
from ....scene.surroundings import Surroundings
from ....shading.environment_lookup import lookup
from ....shading.rendering_equation import reflect_light
from ....shading.sampling import LightDistribution, Samples, draw
from ...common.depth_distortion import depth_moments
from ...common.training_view import TrainingView

MIN_FOREGROUND_OPACITY = 0.5  # opacity above which a pixel is shaded
MAX_REFITS = 15  # of the tree before it is built anew (3DGRUT)
Reflect = Callable[..., tuple[torch.Tensor, torch.Tensor]]  # see `reflect_light`


class SurfelTracer:
    """Trace of Gaussians that may have moved since the last call; the tree is fitted to them again, and sometimes built anew."""

    def __init__(self) -> None:
        self._tree: Tree | None = None
        self._refits = 0

    def __call__(self, gaussians: Gaussians, origin: torch.Tensor, direction: torch.Tensor) -> torch.Tensor:
        """Return the sums (R, 8) of `trace` along rays, with all degrees of the radiance.

        Args:
            gaussians: N surfels.
            origin: (R, 3) world.
            direction: (R, 3) unit.
        """
        g = gaussians
        geometry = (g.position, g.quaternion, g.log_scale, g.opacity)
        if self._tree is None or self._refits >= MAX_REFITS:
            self._tree, self._refits = build_tree(*geometry, lasting=False), 0
        elif not self._tree.matches(*geometry):
            self._tree.refit(*geometry)
            self._refits += 1
        return trace(*geometry, g.sh, g.position.new_zeros(0, g.count), origin, direction, self._tree)


def rasterize_sums(gaussians: Gaussians, extra: torch.Tensor, camera: Camera, scene_radius: float, subpixels: int) -> torch.Tensor:
    """Return the sums (8 + E, H, W) of `rasterize`, with all degrees of the radiance.

    Args:
        gaussians: N surfels.
        extra: (E, N) further channels.
        camera: camera with H x W pixels.
        scene_radius: world units.
        subpixels: rays along each side of a pixel.
    """
    g = gaussians
    return rasterize(g.position, g.quaternion, g.log_scale, g.opacity, g.sh, extra, camera, scene_radius, 3, subpixels)[0]


@dataclass(frozen=True)
class Kernels:
    """Operations that exist as a float32 kernel and as a float64 reference.

    Attributes:
        rasterize: see `rasterize_sums`.
        trace: see `SurfelTracer`.
        photometric: see `photometric_loss`.
    """

    rasterize: Callable[[Gaussians, torch.Tensor, Camera, float, int], torch.Tensor] = rasterize_sums
    trace: Callable[[Gaussians, torch.Tensor, torch.Tensor], torch.Tensor] = field(default_factory=SurfelTracer)
    photometric: Callable[[torch.Tensor, torch.Tensor], torch.Tensor] = photometric_loss


@dataclass(frozen=True, eq=False)
class PixelPlan:
    """Random choices of a step, constants of its gradient.

    Attributes:
        pixels: (B,) flat indices of the shaded pixels.
        samples: N directions at each of them.
        above: (R,) flat indices of the samples above the horizon, among B N.
    """

    pixels: torch.Tensor
    samples: Samples
    above: torch.Tensor


@dataclass(frozen=True, eq=False)
class JointModel:
    """Constants of the model: everything that is not optimised.

    Attributes:
        radius: scene radius, world units.
        centre: (3,) of the scene, world.
        inside: (N,) bool, Gaussians that secondary rays meet; the others are a backdrop, part of the distant light.
        near: surfels of near surfaces, which secondary rays meet too; None for none.
        background: (h, w, 3) linear map behind the object, None where masks separate it.
        subpixels: rays along each side of a pixel.
        indirect: secondary rays bring the light that the object itself sends out.
        shadows: the object hides the light from itself.
        reflect: rendering equation; by default the diffuse lobe loses what the specular one reflects, as in relighting and in Blender.
        kernels: operations.
        distortion: the depth distortion's moments are rendered, too.
    """

    radius: float
    centre: torch.Tensor
    inside: torch.Tensor
    near: Gaussians | None
    background: torch.Tensor | None
    subpixels: int = 1
    indirect: bool = True
    shadows: bool = True
    reflect: Reflect = reflect_light
    kernels: Kernels = field(default_factory=Kernels)
    distortion: bool = False

    @classmethod
    def of(
        cls, start: Reconstruction, surroundings: Surroundings | None, subpixels: int, indirect: bool = True, shadows: bool = True
    ) -> JointModel:
        """Make the model of a reconstruction.

        Args:
            start: Gaussians whose SH hold all radiance.
            surroundings: near surfaces, or None.
            subpixels: rays along each side of a pixel.
            indirect: see the attribute.
            shadows: see the attribute.
        """
        device = start.gaussians.position.device
        near = None if surroundings is None else surroundings_surfels(surroundings).to(device)
        centre = torch.tensor(start.bound.centre, dtype=torch.float32, device=device)
        return cls(start.bound.radius, centre, inside_bound(start), near, start.background, subpixels, indirect, shadows)

    def render(self, gaussians: Gaussians, view: TrainingView) -> torch.Tensor:
        """Return the sums of a view's G-buffer, not divided by opacity; see `rasterize`.

        Args:
            gaussians: N surfels.
            view: camera.

        Returns:
            (13, H, W) with the five materials as the extra channels; with `distortion` (15, H, W), `depth_moments` follow them.
        """
        extra = gaussians.materials()
        if self.distortion:
            extra = torch.cat([extra, depth_moments(gaussians, view.camera, self.centre, self.radius)])
        return self.kernels.rasterize(gaussians, extra, view.camera, self.radius, self.subpixels)

    def radiance_image(self, sums: torch.Tensor, view: TrainingView) -> torch.Tensor:
        """Return the sRGB-encoded image (3, H, W) of the Gaussians' own radiance, composited as the photograph is."""
        return self.composited(splat_radiance(sums), sums[-1], view)

    def composited(self, straight: torch.Tensor, alpha: torch.Tensor, view: TrainingView) -> torch.Tensor:
        """Composite and encode a radiance as the photograph is, bounded where the photograph is saturated.

        Args:
            straight: (3, H, W) linear, straight alpha.
            alpha: (H, W) opacity.
            view: training view with H x W pixels.
        """
        image = composite(straight, alpha, view.world_rays, self.background)
        return view.bounded(view.completed(image, straight, alpha))

    def foreground(self, sums: torch.Tensor, view: TrainingView) -> torch.Tensor:
        """Return the flat indices (P,) of pixels that show the object, those in the band of an uncertain mask left out."""
        alpha = sums[-1].detach()
        shown = alpha > MIN_FOREGROUND_OPACITY
        if view.band is not None:
            shown = shown & ~view.band
        if self.background is not None:  # the photographs show a backdrop, too
            eye = torch.as_tensor(view.camera.centre).to(alpha)
            depth = sums[-2].detach() / alpha.clamp_min(MIN_FOREGROUND_OPACITY)
            away = eye[:, None, None] + depth * view.world_rays - self.centre.to(alpha)[:, None, None]
            shown = shown & (away.norm(dim=0) <= self.radius)
        return torch.nonzero(shown.flatten())[:, 0]

    def surface(self, sums: torch.Tensor, view: TrainingView, pixels: torch.Tensor) -> tuple[SurfacePixels, torch.Tensor]:
        """Return surface points at pixels, their layers divided by opacity, and their positions (B, 3) at the expected depth.

        Args:
            sums: (13, H, W) of `render`.
            view: camera.
            pixels: (B,) flat indices.
        """
        few, rays = sums.flatten(1).index_select(1, pixels)[:, None], view.world_rays.flatten(1)[:, pixels]
        eye = torch.as_tensor(view.camera.centre).to(sums)
        point = eye + (few[-2, 0] / few[-1, 0].clamp_min(ALPHA_FLOOR) * rays).T
        return surface_pixels(few, rays[:, None], ALPHA_FLOOR, all_pixels=True), point

    def plan(
        self,
        sums: torch.Tensor,
        view: TrainingView,
        pixels: torch.Tensor,
        light: torch.Tensor,
        counts: tuple[int, int, int],
        generator: torch.Generator,
        method: str = "mis",
    ) -> PixelPlan:
        """Draw the light samples of pixels.

        Args:
            sums: (13, H, W) of `render`.
            view: camera.
            pixels: (B,) flat indices.
            light: (h, w, 3) linear light map.
            counts: cosine, visible-normal and light samples per pixel.
            generator: random generator of the draw.
            method: "mis" or "stratified".
        """
        with torch.no_grad():
            at, _ = self.surface(sums, view, pixels)
            samples = draw(at.view, at.normal, at.roughness, counts, LightDistribution(light), generator, method)
            above = torch.nonzero((samples.direction @ at.normal[..., None])[..., 0].flatten() > 0)[:, 0]
        return PixelPlan(pixels, samples, above)

    def shade(
        self, gaussians: Gaussians, light: torch.Tensor, sums: torch.Tensor, view: TrainingView, plan: PixelPlan
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Estimate the rendering equation at the pixels of a plan.

        Args:
            gaussians: N surfels, which the secondary rays meet.
            light: (h, w, 3) linear light map.
            sums: (13, H, W) of `render`.
            view: camera.
            plan: pixels and light samples.

        Returns:
            Linear radiance (B, 3), and the incoming radiance V L + L_ind (B, N, 3) of the samples, 0 below the horizon.
        """
        at, point = self.surface(sums, view, plan.pixels)
        origin = point + OFFSET * self.radius * at.normal
        direction = plan.samples.direction
        ray, pixel = direction.view(-1, 3)[plan.above].contiguous(), plan.above // direction.shape[1]
        radiance = lookup(light, ray)
        if self.shadows or self.indirect:
            # index_select: the gradient of indexing is summed in an order that depends on the threads.
            traced = self.kernels.trace(self._occluders(gaussians), origin.index_select(0, pixel), ray)
            radiance = radiance * (1 - traced[:, -1:]) if self.shadows else radiance
            radiance = radiance + traced[:, COLOUR] if self.indirect else radiance
        incoming = radiance.new_zeros(direction.numel() // 3, 3).index_copy(0, plan.above, radiance).view_as(direction)
        layers = (at.view, at.normal, at.albedo, at.roughness, at.metallic)
        diffuse, specular = self.reflect(*layers, plan.samples, incoming)
        return diffuse + specular, incoming

    def _occluders(self, gaussians: Gaussians) -> Gaussians:
        """Return the surfels that secondary rays meet; gradients flow to those of the object."""
        g, index = gaussians, None if bool(self.inside.all()) else torch.nonzero(self.inside)[:, 0]
        if index is not None:
            g = Gaussians(**{name: value.index_select(-1, index) for name, value in g.tensors().items()})
        if self.near is None:
            return g
        near = self.near.tensors()
        return Gaussians(**{name: torch.cat([value, near[name].to(value)], -1) for name, value in g.tensors().items()})


def at_pixels(view: TrainingView, pixels: torch.Tensor) -> TrainingView:
    """Return the pixels (B,) of a view, flat indices, as an image of 1 x B pixels."""

    def few(layer: torch.Tensor | None) -> torch.Tensor | None:
        """Return a layer (..., H, W) at the pixels, (..., 1, B)."""
        return None if layer is None else layer.flatten(-2)[..., pixels].unsqueeze(-2)

    names = ("image", "alpha", "saturated", "rays", "world_rays", "band", "background")
    return replace(view, **{name: few(getattr(view, name)) for name in names})
