# SPDX-License-Identifier: GPL-3.0-or-later
"""Evidence for the detail: photographs that it was not made from, compared with the new and the old texture.

What counts is the correlation of fine detail. The mean difference of colours would prefer a blurred texture to a sharp one as soon as
pose, mesh or shading are slightly wrong. Noise, or highlights of other photographs, correlate with nothing.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import cv2
import numpy as np

from ..surface.mesh_texels import MeshTexels
from .candidates import Candidates
from .texel_sampling import CODES

# Correlation with detail above that without, from which the detail is used: where the photographs are larger than the working resolution,
# and where they are not and the Gaussians saw all of it. There, gains of -.04 to .04 came with a loss of albedo on four captures, .09
# and .26 with a gain on a print.
MIN_CORRELATION_GAIN, CLEAR_CORRELATION_GAIN = 0.02, 0.06
MIN_CORRELATION = 0.15  # least correlation that is not chance
MIN_TEXELS = 500  # texels that the held-back photographs must show
# Relief that the Gaussians don't resolve is shaded alike in all photographs, so that held-back ones can't tell it from paint. Its log
# luminance varies by .05 on a carved face, with .2 of that in chromaticity; .4 and .5 on a print, .7 of it on a painted figure.
MIN_PAINT_CHROMATICITY = 0.35  # chromaticity over luminance from which fine detail is paint
MIN_PAINT_CONTRAST = 0.2  # standard deviation of log luminance from which it is paint also without colour
# `Reconstruction.relief` below which it is paint, too: the mesh has no relief that the photographs show. It is 1.0 on igea_relief, carved
# granite and plaster, .54 on concrete of weak grey texture without relief, .42 at most on eight other objects.
MAX_RELIEF = 0.75
ALBEDO_FLOOR = 0.02  # albedo added inside the logarithm
FINE_SIGMA = 1.5  # standard deviation of the high-pass filter, in pixels of the photographs on the surface
SIGMA_RANGE = 1.5, 16.0  # least and greatest standard deviation of that filter, texels


@dataclass
class Evidence:
    """Agreement of two textures with held-back photographs.

    Attributes:
        texels: texels of the textures.
        relief: how much of the fine variation of radiance is relief, 0..1; None where it is unknown.
        sums: (2, 3) sums of products of fine detail over the compared texels, for the new and the old texture: with the photograph, with
            itself, and the photograph with itself.
        squares: (2,) sums of squares of the new texture's fine detail over the compared texels: of log luminance, and of log chromaticity.
        compared: number of compared texels.
    """

    texels: MeshTexels
    relief: float | None = None
    sums: np.ndarray = field(default_factory=lambda: np.zeros((2, 3)))
    squares: np.ndarray = field(default_factory=lambda: np.zeros(2))
    compared: int = 0

    def add(self, held: Candidates, detailed: np.ndarray, plain: np.ndarray) -> None:
        """Compare with one photograph.

        Args:
            held: its samples, one candidate per texel.
            detailed: (P, 3) linear albedo with detail, 0 where no other photograph shows the texel.
            plain: (P, 3) linear albedo of the working solution.
        """
        known = np.flatnonzero((held.weight[:, 0] > 0) & (detailed.max(-1) > 0))
        if not len(known):
            return
        pixel = float(np.median(held.finest[known]) / np.median(self.texels.side[self.texels.face[known]]))
        sigma = float(np.clip(FINE_SIGMA * pixel, *SIGMA_RANGE))
        values = held.colour[known, 0, 1] / np.float32(CODES), detailed[known, 1], plain[known, 1]
        seen, new, old = (fine_detail(self.texels, known, np.log(np.clip(value, 0, 1) + ALBEDO_FLOOR), sigma) for value in values)
        for row, texture in enumerate((new, old)):
            self.sums[row] += (texture * seen).sum(), (texture * texture).sum(), (seen * seen).sum()
        logs = np.log(np.clip(detailed[known], 0, 1) + ALBEDO_FLOOR)
        red, blue = (fine_detail(self.texels, known, logs[:, k] - logs[:, 1], sigma) for k in (0, 2))
        green = fine_detail(self.texels, known, logs[:, 1], sigma)
        self.squares += (green * green).sum(), 0.5 * (red * red + blue * blue).sum()
        self.compared += len(known)

    @property
    def correlations(self) -> tuple[float, float]:
        """Correlation of the photographs' fine detail with that of the new and of the old texture."""
        new, old = (float(both / np.sqrt(max(own * seen, 1e-30))) for both, own, seen in self.sums)
        return new, old

    @property
    def painted(self) -> bool:
        """False where the fine detail may be the shading of relief: weak, and of hardly any colour, on a surface with relief."""
        if self.relief is not None and self.relief < MAX_RELIEF:
            return True
        luminance, chromaticity = np.sqrt(self.squares / max(self.compared, 1))
        return bool(luminance >= MIN_PAINT_CONTRAST or chromaticity >= MIN_PAINT_CHROMATICITY * luminance)

    def convincing(self, gain: float) -> bool:
        """Return True where the detail is paint, and explains photographs that it was not made from better than the working solution does.

        Args:
            gain: least difference of correlations.
        """
        new, old = self.correlations
        return self.compared >= MIN_TEXELS and new > max(old + gain, MIN_CORRELATION) and self.painted

    @property
    def reason(self) -> str:
        """Reason for the decision, in one line."""
        new, old = self.correlations
        agreement = (
            f"fine detail of held-back photographs has the correlation {new:.2f} with it, {old:.2f} with the texture of the Gaussians"
        )
        return agreement if self.painted else f"{agreement}; it has almost no colour and may be the shading of fine relief"


def fine_detail(texels: MeshTexels, known: np.ndarray, values: np.ndarray, sigma: float) -> np.ndarray:
    """Return values (K,) at texels without their low frequencies, by a Gaussian filter in the texture.

    Args:
        texels: all texels.
        known: (K,) indices of those with a value.
        values: (K,).
        sigma: standard deviation of the filter, texels.
    """
    images = np.zeros((texels.size * texels.size, 2), np.float32)
    index = texels.index[known]
    images[index, 0], images[index, 1] = values, 1
    smooth = cv2.GaussianBlur(images.reshape(texels.size, texels.size, 2), (0, 0), sigma).reshape(-1, 2)[index]
    return (values - smooth[:, 0] / np.maximum(smooth[:, 1], 1e-6)).astype(np.float64)
