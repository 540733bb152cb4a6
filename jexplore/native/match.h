// Rounds of scan matching for programs in JAX, a call of JAX's typed FFI: `matching.rounds`, whose numbers it adds in
// single precision one after the other.

#pragma once

#include "plan.h"

namespace jexplore {
namespace {

using Reals = ffi::Buffer<ffi::F32, 1>;
using Vectors = ffi::Buffer<ffi::F32, 2>;

// The numbers that `matching.native_rounds` gives.
struct MatchTerms {
  float start[3], guess[3], known[6], centre[2], cell_m, gate_m, fine_gate_m, noise_m, isolated_m, huber, min_facing,
      settled_m, min_points, correlation;
};

struct MatchResult {
  float pose[3], matrix[6], partners, moves;
};

// `arrays.poses.wrapped`.
float Wrapped(float angle) {
  const float pi = static_cast<float>(M_PI), turn = 2 * pi, rest = std::fmod(angle + pi, turn);
  return (rest < 0 ? rest + turn : rest) - pi;
}

// `matching._inverse`: upper triangles, row by row.
void Invert(const float* a, float* out) {
  const float s0 = 1 / std::sqrt(a[0]), s1 = 1 / std::sqrt(a[3]), s2 = 1 / std::sqrt(a[5]);
  const float b01 = a[1] * s0 * s1, b02 = a[2] * s0 * s2, b12 = a[4] * s1 * s2;
  const float c00 = 1 - b12 * b12, c01 = b02 * b12 - b01, c02 = b01 * b12 - b02;
  const float per = 1 / std::max(c00 + b01 * c01 + b02 * c02, 1e-12f);
  out[0] = c00 * per * s0 * s0, out[1] = c01 * per * s0 * s1, out[2] = c02 * per * s0 * s2;
  out[3] = (1 - b02 * b02) * per * s1 * s1, out[4] = (b01 * b02 - b12) * per * s1 * s2;
  out[5] = (1 - b01 * b01) * per * s2 * s2;
}

struct Matcher {
  static constexpr int kNumberBits = 18, kNoPoint = INT32_MAX, kRounds = 20;  // as in points.py and matching.py
  static constexpr float kCoarse[] = {1.0f, 0.7f};
  static constexpr int kCoarseRounds = 2;

  const int32_t* near;
  int height, width, n_points, n_beams;
  const float *x, *y, *normal_x, *normal_y, *xy, *normal;
  const bool* valid;
  MatchTerms own;

  // `matching.sums`: matrix, vector, number of partners.
  void Sum(const float* pose, float gate_m, float* total) const {
    std::fill(total, total + 10, 0.0f);
    const float cos = std::cos(pose[2]), sin = std::sin(pose[2]), per = 1 / own.cell_m, gate2 = gate_m * gate_m;
    const float line_weight = 1 / (own.noise_m * own.noise_m), lone_weight = 1 / (own.isolated_m * own.isolated_m);
    for (int i = 0; i < n_beams; ++i) {
      if (!valid[i]) continue;
      const float arm_x = cos * xy[2 * i] - sin * xy[2 * i + 1], arm_y = sin * xy[2 * i] + cos * xy[2 * i + 1];
      const float at_x = arm_x + pose[0], at_y = arm_y + pose[1];
      const float row = (at_y - own.centre[1]) * per + 0.5f * height, col = (at_x - own.centre[0]) * per + 0.5f * width;
      // Compared as numbers: what is not finite has no cell.
      if (!(row > -1e6f && row < 1e6f && col > -1e6f && col < 1e6f)) continue;
      const int r = static_cast<int>(std::clamp(row, 0.0f, height - 1.0f));
      const int c = static_cast<int>(std::clamp(col, 0.0f, width - 1.0f));
      const int32_t found = near[r * width + c];
      if (found == kNoPoint) continue;
      const int at = std::min(found & ((1 << kNumberBits) - 1), n_points - 1);
      const float off_x = at_x - x[at], off_y = at_y - y[at], d2 = off_x * off_x + off_y * off_y;
      if (!(d2 < gate2)) continue;
      const float nx = normal_x[at], ny = normal_y[at], own_x = normal[2 * i], own_y = normal[2 * i + 1];
      const bool is_lined = nx != 0 || ny != 0;
      if (is_lined && (own_x != 0 || own_y != 0) &&
          !(nx * (cos * own_x - sin * own_y) + ny * (sin * own_x + cos * own_y) > own.min_facing))
        continue;
      const float across = nx * off_x + ny * off_y;
      const float size = is_lined ? std::fabs(across) / own.noise_m : std::sqrt(d2) / own.isolated_m;
      const float weight = 1 / (std::max(1.0f, size / own.huber) * own.correlation);
      total[9] += 1;
      if (is_lined) {
        const float line = weight * line_weight, turn = ny * arm_x - nx * arm_y, pull = line * across;
        total[0] += line * nx * nx, total[1] += line * nx * ny, total[2] += line * nx * turn;
        total[3] += line * ny * ny, total[4] += line * ny * turn, total[5] += line * turn * turn;
        total[6] += pull * nx, total[7] += pull * ny, total[8] += pull * turn;
      } else {
        const float lone = weight * lone_weight;
        total[0] += lone, total[2] -= lone * arm_y, total[3] += lone, total[4] += lone * arm_x;
        total[5] += lone * (arm_x * arm_x + arm_y * arm_y);
        total[6] += lone * off_x, total[7] += lone * off_y, total[8] += lone * (arm_x * off_y - arm_y * off_x);
      }
    }
  }

  MatchResult Rounds() const {
    MatchResult result{};
    std::copy(own.guess, own.guess + 3, result.pose);
    bool moves = true;
    for (int k = 0; moves && k < kRounds + kCoarseRounds; ++k) {
      const float gate_m = std::max(k < kCoarseRounds ? kCoarse[k] * own.gate_m : 0.0f, own.fine_gate_m);
      float total[10], inverse[6];
      Sum(result.pose, gate_m, total);
      std::copy(total, total + 6, result.matrix), result.partners = total[9];
      moves = k < kCoarseRounds;
      if (!(total[9] >= own.min_points)) continue;
      const float d[] = {result.pose[0] - own.start[0], result.pose[1] - own.start[1],
                         Wrapped(result.pose[2] - own.start[2])};
      const float* known = own.known;
      const float w[] = {total[6] + known[0] * d[0] + known[1] * d[1] + known[2] * d[2],
                         total[7] + known[1] * d[0] + known[3] * d[1] + known[4] * d[2],
                         total[8] + known[2] * d[0] + known[4] * d[1] + known[5] * d[2]};
      for (int j = 0; j < 6; ++j) total[j] += known[j];
      Invert(total, inverse);
      const float step[] = {inverse[0] * w[0] + inverse[1] * w[1] + inverse[2] * w[2],
                            inverse[1] * w[0] + inverse[3] * w[1] + inverse[4] * w[2],
                            inverse[2] * w[0] + inverse[4] * w[1] + inverse[5] * w[2]};
      for (int j = 0; j < 3; ++j) result.pose[j] -= step[j], moves |= std::fabs(step[j]) >= own.settled_m;
    }
    result.moves = moves;
    return result;
  }
};

ffi::Error Match(Counts near, Reals x, Reals y, Reals normal_x, Reals normal_y, Vectors xy, Vectors normal,
                        ffi::Buffer<ffi::PRED, 1> valid, Reals terms, ffi::Result<Reals> found) {
  if (terms.size_bytes() != sizeof(MatchTerms) || found->size_bytes() != sizeof(MatchResult))
    return ffi::Error::InvalidArgument("numbers of a match must be as many as in match.h");
  Matcher matcher{near.typed_data(), static_cast<int>(near.dimensions()[0]), static_cast<int>(near.dimensions()[1]),
                  static_cast<int>(x.element_count()), static_cast<int>(valid.element_count()), x.typed_data(),
                  y.typed_data(), normal_x.typed_data(), normal_y.typed_data(), xy.typed_data(), normal.typed_data(),
                  valid.typed_data(), {}};
  std::memcpy(&matcher.own, terms.typed_data(), sizeof matcher.own);
  const MatchResult result = matcher.Rounds();
  std::memcpy(found->typed_data(), &result, sizeof result);
  return ffi::Error::Success();
}

}  // namespace

XLA_FFI_DEFINE_HANDLER_SYMBOL(jexplore_match, Match);

}  // namespace jexplore
