# SPDX-License-Identifier: GPL-3.0-or-later
"""The perceptual distance LPIPS, where its weights are on this machine."""

# pyright: reportMissingImports=false
# (the package lpips is an option)

from __future__ import annotations

import importlib.util
import logging
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch

from ..errors import InputError

NO_LPIPS = (
    "LPIPS is not given: neither the package lpips with its weights nor a TorchScript file (--lpips FILE) was there. "
    "Its weights can't be had without a download."
)


class Lpips:
    """Distance of two images.

    Args:
        name: what it is made of. distance: of two (1, 3, H, W) in -1..1, as one number in a tensor.
    """

    def __init__(self, name: str, distance: Callable[[torch.Tensor, torch.Tensor], torch.Tensor]) -> None:
        self.name, self._distance = name, distance

    def __call__(self, a: np.ndarray, b: np.ndarray) -> float:
        """Of (H, W, 3) images in 0..1; 0 where they are equal."""
        with torch.no_grad():
            return float(self._distance(*(torch.from_numpy(p.astype(np.float32)).permute(2, 0, 1)[None] * 2 - 1 for p in (a, b))))


def find_lpips(file: Path | None, network: str = "alex") -> Lpips | None:
    """From a TorchScript file, or else from the package lpips with that network (alex, vgg); None where there is neither.

    Raises InputError for a file that is none.
    """
    if file is not None:
        try:
            return Lpips(file.name, torch.jit.load(str(file), map_location="cpu").eval())
        except (RuntimeError, ValueError, OSError) as error:
            raise InputError(file, f"is no TorchScript module ({' '.join(str(error).split())[:80]})") from error
    if importlib.util.find_spec("lpips") is None:
        return None
    import lpips

    try:
        return Lpips(f"lpips, {network}", lpips.LPIPS(net=network, verbose=False).eval())
    except OSError as error:  # the package is there, its weights are not
        logging.getLogger(__name__).warning("lpips has no weights: %s", error)
        return None
