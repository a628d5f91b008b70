# SPDX-License-Identifier: GPL-3.0-or-later
"""Our BRDF as a Mitsuba plugin, so that both renderers solve the same equation; imported once a variant is set.

Mitsuba's own `principled` differs: Disney's diffuse lobe, Smith's term without height correlation.
"""

# pyright: reportMissingImports=false, reportAttributeAccessIssue=false, reportCallIssue=false, reportArgumentType=false
# (Mitsuba is optional, and its types depend on the variant)

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
from irgspp.core.kernels.constants import DIELECTRIC_F0, FRESNEL

NAME = "metallic_roughness"
ROUGHNESS_FLOOR = 0.05
COSINE_FLOOR = 1e-3  # of n.v: with smooth normals a visible point may look away


class MetallicRoughness(mi.BSDF):
    """Microfacet BRDF f = (1 - m) a / pi (1 - E_s) + F D V.

    GGX, height-correlated Smith, Fresnel of a dielectric (`constants.FRESNEL`), alpha = roughness^2, F0 = 0.04 (1 - m) + m a. Textures
    `base_color`, `roughness`, `metallic`; `body` holds 1 - E_s over n.v (columns) and roughness (rows), 0 to 1 inclusive. Both sides of a
    face reflect alike. Directions are drawn by visible normals or by the cosine, in the ratio of the lobes' colours.
    """

    body = np.ones((2, 2), np.float32)

    def __init__(self, props: mi.Properties) -> None:
        mi.BSDF.__init__(self, props)
        self.base_color, self.roughness, self.metallic = (props[name] for name in ("base_color", "roughness", "metallic"))
        self.body_fraction = mi.Texture2f(mi.TensorXf(self.body[..., None]), wrap_mode=dr.WrapMode.Clamp)
        lobe = mi.BSDFFlags.DiffuseReflection | mi.BSDFFlags.GlossyReflection | mi.BSDFFlags.FrontSide | mi.BSDFFlags.BackSide
        self.m_components = [lobe]
        self.m_flags = lobe

    def traverse(self, callback: mi.TraversalCallback) -> None:
        """Register the textures as differentiable parameters."""
        for name in ("base_color", "roughness", "metallic"):
            callback.put(name, getattr(self, name), mi.ParamFlags.Differentiable)

    def sample(self, ctx, si, sample1, sample2, active=True):
        """Draw a direction (Mitsuba's interface of a BSDF).

        Args:
            ctx: context of the BSDF, unused.
            si: surface interactions.
            sample1: random number that chooses the lobe, 0..1.
            sample2: random point that chooses the direction, (2,) in 0..1.
            active: mask of the lanes.

        Returns:
            The sample with its density, and f cos / density, (3,).
        """
        side, view = self._view(si)
        material = self._material(si, active)
        by_lobe = self._lobe_fraction(view, material)
        distribution = _distribution(material)
        half, _ = distribution.sample(view, sample2)
        mirrored = dr.fma(half, 2 * dr.dot(view, half), -view)
        light = dr.select(sample1 < by_lobe, mirrored, mi.warp.square_to_cosine_hemisphere(sample2))
        value, density = self._evaluate(view, light, material)
        active &= density > 0
        drawn = dr.zeros(mi.BSDFSample3f)
        drawn.wo = mi.Vector3f(light.x, light.y, light.z * side)
        drawn.pdf, drawn.eta = dr.select(active, density, 0), 1.0
        drawn.sampled_type, drawn.sampled_component = mi.UInt32(int(mi.BSDFFlags.GlossyReflection)), mi.UInt32(0)
        return drawn, dr.select(active, value / density, 0)

    def eval(self, ctx, si, wo, active=True):
        """Return f cos, (3,).

        Args:
            ctx: context of the BSDF, unused.
            si: surface interactions.
            wo: outgoing directions in the local frame, (3,).
            active: mask of the lanes.
        """
        return self.eval_pdf(ctx, si, wo, active)[0]

    def pdf(self, ctx, si, wo, active=True):
        """Return the density of `sample` per steradian.

        Args:
            ctx: context of the BSDF, unused.
            si: surface interactions.
            wo: outgoing directions in the local frame, (3,).
            active: mask of the lanes.
        """
        return self.eval_pdf(ctx, si, wo, active)[1]

    def eval_pdf(self, ctx, si, wo, active=True):
        """Return f cos, (3,), and the density of `sample` per steradian.

        Args:
            ctx: context of the BSDF, unused.
            si: surface interactions.
            wo: outgoing directions in the local frame, (3,).
            active: mask of the lanes.
        """
        side, view = self._view(si)
        value, density = self._evaluate(view, mi.Vector3f(wo.x, wo.y, wo.z * side), self._material(si, active))
        return dr.select(active, value, 0), dr.select(active, density, 0)

    def to_string(self) -> str:
        """Return the plugin's name, as Mitsuba prints it."""
        return "MetallicRoughness[]"

    @staticmethod
    def _view(si):
        """Return the visible side (1 or -1, by the face's own normal), and the direction to the eye with that side up."""
        side = dr.select(dr.dot(si.n, si.to_world(si.wi)) < 0, -1.0, 1.0)
        z = dr.maximum(si.wi.z * side, COSINE_FLOOR)
        return side, dr.normalize(mi.Vector3f(si.wi.x, si.wi.y, z))

    def _material(self, si, active):
        """Return base colour, roughness and metallic at the interactions."""
        return self.base_color.eval(si, active), self.roughness.eval_1(si, active), self.metallic.eval_1(si, active)

    @staticmethod
    def _lobe_fraction(view, material):
        """Return the fraction of samples that is drawn by visible normals."""
        base, _, metallic = (dr.detach(value) for value in material)
        specular = dr.mean(_fresnel(view.z, base, metallic))
        return specular / (specular + (1 - metallic) * dr.mean(base) + 1e-4)

    def _evaluate(self, view, light, material):
        """Return f cos and the density of `sample`, 0 below the horizon."""
        base, roughness, metallic = material
        half = dr.normalize(view + light)
        distribution = _distribution(material)
        normals = distribution.eval(half)
        alpha2 = dr.square(distribution.alpha())
        masked = light.z * dr.sqrt(dr.square(view.z) * (1 - alpha2) + alpha2)
        shadowed = view.z * dr.sqrt(dr.square(light.z) * (1 - alpha2) + alpha2)
        specular = _fresnel(dr.dot(view, half), base, metallic) * (normals * 0.5 / dr.maximum(masked + shadowed, 1e-7))
        size = self.body.shape[0]
        at = (mi.Point2f(view.z, roughness) * (size - 1) + 0.5) / size
        diffuse = base * ((1 - metallic) * self.body_fraction.eval(at)[0] * dr.inv_pi)
        by_lobe = self._lobe_fraction(view, material)
        drawn = distribution.pdf(view, half) / (4 * dr.maximum(dr.dot(light, half), 1e-7))
        density = dr.lerp(mi.warp.square_to_cosine_hemisphere_pdf(light), drawn, by_lobe)
        above = light.z > 0
        return dr.select(above, (diffuse + specular) * light.z, 0), dr.select(above, dr.detach(density), 0)


def _fresnel(cosine, base, metallic):
    """Return the Fresnel term, F0 + (1 - F0) w."""
    f0, x = DIELECTRIC_F0 * (1 - metallic) + metallic * base, dr.clip(1 - cosine, 0, 1)
    polynomial = 0.0
    for factor in reversed(FRESNEL):
        polynomial = polynomial * x + factor
    return f0 + (1 - f0) * (x * x * x * polynomial)


def _distribution(material):
    """Return the GGX distribution of a material."""
    roughness = dr.maximum(material[1], ROUGHNESS_FLOOR)
    return mi.MicrofacetDistribution(mi.MicrofacetType.GGX, dr.square(roughness), sample_visible=True)


def register(body: np.ndarray) -> None:
    """Register the plugin under NAME.

    Args:
        body: table of 1 - E_s, (N, N), see MetallicRoughness.
    """
    MetallicRoughness.body = np.ascontiguousarray(body, np.float32)
    mi.register_bsdf(NAME, MetallicRoughness)
