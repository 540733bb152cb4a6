// Kernels of planning for programs in JAX, each a call of JAX's typed FFI: costs and frontier cells, clusters of these,
// the way to one, looks from some, and how far they lie apart. Whole numbers, equal to those of the functions in JAX.

#pragma once

#include <cstring>
#include <optional>

#include "counts.h"
#include "paths.h"
#include "world.h"
#include "xla/ffi/api/ffi.h"

namespace jexplore {
namespace ffi = xla::ffi;

using Bytes = ffi::Buffer<ffi::U8, 2>;
using Counts = ffi::Buffer<ffi::S32, 2>;
using Flags = ffi::Buffer<ffi::PRED, 2>;
using Motions = ffi::Buffer<ffi::S8, 2>;
using Table = ffi::Buffer<ffi::S32, 4>;
using Numbers = ffi::Buffer<ffi::S32, 1>;

// XLA gives results the memory of the arguments that they replace; were it not so, they would be copied here.
template <class Argument, class Result>
auto InPlace(Argument& argument, Result& result) {
  if (result->untyped_data() != argument.untyped_data())
    std::memcpy(result->untyped_data(), argument.untyped_data(), argument.size_bytes());
  return result->typed_data();
}

namespace {

// A map of JAX's with a margin. Its marks are bits of `kernels.cells_of`; at first every free cell is marked clear.
struct Plan : Paths {
  static constexpr uint8_t kOccupied = 16, kUnknown = 32, kOutside = 64;
  int height, width, margin;

  Plan(int height, int width, int margin)
      : Paths(width + 2 * margin, (width + 2 * margin) * (height + 2 * margin)), height(height), width(width),
        margin(margin) {}

  int Cell(int row, int col) const { return (row + margin) * stride + col + margin; }
  int Row(int i) const { return i / stride - margin; }
  int Col(int i) const { return i % stride - margin; }

  template <class Cells>
  void Read(const Cells* cells) {
    for (int row = 0; row < height; ++row) std::memcpy(&mark[Cell(row, 0)], cells + row * width, width);
  }

  // Calls `use(cell, n, marks)` for n cells of a row, eight at a time; those beyond have no marks.
  template <class Use>
  void ForWords(int first, int n, Use use) const {
    for (int end = first + n; first < end; first += 8) {
      uint64_t word = 0;
      if (end - first >= 8) std::memcpy(&word, &mark[first], 8);
      else std::memcpy(&word, &mark[first], end - first);
      use(first, std::min(end - first, 8), word);
    }
  }

  // Calls `use(cell)` for those with a mark, in order.
  template <class Use>
  void ForMarked(uint8_t bit, Use use) const {
    const uint64_t bits = bit * 0x0101010101010101u;
    for (int row = 0; row < height; ++row)
      ForWords(Cell(row, 0), width, [&](int i, int n, uint64_t word) {
        for (int k = 0; word & bits && k < n; ++k)
          if (mark[i + k] & bit) use(i + k);
      });
  }

  // Only what has no occupied cell within the clearance is clear.
  void Judge(int clearance_d2) {
    const std::vector<int32_t> disc = Disc(clearance_d2, stride);
    ForMarked(kOccupied, [&](int i) {
      for (int offset : disc) mark[i + offset] &= ~kClear;
    });
  }

  bool IsFrontier(int i, int connectivity) const {
    uint8_t near = 0;
    if ((mark[i] & (kClear | kExhausted)) == kClear)
      for (int k = 0; k < connectivity; ++k) near |= mark[i + offsets[k]];
    return near & kUnknown;
  }
};

// A map of a thread's own, kept from call to call: 0 of cells, 1 of blocks of them.
Plan& PlanOf(int which, int64_t height, int64_t width, int margin) {
  static thread_local std::optional<Plan> kept[2];
  auto& plan = kept[which];
  if (!plan || plan->height != height || plan->width != width || plan->margin < margin)
    plan.emplace(static_cast<int>(height), static_cast<int>(width), margin);
  return *plan;
}

template <class Map>
Plan& PlanOf(const Map& map, int clearance_d2 = 0) {
  const auto shape = map.dimensions();
  Plan& plan = PlanOf(0, shape[0], shape[1], static_cast<int>(std::sqrt(static_cast<double>(clearance_d2))) + 2);
  plan.Read(map.typed_data());
  return plan;
}

// `planning.field`. Terms: row, col, clearance_d2, whether only the nearest frontier cells are wanted, connectivity, and
// cells of the smallest group that is a frontier.
ffi::Error Field(Bytes cells, Numbers terms, ffi::Result<Flags> traversable, ffi::Result<Counts> cost,
                 ffi::Result<Flags> candidates) {
  const int32_t *term = terms.typed_data(), row = term[0], col = term[1];
  Plan& plan = PlanOf(cells, term[2]);
  if (row < 0 || row >= plan.height || col < 0 || col >= plan.width)
    return ffi::Error::InvalidArgument("a robot must be on its map");
  plan.Judge(term[2]);
  plan.ForMarked(Plan::kOutside, [&](int i) { plan.mark[i] &= ~Plan::kCan; });
  std::memset(candidates->untyped_data(), 0, candidates->size_bytes());
  bool is_found = false;
  auto is_frontier = [&](int i) { return plan.IsFrontier(i, std::min(term[4], 8)); };
  plan.Search(
      plan.Cell(row, col),
      [&](int i, int) {
        if (!is_frontier(i) || !plan.IsLarge(i, term[5], is_frontier)) return;
        is_found = candidates->typed_data()[plan.Row(i) * plan.width + plan.Col(i)] = true;
      },
      [&] { return is_found && term[3]; });
  for (int r = 0; r < plan.height; ++r) {
    const int first = plan.Cell(r, 0), to = r * plan.width;
    std::memcpy(cost->typed_data() + to, &plan.cost[first], 4 * plan.width);
    plan.ForWords(first, plan.width, [&](int i, int n, uint64_t word) {
      word |= word >> 1 | word >> 2;  // `kCan` is the lowest three bits
      word &= 0x0101010101010101u;
      std::memcpy(traversable->typed_data() + to + i - first, &word, n);
    });
  }
  plan.Forget();
  return ffi::Error::Success();
}

// `frontier.frontier_clusters`, of which the cell of the lowest cost stands for a cluster. Found: row, col and size of
// each; told: clusters, and frontier cells that were not looked at.
ffi::Error Clusters(Flags candidates, Counts cost, Numbers max_cells, ffi::Result<Counts> found,
                    ffi::Result<Numbers> told) {
  Plan& plan = PlanOf(candidates);
  const int32_t most = static_cast<int32_t>(found->dimensions()[1]), *costs = cost.typed_data();
  int32_t *row = found->typed_data(), *col = row + most, *size = col + most, n = 0, left_out = 0;
  std::fill(row, size, -1), std::fill(size, size + most, 0);
  std::vector<int32_t> cells, group;
  plan.ForMarked(1, [&](int i) {
    if (static_cast<int32_t>(cells.size()) < *max_cells.typed_data()) cells.push_back(i);
    else plan.mark[i] = 0, ++left_out;
  });
  for (int seed : cells) {
    if (!plan.mark[seed]) continue;
    plan.mark[seed] = 0, group.assign(1, seed);
    int least = kFar + 1, best = seed;
    for (size_t j = 0; j < group.size(); ++j) {
      const int i = group[j], own = costs[plan.Row(i) * plan.width + plan.Col(i)];
      if (own < least || (own == least && i < best)) least = own, best = i;
      for (int offset : plan.offsets)
        if (plan.mark[i + offset]) plan.mark[i + offset] = 0, group.push_back(i + offset);
    }
    if (n < most) row[n] = plan.Row(best), col[n] = plan.Col(best), size[n] = static_cast<int32_t>(group.size());
    ++n;
  }
  told->typed_data()[0] = n, told->typed_data()[1] = left_out;
  return ffi::Error::Success();
}

// `readout.lay_route` on the whole map. Terms: row and col of the start, and of the target.
ffi::Error Lay(Motions route, Counts cost, Flags traversable, Numbers terms, ffi::Result<Motions> laid) {
  const int32_t* term = terms.typed_data();
  const int height = static_cast<int>(cost.dimensions()[0]), width = static_cast<int>(cost.dimensions()[1]);
  int8_t* way = InPlace(route, laid);
  auto flat = [&](int row, int col) {
    return row < 0 || row >= height || col < 0 || col >= width ? -1 : row * width + col;
  };
  auto can = [&](int row, int col) { return flat(row, col) >= 0 && traversable.typed_data()[flat(row, col)]; };
  int row = term[2], col = term[3];
  for (int n = 0; (row != term[0] || col != term[1]) && flat(row, col) >= 0 && n < height * width; ++n) {
    auto before = [&](int k) {
      const int i = flat(row - DRow(k), col - DCol(k));
      return i < 0 ? kFar : cost.typed_data()[i];
    };
    auto is_possible = [&](int k) {
      return can(row, col) && (k < 4 || (can(row - DRow(k), col) && can(row, col - DCol(k))));
    };
    const int k = MotionInto(cost.typed_data()[flat(row, col)], before, is_possible);
    if (k == 8) break;
    row -= DRow(k), col -= DCol(k);
    way[flat(row, col)] = static_cast<int8_t>(k);
  }
  return ffi::Error::Success();
}

// `gain.look` and `gain.seen_within` from the first n cells `at`: unknown cells that are passed within each of some
// distances, then known ones. `cells`: bits of those that stop beams (1) and of unknown ones (2), with a margin as wide
// as beams are long. Terms: n, how many unknown cells are enough to end a look, and the side of the square of `by_beam`.
ffi::Error Look(Bytes cells, Counts at, Table by_beam, Counts length, ffi::Buffer<ffi::F32, 1> d2, Numbers terms,
                ffi::Result<Counts> told) {
  constexpr uint8_t kStop = 1, kUnknown = 2, kPassed = 4;
  const int height = static_cast<int>(cells.dimensions()[0]), width = static_cast<int>(cells.dimensions()[1]);
  const int n_beams = static_cast<int>(by_beam.dimensions()[2]), block = static_cast<int>(by_beam.dimensions()[3]);
  const int m = static_cast<int>(at.dimensions()[1]), n_d2 = static_cast<int>(d2.element_count());
  const int32_t *term = terms.typed_data(), side = term[2], middle = side / 2 * side + side / 2;
  if (side > height || side > width) return ffi::Error::InvalidArgument("a map must have a margin as wide as beams are long");
  std::memset(told->untyped_data(), 0, told->size_bytes());
  std::vector<uint8_t> square(side * side);
  std::vector<int32_t> passed;
  for (int slot = 0; slot < std::min(term[0], m); ++slot) {
    const int row = std::clamp(at.typed_data()[slot], 0, height - side);
    const int col = std::clamp(at.typed_data()[m + slot], 0, width - side);
    for (int y = 0; y < side; ++y)
      std::memcpy(&square[y * side], cells.typed_data() + static_cast<int64_t>(row + y) * width + col, side);
    uint8_t* here = &square[middle];
    int n_unknown = 0;
    auto pass = [&](int offset) {
      if (here[offset] & kPassed) return;
      here[offset] |= kPassed, passed.push_back(middle + offset), n_unknown += (here[offset] & kUnknown) != 0;
    };
    pass(0);
    for (int beam = 0; beam < n_beams && n_unknown < term[1]; ++beam)
      TraceBeam([&](int offset) { return (here[offset] & kStop) != 0; },
                by_beam.typed_data() + static_cast<int64_t>(beam) * block, length.typed_data()[beam], block,
                n_beams * block, pass);
    for (int i : passed) {
      const int y = i / side - side / 2, x = i % side - side / 2;
      if (!(square[i] & kUnknown)) ++told->typed_data()[n_d2 * m + slot];
      else
        for (int r = 0; r < n_d2; ++r)
          told->typed_data()[r * m + slot] += static_cast<float>(y * y + x * x) <= d2.typed_data()[r];
    }
    passed.clear();
  }
  return ffi::Error::Success();
}

// The costs of `clusters.paths_apart`, between the first n cells `at`. Terms: n, the side of a block, clearance_d2, rows
// and columns by which the first block begins before the map.
ffi::Error Apart(Bytes cells, Counts at, Numbers terms, ffi::Result<Counts> table) {
  const int m = static_cast<int>(at.dimensions()[1]), n = std::min(terms.typed_data()[0], m);
  const int side = terms.typed_data()[1], above = terms.typed_data()[3], before = terms.typed_data()[4];
  Plan& plan = PlanOf(cells, terms.typed_data()[2]);
  plan.Judge(terms.typed_data()[2]);
  Plan& blocks = PlanOf(1, (plan.height + side - 1) / side + 1, (plan.width + side - 1) / side + 1, 1);
  std::fill(blocks.mark.begin(), blocks.mark.end(), 0);
  for (int row = 0; row < plan.height; ++row) {
    uint8_t* to = &blocks.mark[blocks.Cell((row + above) / side, 0)];
    for (int col = -before; col < plan.width; col += side, ++to)
      for (int i = plan.Cell(row, std::max(col, 0)), end = plan.Cell(row, std::min(col + side, plan.width)); i < end; ++i)
        *to |= plan.mark[i] & (Plan::kClear | Plan::kDriven);
  }
  auto block_of = [&](int i) {
    return blocks.Cell((at.typed_data()[i] + above) / side, (at.typed_data()[m + i] + before) / side);
  };
  std::fill(table->typed_data(), table->typed_data() + table->element_count(), kFar);
  for (int i = 0; i < n; ++i) {
    int left = 0;  // blocks to which the costs are wanted: those to others are known
    for (int j = i + 1; j < n; ++j) {
      uint8_t& mark = blocks.mark[block_of(j)];
      left += !(mark & Plan::kExhausted), mark |= Plan::kExhausted;
    }
    if (left > 0)
      blocks.Search(
          block_of(i), [&](int block, int) { left -= (blocks.mark[block] & Plan::kExhausted) != 0; },
          [&] { return left == 0; });
    for (int j = i; j < n; ++j) {
      blocks.mark[block_of(j)] &= ~Plan::kExhausted;
      table->typed_data()[i * m + j] = table->typed_data()[j * m + i] = j == i ? 0 : blocks.cost[block_of(j)];
    }
    if (n > i + 1) blocks.Forget();
  }
  return ffi::Error::Success();
}

}  // namespace

XLA_FFI_DEFINE_HANDLER_SYMBOL(jexplore_field, Field);
XLA_FFI_DEFINE_HANDLER_SYMBOL(jexplore_clusters, Clusters);
XLA_FFI_DEFINE_HANDLER_SYMBOL(jexplore_lay, Lay);
XLA_FFI_DEFINE_HANDLER_SYMBOL(jexplore_look, Look);
XLA_FFI_DEFINE_HANDLER_SYMBOL(jexplore_apart, Apart);

}  // namespace jexplore
