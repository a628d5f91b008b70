# SPDX-License-Identifier: GPL-3.0-or-later
"""Training views: images prepared for the loss."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import torch

from ...io.srgb import decode_srgb, encode_srgb
from ...scene.camera import Camera
from ...scene.dataset import View
from .mask_band import find_mask_band

CROP_MARGIN = 12  # pixels around the object: SSIM's window reaches 5 pixels, and what is rendered beyond the mask's edge must count
BAND_WEIGHT = 0.7  # weight of the mask where it may be wrong, against 1 elsewhere; with less, surfels paint what lies beside the object
MIN_SATURATED = 0.996  # encoded value from which a pixel is a lower bound of the radiance


@dataclass(frozen=True, eq=False)
class TrainingView:
    """Camera with the image that it should render.

    Attributes:
        camera: pinhole camera.
        image: (3, H, W) sRGB-encoded; on black where there is a mask, but for its band.
        alpha: (H, W), or None without a mask.
        saturated: (3, H, W) bool, values that are lower bounds.
        rays: (3, H, W) in camera axes (z = 1).
        world_rays: (3, H, W), the same in world axes.
        rotation: (3, 3) world to camera (OpenCV axes).
        band: (H, W) bool, pixels at the mask's edge where it may be wrong (see `mask_band`); None where the mask is exact.
        background: (3, H, W) linear radiance beside the object in the band; None without.
        pixel_fraction: fraction of the image's pixels that are kept; below 1 where it was cropped.
        light_rotation: (3, 3) world to the frame of the light; None where the light stands still.
    """

    camera: Camera
    image: torch.Tensor
    alpha: torch.Tensor | None
    saturated: torch.Tensor
    rays: torch.Tensor
    world_rays: torch.Tensor
    rotation: torch.Tensor
    band: torch.Tensor | None = None
    background: torch.Tensor | None = None
    pixel_fraction: float = 1.0
    light_rotation: torch.Tensor | None = None

    def to(self, device: torch.device) -> TrainingView:
        """Return the view with its tensors on a device."""
        return replace(self, **{f.name: v.to(device) for f in fields(self) if isinstance(v := getattr(self, f.name), torch.Tensor)})

    @property
    def size(self) -> int:
        """Bytes of the view's tensors."""
        tensors = (getattr(self, f.name) for f in fields(self))
        return sum(t.numel() * t.element_size() for t in tensors if isinstance(t, torch.Tensor))

    def bounded(self, rendered: torch.Tensor) -> torch.Tensor:
        """Clip a rendered image (3, H, W) at saturated pixels: a clipped highlight is a lower bound, not a value."""
        limit = torch.ones(()) if self.alpha is None else self.alpha
        limit = limit if self.band is None else limit.masked_fill(self.band, 1.0)
        return torch.where(self.saturated, torch.minimum(rendered, rendered.new_ones(()) * limit), rendered)

    def completed(self, image: torch.Tensor, straight: torch.Tensor, alpha: torch.Tensor) -> torch.Tensor:
        """Composite a rendered image (3, H, W) over the photograph's background in the mask's band.

        Args:
            image: sRGB-encoded, as the rest of the photograph expects it.
            straight: (3, H, W) linear radiance with straight alpha.
            alpha: (H, W) opacity.
        """
        if self.band is None or self.background is None:
            return image
        return torch.where(self.band, encode_srgb(straight * alpha + self.background * (1 - alpha)), image)

    def mask_difference(self, alpha: torch.Tensor) -> torch.Tensor:
        """Return the mean absolute difference of a rendered opacity (H, W) from the mask, weighted by BAND_WEIGHT in its band."""
        assert self.alpha is not None
        difference = (alpha - self.alpha).abs()
        return (difference if self.band is None else torch.where(self.band, BAND_WEIGHT * difference, difference)).mean()


def make_training_view(view: View, reduction: int = 1, crop: bool = False) -> TrainingView:
    """Prepare a view for the loss.

    Args:
        view: image with its camera and mask.
        reduction: the image is averaged over reduction x reduction pixels; a remainder at the border is cut off.
        crop: crop to the object's box in the mask, with a margin, as everything around is black.
    """
    camera, layers = view.camera, _layers(view)
    if reduction > 1:
        height, width = camera.height // reduction, camera.width // reduction
        for name, layer in layers.items():
            average = torch.nn.functional.avg_pool2d(layer.float(), reduction)[..., :height, :width]
            layers[name] = average > 0.5 if layer.dtype == torch.bool else average
        camera = camera.cropped(0, 0, width * reduction, height * reduction).resized(width, height)
    fraction = 1.0
    if crop and "alpha" in layers:
        rows, columns = object_box(layers["alpha"][0])
        layers = {name: layer[..., rows, columns] for name, layer in layers.items()}
        fraction = layers["alpha"].numel() / (camera.width * camera.height)
        camera = camera.cropped(columns.start, rows.start, columns.stop - columns.start, rows.stop - rows.start)
    layers = {name: layer.contiguous() for name, layer in layers.items()}
    alpha, band = (layers[name][0] if name in layers else None for name in ("alpha", "band"))
    rays, rotation = camera_rays(camera), torch.as_tensor(camera.world_to_cv[:3, :3], dtype=torch.float32)
    geometry = (rays, torch.einsum("ji,jhw->ihw", rotation, rays), rotation)
    turned = None if view.light_rotation is None else torch.as_tensor(view.light_rotation, dtype=torch.float32)
    more = (band, layers.get("background"), fraction, turned)
    return TrainingView(camera, layers["image"], alpha, layers["saturated"], *geometry, *more)


def _layers(view: View) -> dict[str, torch.Tensor]:
    """Return the image layers (C, H, W) of a view that `TrainingView` describes; those that it does not have are missing."""
    colour = torch.from_numpy(view.colour).permute(2, 0, 1).clamp(0, 1)
    if view.alpha is None:
        return {"image": colour, "saturated": colour >= MIN_SATURATED}
    alpha, band = torch.from_numpy(view.alpha)[None], find_mask_band(view)
    if band is None:
        return {"image": colour * alpha, "saturated": (colour >= MIN_SATURATED) & (alpha > 0.5), "alpha": alpha}
    pixels = torch.from_numpy(band.pixels)[None]
    return {
        "image": torch.where(pixels, colour, colour * alpha),
        "saturated": (colour >= MIN_SATURATED) & (pixels | (alpha > 0.5)),
        "alpha": alpha,
        "band": pixels,
        "background": torch.from_numpy(band.background).permute(2, 0, 1),
    }


def object_box(alpha: torch.Tensor) -> tuple[slice, slice]:
    """Return rows and columns of the smallest box around all non-zero pixels of a mask (H, W), with CROP_MARGIN; all where it is empty."""
    box = []
    for axis in (1, 0):
        filled = torch.nonzero(alpha.amax(axis) > 0)[:, 0]
        length = alpha.shape[1 - axis]
        begin, end = (int(filled[0]) - CROP_MARGIN, int(filled[-1]) + 1 + CROP_MARGIN) if len(filled) else (0, length)
        box.append(slice(max(0, begin), min(length, end)))
    return box[0], box[1]


def border_radiance(views: Sequence[TrainingView]) -> torch.Tensor:
    """Return the (3,) median linear colour of the outermost pixels of all images, the initial radiance of the background."""
    everything = slice(None)
    sides = ((0, everything), (-1, everything), (everything, 0), (everything, -1))
    edges = [view.image[:, rows, columns] for view in views for rows, columns in sides]
    return decode_srgb(torch.cat(edges, 1).median(1).values).clamp_min(1e-3)


def camera_rays(camera: Camera) -> torch.Tensor:
    """Return (3, H, W) float32 rays through the pixel centres in OpenCV's camera axes with z = 1: planar depth times ray is the point."""
    x = (torch.arange(camera.width) + 0.5 - camera.cx) / camera.fx
    y = (torch.arange(camera.height) + 0.5 - camera.cy) / camera.fy
    y, x = torch.meshgrid(y, x, indexing="ij")
    return torch.stack([x, y, torch.ones_like(x)]).float()
