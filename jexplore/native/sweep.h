// Scans from any pose, in calls of JAX's typed FFI: where beams end, what that tells a map, points that enter a point map.
// Single precision and whole numbers, as in `slam2d`; no product is added to anything, so that nothing is rounded otherwise.

#pragma once

#include <cmath>

#include "plan.h"

namespace jexplore {
namespace {

using Reals = ffi::Buffer<ffi::F32, 1>;
using Vectors = ffi::Buffer<ffi::F32, 2>;
using Scalar = ffi::Buffer<ffi::F32, 0>;
using Bits = ffi::Buffer<ffi::PRED, 1>;

constexpr int kLanes = 4;
using Floats = float __attribute__((vector_size(4 * kLanes)));
using Ints = int32_t __attribute__((vector_size(4 * kLanes)));

Floats Pick(Ints which, Floats yes, Floats no) {
  return reinterpret_cast<Floats>((which & reinterpret_cast<Ints>(yes)) | (~which & reinterpret_cast<Ints>(no)));
}

// Some beams under way together: the cells that they are in, and the distances at which they entered them
// (`raycast.advance_beams`).
struct Beams {
  Floats to_x, to_y, per_x, per_y, crossed_x{}, crossed_y{}, at_x, at_y, entry{};
  Ints row, col, cell, way_x, way_y, up;

  static float Per(float along) { return along == 0 ? 1e30f : 1 / std::fabs(along); }

  // Of `direction`, [n, 2]; those beyond n are as the first one.
  Beams(const float* direction, int n, float x, float y, int width) {
    const float left = std::floor(x), below = std::floor(y);
    x -= left, y -= below;
    for (int j = 0; j < kLanes; ++j) {
      const float *along = direction + (j < n ? 2 * j : 0), dx = along[0], dy = along[1];
      to_x[j] = dx == 0 ? 1 : dx < 0 ? x : 1 - x, to_y[j] = dy == 0 ? 1 : dy < 0 ? y : 1 - y;
      per_x[j] = Per(dx), per_y[j] = Per(dy), way_x[j] = dx < 0 ? -1 : 1, way_y[j] = dy < 0 ? -1 : 1;
      row[j] = static_cast<int>(below), col[j] = static_cast<int>(left), up[j] = way_y[j] * width;
      cell[j] = row[j] * width + col[j];
    }
    at_x = to_x * per_x, at_y = to_y * per_y;
  }

  void Go() {
    const Ints is_x = at_x <= at_y;
    entry = Pick(is_x, at_x, at_y);
    crossed_x += Pick(is_x, Floats{} + 1, Floats{}), crossed_y += Pick(is_x, Floats{}, Floats{} + 1);
    at_x = (crossed_x + to_x) * per_x, at_y = (crossed_y + to_y) * per_y;
    col += is_x & way_x, row += ~is_x & way_y, cell += (is_x & way_x) | (~is_x & up);
  }
};

bool Any(Ints which) {
  using Pairs = int64_t __attribute__((vector_size(4 * kLanes)));
  const Pairs pairs = reinterpret_cast<Pairs>(which);
  int64_t any = 0;
  for (int j = 0; j < kLanes / 2; ++j) any |= pairs[j];
  return any != 0;
}

// Calls `use(first, n, beams)` for the beams from a place, some at a time.
template <class Use>
void ForBeams(const Reals& xy, const Vectors& direction, int width, Use use) {
  const int n = static_cast<int>(direction.dimensions()[0]);
  for (int i = 0; i < n; i += kLanes) {
    const int own = std::min(n - i, kLanes);
    use(i, own, Beams(direction.typed_data() + 2 * i, own, xy.typed_data()[0], xy.typed_data()[1], width));
  }
}

// `beams.cast`. Terms: the row where the map begins.
ffi::Error Cast(Flags occupied, Reals xy, Vectors direction, Scalar reach_, Numbers terms, ffi::Result<Reals> distance,
                ffi::Result<Bits> hit) {
  const int width = static_cast<int>(occupied.dimensions()[1]), last = static_cast<int>(occupied.element_count()) - 1;
  const int base = terms.typed_data()[0] * width;
  const bool* walls = occupied.typed_data();
  const float reach = *reach_.typed_data();
  ForBeams(xy, direction, width, [&](int first, int n, Beams beams) {
    for (int j = 0; j < n; ++j) hit->typed_data()[first + j] = false, distance->typed_data()[first + j] = reach;
    Ints going{};
    for (int j = 0; j < n; ++j) going[j] = -1;
    beams.Go();
    for (Floats entry = beams.entry; Any(going &= entry < reach);) {
      for (int j = 0; j < n; ++j)
        if (going[j] && walls[std::clamp(base + beams.cell[j], 0, last)])
          going[j] = 0, hit->typed_data()[first + j] = true, distance->typed_data()[first + j] = entry[j];
      beams.Go();
      entry = Pick(beams.entry == entry, beams.entry * 1.000001f, beams.entry);
    }
  });
  return ffi::Error::Success();
}

// Cells that beams pass, the first n, and those in which they end. Kept from call to call, for their memory.
struct Crossed {
  std::vector<int> passed, ends;
  int64_t n;
};

// Finds the cells that readings pass, once for every beam and in no order, and those in which they end. Cells of beams
// that end well inside the map are not asked one by one whether they lie in it.
void Follow(const Reals& xy, const Vectors& direction, const Reals& distance, const Bits& hit, const Bits& speaks,
            float reach, int width, int rows, int cols, Crossed& found) {
  // Cells of a beam within the map: on either axis one more than whole ones that it is long, and one at its end.
  const int most = 2 * (static_cast<int>(std::min(reach, 0.5f * (rows + cols))) + 2);
  const float x = xy.typed_data()[0], y = xy.typed_data()[1];
  const size_t room = static_cast<size_t>(most) * (direction.dimensions()[0] + kLanes) + kLanes;
  if (found.passed.size() < room) found.passed.resize(room);
  found.ends.clear();
  int* passed = found.passed.data();
  ForBeams(xy, direction, width, [&](int first, int n, Beams beams) {
    auto is_inside = [&] { return (beams.row >= 0) & (beams.row < rows) & (beams.col >= 0) & (beams.col < cols); };
    if (first == 0 && is_inside()[0]) *passed++ = beams.cell[0];
    Floats limit{};
    Ints going{};
    bool all_inside = true;
    for (int j = 0; j < n; ++j) {
      going[j] = -speaks.typed_data()[first + j];
      limit[j] = hit.typed_data()[first + j] ? distance.typed_data()[first + j] : INFINITY;
      const float far = std::min(limit[j], reach), *along = direction.typed_data() + 2 * (first + j);
      const float end_x = x + far * along[0], end_y = y + far * along[1];
      all_inside &= std::min({x, y, end_x, end_y}) > 3 && std::max(x, end_x) < cols - 3 && std::max(y, end_y) < rows - 3;
    }
    beams.Go();
    for (going &= beams.entry < reach; Any(going);) {
      const Ints counted = all_inside ? going : going & is_inside(), cell = beams.cell;
      const Floats entry = beams.entry;
      beams.Go();
      const Ints passes = 0.5f * (entry + beams.entry) < limit;
      if (!Any(~(counted & passes))) {
        std::memcpy(passed, &cell, sizeof cell), passed += kLanes;
      } else {
        for (int j = 0; j < n; ++j)
          if (counted[j]) passes[j] ? void(*passed++ = cell[j]) : found.ends.push_back(cell[j]);
      }
      going &= passes & (beams.entry < reach);
    }
  });
  found.n = passed - found.passed.data();
}

// `beams.fold`; also how many cells within have become known. Terms: `extent`, `ends_first`.
ffi::Error Fold(Counts hits, Counts misses, Reals xy, Vectors direction, Reals distance, Bits hit, Bits speaks,
                Scalar reach, Flags within_, Numbers terms, ffi::Result<Counts> hits_out,
                ffi::Result<Counts> misses_out, ffi::Result<Numbers> fresh) {
  int32_t *hit_at = InPlace(hits, hits_out), *missed_at = InPlace(misses, misses_out);
  const bool* within = within_.element_count() == hits.element_count() ? within_.typed_data() : nullptr;
  const int width = static_cast<int>(hits.dimensions()[1]), rows = terms.typed_data()[0], cols = terms.typed_data()[1];
  constexpr int kEnd = 1 << 30;  // of hits, while a scan is counted: a beam ends in the cell
  thread_local Crossed found;
  Follow(xy, direction, distance, hit, speaks, *reach.typed_data(), width, rows, cols, found);
  int n_fresh = 0;
  auto count = [&](int32_t* counts, const int32_t* others, int i) {
    if (counts[i]++ == 0 && others[i] == 0) n_fresh += !within || within[i];
  };
  if (terms.typed_data()[2])
    for (int i : found.ends) hit_at[i] |= kEnd;
  for (const int* i = found.passed.data(); i < found.passed.data() + found.n; ++i)
    if (hit_at[*i] < kEnd) count(missed_at, hit_at, *i);
  for (int i : found.ends) hit_at[i] &= ~kEnd;
  for (int i : found.ends) count(hit_at, missed_at, i);
  fresh->typed_data()[0] = n_fresh;
  return ffi::Error::Success();
}

// `points.add`, of points whose places are known: those that have the minimum distance from all others enter the map, the
// one nearest to the scanner first, and its index.
ffi::Error Enter(Reals x_, Reals y_, Reals normal_x, Reals normal_y, Counts near_, Numbers told, Vectors given, Counts cells,
                 Bits inside, Scalar scale_, ffi::Result<Reals> x_out, ffi::Result<Reals> y_out,
                 ffi::Result<Reals> normal_x_out, ffi::Result<Reals> normal_y_out, ffi::Result<Counts> near_out,
                 ffi::Result<Numbers> told_out) {
  constexpr int kParts = 256, kReach = 6, kSteps = 190, kNumberBits = 18, kNoPoint = INT32_MAX, kShares = 2048;
  const int n = static_cast<int>(inside.element_count()), size = static_cast<int>(x_.element_count());
  const int height = static_cast<int>(near_.dimensions()[0]), width = static_cast<int>(near_.dimensions()[1]);
  float *x = InPlace(x_, x_out), *y = InPlace(y_, y_out);
  float* normals[2] = {InPlace(normal_x, normal_x_out), InPlace(normal_y, normal_y_out)};
  int32_t *near = InPlace(near_, near_out), *told_at = InPlace(told, told_out);
  const float* own[7];  // x, y, normals, x and y in the scan, squared distance
  for (int k = 0; k < 7; ++k) own[k] = given.typed_data() + static_cast<int64_t>(k) * n;
  const int32_t *rows = cells.typed_data(), *cols = rows + n;
  const float scale = *scale_.typed_data();
  auto share = [scale](float a) { return std::nearbyint(a * scale); };
  auto is_near = [&](int i, float other_x, float other_y) {
    const int dx = static_cast<int>(std::min(std::fabs(share(own[0][i]) - share(other_x)), 30000.0f));
    const int dy = static_cast<int>(std::min(std::fabs(share(own[1][i]) - share(other_y)), 30000.0f));
    return dx * dx + dy * dy < kShares * kShares;
  };
  auto is_free = [&](int i) {
    const int row = rows[i] / kParts, col = cols[i] / kParts;
    for (int r = std::max(row - 2, 0); r <= std::min(row + 2, height - 1); ++r)
      for (int c = std::max(col - 2, 0); c <= std::min(col + 2, width - 1); ++c) {
        const int found = near[r * width + c], at = std::min(found & ((1 << kNumberBits) - 1), size - 1);
        if (found != kNoPoint && is_near(i, x[at], y[at])) return false;
      }
    return true;
  };
  std::vector<int> left, chosen;
  for (int i = 0; i < n; ++i)
    if (inside.typed_data()[i] && is_free(i)) left.push_back(i);
  std::stable_sort(left.begin(), left.end(), [&](int i, int j) {
    for (int k : {6, 4, 5})
      if (own[k][i] != own[k][j]) return own[k][i] < own[k][j];
    return false;
  });
  for (int i : left) {
    const bool rivalled =
        std::any_of(chosen.begin(), chosen.end(), [&](int j) { return is_near(i, own[0][j], own[1][j]); });
    if (!rivalled) chosen.push_back(i);
  }
  for (int i : chosen) {
    const int number = told_at[0];
    if (number >= size) {
      ++told_at[1];
      continue;
    }
    ++told_at[0], x[number] = own[0][i], y[number] = own[1][i];
    normals[0][number] = own[2][i], normals[1][number] = own[3][i];
    const int row = rows[i] / kParts, col = cols[i] / kParts;
    for (int r = std::max(row - kReach, 0); r <= std::min(row + kReach, height - 1); ++r)
      for (int c = std::max(col - kReach, 0); c <= std::min(col + kReach, width - 1); ++c) {
        const int up = r * kParts + kParts / 2 - rows[i], right = c * kParts + kParts / 2 - cols[i];
        const int d2 = up * up + right * right;
        if (4 * d2 >= (2 * kReach + 1) * (2 * kReach + 1) * kParts * kParts) continue;
        int32_t& cell = near[r * width + c];
        cell = std::min(cell, (d2 * kSteps / (kParts * kParts)) << kNumberBits | number);
      }
  }
  return ffi::Error::Success();
}

using Picture = ffi::Buffer<ffi::S16, 2>;
using Cells = ffi::Buffer<ffi::S32, 3>;
constexpr int kBlock = 6;  // `search.BLOCK`

// `search._coarse`. Terms: first row and column of the picture, the largest cost.
ffi::Error Coarse(Counts near, Cells cells, Bits valid, Numbers terms, ffi::Result<Cells> sums, ffi::Result<Picture> cost) {
  using Shorts = int16_t __attribute__((vector_size(16)));
  constexpr int kMany = 8, kNumberBits = 18;
  const int turns = static_cast<int>(cells.dimensions()[1]), n_beams = static_cast<int>(cells.dimensions()[2]);
  const int n = static_cast<int>(sums->dimensions()[1]), width_near = static_cast<int>(near.dimensions()[1]);
  const int height = static_cast<int>(cost->dimensions()[0]), width = static_cast<int>(cost->dimensions()[1]);
  const int first_row = terms.typed_data()[0], first_col = terms.typed_data()[1];
  const auto most = static_cast<int16_t>(terms.typed_data()[2]);
  const int64_t size = static_cast<int64_t>(height) * width;
  int16_t* costs = cost->typed_data();
  std::fill(costs, costs + size, most);
  for (int row = kBlock; row < height - kBlock; ++row) {
    const int32_t* from = near.typed_data() + static_cast<int64_t>(first_row + row - kBlock) * width_near + first_col;
    int16_t* to = costs + static_cast<int64_t>(row) * width + kBlock;
    for (int col = 0; col < width - 2 * kBlock; ++col) to[col] = static_cast<int16_t>(std::min<int32_t>(from[col] >> kNumberBits, most));
  }
  // Least costs from every cell on, up and to the right; cells beyond the picture cost the most.
  std::vector<int16_t> floors(size + 4 * width + kMany, most);
  std::memcpy(floors.data(), costs, size * sizeof(int16_t));
  for (const int step : {1, 2, 2, width, 2 * width, 2 * width})
    for (int64_t i = 0; i < size; i += kMany) {
      Shorts here, other;
      std::memcpy(&here, &floors[i], sizeof here), std::memcpy(&other, &floors[i + step], sizeof other);
      const Shorts is_less = here < other;
      here = (here & is_less) | (other & ~is_less);
      std::memcpy(&floors[i], &here, sizeof here);
    }
  // Cells a block apart stand side by side, in a plane for each place of a cell in its block, with a margin of the window.
  const auto floor_of = [](int a) { return a >= 0 ? a / kBlock : -((kBlock - 1 - a) / kBlock); };
  const int in_row = (n + kMany - 1) / kMany * kMany, high = floor_of(height - 1) + 1, wide = floor_of(width - 1) + 1;
  const int stride = wide + n + in_row;
  std::vector<int16_t> planes(static_cast<int64_t>(kBlock) * kBlock * high * stride, most), outside(in_row, most);
  const auto row_of = [&](int in_row_of, int in_col_of, int row) {
    return &planes[((in_row_of * kBlock + in_col_of) * static_cast<int64_t>(high) + row) * stride];
  };
  for (int row = 0; row < height; ++row)
    for (int k = 0; k < kBlock; ++k) {
      int16_t* to = row_of(row % kBlock, k, row / kBlock) + n;
      for (int col = k; col < width; col += kBlock) *to++ = floors[static_cast<int64_t>(row) * width + col];
    }
  using Sums = int32_t __attribute__((vector_size(4 * kMany)));
  std::vector<int32_t> own(n * in_row);
  for (int turn = 0; turn < turns; ++turn) {
    std::fill(own.begin(), own.end(), 0);
    for (int beam = 0; beam < n_beams; ++beam) {
      if (!valid.typed_data()[beam]) continue;
      const int64_t at = static_cast<int64_t>(turn) * n_beams + beam;
      const int row = cells.typed_data()[at], col = cells.typed_data()[at + static_cast<int64_t>(turns) * n_beams];
      const int up = floor_of(row), right = floor_of(col), first = std::clamp(right - n / 2, -n, wide) + n;
      for (int i = 0; i < n; ++i) {
        const int r = up - n / 2 + i;
        const bool is_inside = 0 <= r && r < high;
        const int16_t* from = is_inside ? row_of(row - up * kBlock, col - right * kBlock, r) + first : outside.data();
        for (int j = 0; j < in_row; j += kMany) {
          Shorts more;
          Sums sum;
          std::memcpy(&more, from + j, sizeof more), std::memcpy(&sum, &own[i * in_row + j], sizeof sum);
          sum += __builtin_convertvector(more, Sums);
          std::memcpy(&own[i * in_row + j], &sum, sizeof sum);
        }
      }
    }
    for (int i = 0; i < n; ++i)
      std::copy_n(&own[i * in_row], n, sums->typed_data() + (static_cast<int64_t>(turn) * n + i) * n);
  }
  return ffi::Error::Success();
}

// `search._fine`, of blocks `which`: turns, rows and columns. Terms: the largest cost, blocks in a row.
ffi::Error Fine(Picture cost, Cells cells, Bits valid, Counts which, Numbers terms, ffi::Result<Counts> sums) {
  const int turns = static_cast<int>(cells.dimensions()[1]), n_beams = static_cast<int>(cells.dimensions()[2]);
  const int height = static_cast<int>(cost.dimensions()[0]), width = static_cast<int>(cost.dimensions()[1]);
  const int m = static_cast<int>(which.dimensions()[1]), most = terms.typed_data()[0], half = terms.typed_data()[1] / 2;
  std::memset(sums->untyped_data(), 0, sums->size_bytes());
  for (int k = 0; k < m; ++k) {
    const int32_t* of = which.typed_data() + k;
    const int64_t turn = std::clamp(of[0], 0, turns - 1) * static_cast<int64_t>(n_beams);
    int32_t* sum = sums->typed_data() + kBlock * kBlock * k;
    for (int beam = 0; beam < n_beams; ++beam) {
      if (!valid.typed_data()[beam]) continue;
      const int row = cells.typed_data()[turn + beam] + (of[m] - half) * kBlock;
      const int col = cells.typed_data()[turn + beam + static_cast<int64_t>(turns) * n_beams] + (of[2 * m] - half) * kBlock;
      for (int i = 0; i < kBlock; ++i)
        for (int j = 0, r = row + i, c = col; j < kBlock; ++j, ++c)
          sum[i * kBlock + j] += 0 <= r && r < height && 0 <= c && c < width ? cost.typed_data()[static_cast<int64_t>(r) * width + c] : most;
    }
  }
  return ffi::Error::Success();
}

}  // namespace

XLA_FFI_DEFINE_HANDLER_SYMBOL(jexplore_cast, Cast);
XLA_FFI_DEFINE_HANDLER_SYMBOL(jexplore_fold, Fold);
XLA_FFI_DEFINE_HANDLER_SYMBOL(jexplore_enter, Enter);
XLA_FFI_DEFINE_HANDLER_SYMBOL(jexplore_coarse, Coarse);
XLA_FFI_DEFINE_HANDLER_SYMBOL(jexplore_fine, Fine);

}  // namespace jexplore
