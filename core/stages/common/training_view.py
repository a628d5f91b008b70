# SPDX-License-Identifier: GPL-3.0-or-later
"""Training views: images prepared for the loss."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import torch

from ...scene.camera import Camera
from ...scene.dataset import View
from .losses import camera_rays

MARGIN = 12  # pixels around the object: SSIM's window reaches 5 pixels, and what is rendered beyond the mask's edge must count
SATURATED = 0.996  # encoded value from which a pixel is a lower bound of the radiance


@dataclass(frozen=True, eq=False)
class TrainingView:
    """Camera with the image that it should render.

    Attributes:
        camera: pinhole camera.
        image: (3, H, W) sRGB-encoded, on black where there is a mask.
        alpha: (H, W), or None without a mask.
        saturated: (3, H, W) bool, values that are lower bounds.
        rays: (3, H, W) in camera axes (z = 1).
        world_rays: (3, H, W), the same in world axes.
        rotation: (3, 3) world to camera (OpenCV axes).
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
    pixel_fraction: float = 1.0
    light_rotation: torch.Tensor | None = None

    def to(self, device: torch.device) -> TrainingView:
        """Return the view with its tensors on a device."""
        return replace(self, **{f.name: v.to(device) for f in fields(self) if isinstance(v := getattr(self, f.name), torch.Tensor)})

    def bounded(self, rendered: torch.Tensor) -> torch.Tensor:
        """Clip a rendered image (3, H, W) at saturated pixels: a clipped highlight is a lower bound, not a value."""
        limit = 1.0 if self.alpha is None else self.alpha
        return torch.where(self.saturated, torch.minimum(rendered, rendered.new_ones(()) * limit), rendered)


def make_training_view(view: View, reduction: int = 1, crop: bool = False) -> TrainingView:
    """Prepare a view for the loss.

    Args:
        view: image with its camera and mask.
        reduction: the image is averaged over reduction x reduction pixels; a remainder at the border is cut off.
        crop: crop to the object's box in the mask, with a margin, as everything around is black.
    """
    colour = torch.from_numpy(view.colour).permute(2, 0, 1).clamp(0, 1)
    alpha = None if view.alpha is None else torch.from_numpy(view.alpha)
    full = colour if alpha is None else colour * alpha
    saturated = (colour >= SATURATED) & (torch.ones(()) if alpha is None else alpha > 0.5).bool()
    camera = view.camera
    if reduction > 1:
        height, width = camera.height // reduction, camera.width // reduction
        average = lambda t: torch.nn.functional.avg_pool2d(t, reduction)[..., :height, :width].contiguous()  # noqa: E731
        full, saturated = average(full), average(saturated.float()) > 0.5
        alpha = None if alpha is None else average(alpha[None])[0]
        camera = cropped(camera, 0, 0, width * reduction, height * reduction).resized(width, height)
    fraction = 1.0
    if crop and alpha is not None:
        rows, columns = object_box(alpha)
        full, saturated, alpha = (t[..., rows, columns].contiguous() for t in (full, saturated, alpha))
        fraction = alpha.numel() / (camera.width * camera.height)
        camera = cropped(camera, columns.start, rows.start, columns.stop - columns.start, rows.stop - rows.start)
    rays, rotation = camera_rays(camera), torch.as_tensor(camera.world_to_cv[:3, :3], dtype=torch.float32)
    world_rays = torch.einsum("ji,jhw->ihw", rotation, rays)
    turned = None if view.light_rotation is None else torch.as_tensor(view.light_rotation, dtype=torch.float32)
    return TrainingView(camera, full.contiguous(), alpha, saturated, rays, world_rays, rotation, fraction, turned)


def object_box(alpha: torch.Tensor) -> tuple[slice, slice]:
    """Return rows and columns of the smallest box around all non-zero pixels of a mask (H, W), with MARGIN; all where it is empty."""
    box = []
    for axis in (1, 0):
        filled = torch.nonzero(alpha.amax(axis) > 0)[:, 0]
        length = alpha.shape[1 - axis]
        box.append(slice(max(0, int(filled[0]) - MARGIN), min(length, int(filled[-1]) + 1 + MARGIN)) if len(filled) else slice(0, length))
    return box[0], box[1]


def cropped(camera: Camera, x: int, y: int, width: int, height: int) -> Camera:
    """Return the camera of a part of its image.

    Args:
        camera: camera of the whole image.
        x: first column of the part, pixels.
        y: first row of the part, pixels.
        width: of the part, pixels.
        height: of the part, pixels.
    """
    return Camera(width, height, camera.fx, camera.fy, camera.cx - x, camera.cy - y, camera.to_world)
