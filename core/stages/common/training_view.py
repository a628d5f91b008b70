# SPDX-License-Identifier: GPL-3.0-or-later
"""A photograph prepared for the loss."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import torch

from ...scene.camera import Camera
from ...scene.dataset import View
from .losses import camera_rays

MARGIN = 12  # pixels around the object: SSIM looks 5 away, and what spills over a mask's edge has to be seen
SATURATED = 0.996  # encoded value from which a pixel says "at least this bright"


@dataclass(frozen=True, eq=False)
class TrainingView:
    """What one camera should see.

    Attributes:
        camera: pinhole camera.
        image: (3, H, W) encoded, on black where there is a mask.
        alpha: (H, W), or None without a mask.
        saturated: (3, H, W) bool, values that are lower bounds.
        rays: (3, H, W) in camera axes (z = 1); world_rays: the same in the world.
        rotation: (3, 3) world to camera (OpenCV axes).
        share: of the photograph's pixels; less than 1 where it was cut.
    """

    camera: Camera
    image: torch.Tensor
    alpha: torch.Tensor | None
    saturated: torch.Tensor
    rays: torch.Tensor
    world_rays: torch.Tensor
    rotation: torch.Tensor
    share: float = 1.0

    def to(self, device: torch.device) -> TrainingView:
        """The same on a device."""
        return replace(self, **{f.name: v.to(device) for f in fields(self) if isinstance(v := getattr(self, f.name), torch.Tensor)})

    def bounded(self, rendered: torch.Tensor) -> torch.Tensor:
        """`rendered` with what exceeds a saturated pixel cut off: a clipped highlight is a lower bound, not a value."""
        limit = 1.0 if self.alpha is None else self.alpha
        return torch.where(self.saturated, torch.minimum(rendered, rendered.new_ones(()) * limit), rendered)


def make_training_view(view: View, reduction: int = 1, cut: bool = False) -> TrainingView:
    """A view as a target, its image averaged over reduction x reduction pixels (a remainder at the border is cut off).

    `cut`: to where its mask shows the object, and a margin, as all around is black anyway.
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
    share = 1.0
    if cut and alpha is not None:
        rows, columns = object_box(alpha)
        full, saturated, alpha = (t[..., rows, columns].contiguous() for t in (full, saturated, alpha))
        share = alpha.numel() / (camera.width * camera.height)
        camera = cropped(camera, columns.start, rows.start, columns.stop - columns.start, rows.stop - rows.start)
    rays, rotation = camera_rays(camera), torch.as_tensor(camera.world_to_cv[:3, :3], dtype=torch.float32)
    return TrainingView(camera, full.contiguous(), alpha, saturated, rays, torch.einsum("ji,jhw->ihw", rotation, rays), rotation, share)


def object_box(alpha: torch.Tensor) -> tuple[slice, slice]:
    """Rows and columns of the smallest box around all of a mask (H, W) that is not 0, with MARGIN; all where the mask is empty."""
    box = []
    for axis in (1, 0):
        there = torch.nonzero(alpha.amax(axis) > 0)[:, 0]
        length = alpha.shape[1 - axis]
        box.append(slice(max(0, int(there[0]) - MARGIN), min(length, int(there[-1]) + 1 + MARGIN)) if len(there) else slice(0, length))
    return box[0], box[1]


def cropped(camera: Camera, x: int, y: int, width: int, height: int) -> Camera:
    """The camera of the part of the image that begins at column x, row y."""
    return Camera(width, height, camera.fx, camera.fy, camera.cx - x, camera.cy - y, camera.to_world)
