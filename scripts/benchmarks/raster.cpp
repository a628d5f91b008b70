// SPDX-License-Identifier: GPL-3.0-or-later
// The tile rasteriser's forward pass as a C++ programmer would write it at first, for comparison; see plain_raster.py.
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

namespace {
constexpr int TILE = 8;
}

extern "C" void raster_range(int64_t begin, int64_t end, const int64_t *start, const int32_t *entries, const float *record, int64_t record_width,
                             const float *feature, int64_t features, const int32_t *box, int64_t columns, float *picture, int64_t stride,
                             int64_t plane, float low_pass, float alpha_max, float stop, float w_min) {
  std::vector<float> sums((features + 1) * TILE * TILE);
  float left[TILE][TILE];
  for (int64_t tile = begin; tile < end; ++tile) {
    const int x0 = int(tile % columns) * TILE, y0 = int(tile / columns) * TILE;
    std::fill(sums.begin(), sums.end(), 0.0f);
    std::fill(&left[0][0], &left[0][0] + TILE * TILE, 1.0f);
    for (int64_t entry = start[tile]; entry < start[tile + 1]; ++entry) {
      if ((entry - start[tile]) % 8 == 7 && std::all_of(&left[0][0], &left[0][0] + TILE * TILE, [=](float t) { return t <= stop; })) break;
      const int64_t g = entries[entry];
      const float *r = record + g * record_width, *f = feature + g * features;
      const int first = std::max(box[4 * g + 1] - y0, 0), last = std::min(box[4 * g + 3] - y0, TILE - 1);
      for (int row = first; row <= last; ++row) {
        const float dy = float(y0 + row) + 0.5f - r[1];
        for (int column = 0; column < TILE; ++column) {
          const float dx = float(x0 + column) + 0.5f - r[0];
          const float w = 1.0f + dx * r[6] + dy * r[7];
          const bool ahead = w > w_min;
          const float iw = 1.0f / (ahead ? w : 1.0f);
          const float u = (dx * r[2] + dy * r[3]) * iw, v = (dx * r[4] + dy * r[5]) * iw;
          const float disk = ahead ? u * u + v * v : 1e9f, flat = low_pass * (dx * dx + dy * dy);
          const float rho = std::min(disk, flat), before = left[row][column];
          if (rho > r[10] || before <= stop) continue;
          const float weight = std::min(std::exp(-0.5f * rho) * r[9], alpha_max) * before;
          left[row][column] = before - weight;
          float *to = &sums[row * TILE + column];
          for (int64_t channel = 0; channel < features; ++channel) to[channel * TILE * TILE] += weight * f[channel];
          to[features * TILE * TILE] += weight * (disk > flat ? r[8] : iw * r[8]);
        }
      }
    }
    for (int row = 0; row < TILE; ++row)
      for (int column = 0; column < TILE; ++column) {
        const int64_t at = (y0 + row) * stride + x0 + column;
        const float rest = left[row][column];
        const bool opaque = rest <= stop;
        const float scale = opaque ? 1.0f / (1.0f - rest) : 1.0f;
        for (int64_t channel = 0; channel <= features; ++channel)
          picture[channel * plane + at] = sums[channel * TILE * TILE + row * TILE + column] * scale;
        picture[(features + 1) * plane + at] = opaque ? 1.0f : 1.0f - rest;
        picture[(features + 2) * plane + at] = rest;
      }
  }
}
