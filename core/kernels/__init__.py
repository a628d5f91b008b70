# SPDX-License-Identifier: GPL-3.0-or-later
"""Kernels: numerical core of the engine, each operation for the CPU and for NVIDIA GPUs, with a float64 reference for the tests.

The modules at the top are the public interface: they call the numba kernels in `cpu/` or the NVIDIA Warp kernels in `warp/`, as
`core/machine/backend.py` decides. `reference/` holds float64 PyTorch implementations, `constants.py` the numbers that all three share.

| operation | public interface | cpu/ | warp/ | reference |
| --- | --- | --- | --- | --- |
| rasterise 2D Gaussians | `rasterize.py` | `projection`, `raster`, ... | `rasterize`, `splats`, `raster` | `reference/rasterize.py` |
| trace 2D Gaussians | `trace.py` | `trace_autograd`, `bvh`, `trace`, ... | `trace`, `surfels`, `adjoint`, ... | `reference/trace.py` |
| L1 + D-SSIM loss | `photometric.py` | `photometric` | `photometric` | `reference/photometric.py` |
| normal consistency loss | `normal_consistency.py` | `normal_consistency` | none: PyTorch | `normal_consistency_reference` beside it |
| loss of a masked view | `image_loss.py` | `image_loss`, ... | none: PyTorch | `core/stages/common/image_loss.py` |
| step of Adam | `adam.py` | `adam` | none: PyTorch | `torch.optim.Adam` |
| deferred split-sum shading | `split_sum.py` | `split_sum` | none: PyTorch | `core/rendering/deferred.py` |
| BRDF-weighted sums over light samples | `reflection.py` | `reflection` | none: PyTorch | `core/shading/rendering_equation.py` |
| specular lobe over the texels of a light | `lobes.py` | `lobes` | `lobes`, `reflection` | `specular_lobe` in `core/shading/brdf.py` |
| Jacobian of views by the light's texels | `jacobian.py` | `jacobian` | none: PyTorch | `tests/core/kernels/test_jacobian.py` |

Behind "..." stand `binning` and `subpixels` (means over the rays of a pixel), `bvh_build`, `hit_lists` (on GPUs), `compositing` (weighted
sums over hits) and `adjoint` (gradients of the geometry).

Operations without a module at the top are called directly by the module named here:

| operation | caller | cpu/ | warp/ | reference |
| --- | --- | --- | --- | --- |
| draw sample directions | `core/shading/sampling.py` | `directions` | none: PyTorch | `_mixture_reference` in the caller |
| sum the light along secondary rays | `core/relight/indirect_light.py` | `gathering` | `light` | `tests/support/gather_reference.py` |
| draw and sum light samples | `core/relight/direct_light.py` | `light_samples` | `light` | `tests/core/relight/test_indirect_light.py` |
| count unoccluded directions | `core/relight/visibility_cache.py` | `light_samples` | none | none |
| cross-bilateral filter | `core/relight/denoise.py` | `bilateral` | `bilateral` | `tests/core/relight/test_denoise.py` |
| closest hits on triangles | `core/relight/mesh_tracer.py` | none: Embree | `mesh` | none |

Shared helpers: `cpu/jit.py` (compilation), `cpu/simd.py` and `cpu/reductions.py` (8-wide vectors), `cpu/frame.py` and
`cpu/harmonics.py`; `warp/runtime.py` (launches) and `warp/harmonics.py`; `reference/compositing.py` and `reference/rotations.py`.
"""
