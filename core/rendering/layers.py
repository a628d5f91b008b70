# SPDX-License-Identifier: GPL-3.0-or-later
"""Names of the image layers of a view, free of heavy imports: the command line checks its options by them."""

from __future__ import annotations

LAYERS = ("rgba", "albedo", "normal", "depth", "material", "radiance", "confidence")
