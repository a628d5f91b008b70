# SPDX-License-Identifier: GPL-3.0-or-later
"""Constants that the CPU kernels, the GPU kernels and the float64 references share, so that all three compute the same model.

Those of the spherical harmonics are in `core/scene/spherical_harmonics.py`.

Sources: 2DGS (Huang 2024) for the splats, 3DGS (Kerbl 2023) for ALPHA_MIN, Wang 2004 for SSIM, COLMAP (Schoenberger 2016) for the
bilateral NCC of stereo.
"""

import numpy as np

# --- model of a 2D Gaussian (surfel)
ALPHA_MIN = 1 / 255  # hits and splats of lower alpha are ignored
ALPHA_MAX = 0.99
TRANSMITTANCE_MIN = 0.02  # at or below this a pixel or ray counts as opaque, and compositing stops
LOG_SCALE_MIN = -30.0  # smaller log scales are clamped to this, so that 1 / scale^2 stays finite
# Cosine of ray and normal from which a surfel is seen from behind, so that its normal is flipped. From 0, opposite normals would meet at
# the object's outline, where surfels just beyond the horizon show, and cancel.
BEHIND = 0.3
SCALE_RANGE = (1e-15, 1e15)  # scales outside are treated as degenerate or NaN (fast-math may remove math.isfinite from a kernel)

# --- rasteriser
TILE = 8  # pixels along a side of a tile: one vector per row
NEAR = 0.01  # depth of the near plane, as a fraction of the scene's radius
LOW_PASS = 32.0  # rho of the screen-space filter per squared pixel (2DGS: 1 / 0.707^2)
COSINE_MIN = 1e-3  # lowest |cosine| of view direction and normal: surfels seen more edge-on are drawn by the low-pass filter
HORIZON_MIN = 1e-4  # lowest w = c_z / depth of the plane intersection; below it the ray runs along the plane or meets it behind the eye
SPLAT_RECORD = 12  # floats of a splat: mx my A0 A1 B0 B1 C0 C1 c_z opacity cut-off(rho) unused
SPLAT_GRADIENTS = 10  # leading floats of a splat record that have a gradient

# --- ray tracer
GRAZING = 1e-8  # surfels with (normal . direction)^2 at or below this are missed
# Columns of a surfel record: centre (3), normal (3), t_u / s_u (3), t_v / s_v (3), opacity, largest rho, and the two scales.
NORMAL, AXIS_U, AXIS_V, OPACITY, CUT, SCALE_U, SCALE_V, SURFEL_RECORD = 3, 6, 9, 12, 13, 14, 15, 16
SURFEL_GRADIENTS = 13  # leading columns of a record that have a gradient; in a gradient slot they follow the feature row

# --- specular lobe
DIELECTRIC_F0 = 0.04  # reflectance at normal incidence of what is no metal
# Fresnel's equations for an index of refraction of 1.5, as Blender's Principled BSDF evaluates them: F = F0 + (1 - F0) w with
# w = x^3 (a0 + a1 x + ... + a4 x^4), x = 1 - v.h. The fit is within 0.3 % of F. Schlick's x^5 gives 16 to 23 % less from 45 to 60 degrees.
FRESNEL = (1.0665, -4.4816, 10.7476, -11.3225, 4.99)
COSINE_FLOOR = 1e-3  # of n.v: at silhouettes an averaged normal may point away from the camera
SHORTEST2 = 1e-7  # lower bound of |view + light direction|^2
LEAST_ALPHA = 0.05**2  # least alpha of sampled lobes, and of the principled BRDF's: roughness below 0.05 is treated as 0.05
IRGS_DENOMINATOR = (1e-6, 4 * np.pi)  # bounds of the denominator of IRGS' specular lobe, which cap lobes of a roughness below 0.12
IRGS_FRESNEL = (-5.55473, -6.98316)  # Schlick's (1 - v.h)^5 as 2^((a v.h + b) v.h) (Karis 2013, "Real Shading in Unreal Engine 4")
# A traced direction stands for its stratum, a part of a texel of the light. The lobe is averaged over PER_STRATUM directions of the stratum
# where sin^2 of normal and half vector + alpha^2 is below NARROW times the solid angle; elsewhere it hardly varies from end to end.
PER_STRATUM, NARROW = 16, 8.0

# --- normal consistency
DEPTH_FLOOR = 1e-3  # smallest opacity that sums of depths are divided by

# --- SSIM: 11 x 11 Gaussian window of sigma 1.5
SSIM_RADIUS = 5
SSIM_WEIGHT = 0.2  # of D-SSIM against L1 (3DGS)
_taps = np.exp(-0.5 * (np.arange(-SSIM_RADIUS, SSIM_RADIUS + 1) / 1.5) ** 2)
SSIM_TAPS = (_taps / _taps.sum()).astype(np.float32)
SSIM_C1, SSIM_C2 = np.float32(0.01**2), np.float32(0.03**2)

# --- matching cost of stereo: bilateral NCC of patches
PATCH_REACH = 2  # samples to each side of the patch's middle
PATCH_SPACING = 2  # pixels between samples
PATCH_SAMPLES = (2 * PATCH_REACH + 1) ** 2
WORST_COST = np.float32(2)  # 1 - NCC of opposite patches; also of patches that cannot be compared
FLAT_VARIANCE = np.float32(5e-6)  # variance of grey values below which a patch has no texture; that of rounding to 8 bits is 1.3e-6
BRIGHTNESS_RANGE = np.float32(0.08)  # difference of two patches' mean grey values at which the cost of brightness is largest
WEAK_VARIANCE = np.float32(
    5e-5
)  # variance of a patch at which the cost of brightness is halved: gloss misleads it, and texture tells depth
WEIGHT_CUT = np.float32(2.5)  # grey differences in sigmas from which a sample has weight 0: patches then stop at silhouettes
WARPED_AREA = (np.float32(0.1), np.float32(8))  # range of pixels in the source for one pixel; outside, sampling loses the texture
WARPED_REACH = np.float32(25)  # pixels; largest distance of a sample from the middle of the warped patch
LARGEST_REPROJECTION = np.float32(3)  # pixels; errors above it, and pixels without depth, count as this much
