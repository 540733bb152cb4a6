// One scan and what it tells the map: `raycast.scan`, `without_silent`, `raycast.fold` and the count of known cells in
// one pass over the cells that beams enter, two where a beam without an echo says nothing. Whole numbers only, so that
// every bit is that of the kernels in JAX.

#include <algorithm>
#include <cstdint>
#include <cstring>

#include "xla/ffi/api/ffi.h"

namespace ffi = xla::ffi;

using Counts = ffi::Buffer<ffi::S32, 2>;  // [H, W]
using Walls = ffi::Buffer<ffi::PRED, 2>;  // [H', W]
using Table = ffi::Buffer<ffi::S32, 4>;   // [K, S / BLOCK, B, BLOCK], `Beams.by_beam`
using Length = ffi::Buffer<ffi::S32, 2>;  // [K, B], `Beams.length`
using Pose = ffi::Buffer<ffi::S32, 1>;    // row, col, heading of the scan; of where it is counted; whether it is;
                                          // whether a beam without an echo shows its cells to be free
using Fresh = ffi::Buffer<ffi::S32, 0>;

namespace {

// No scan leaves the map, whose outermost rows and columns are walls; nothing beyond it is touched even if one did.
bool IsInside(int64_t cell, int64_t n_cells) {
  return static_cast<uint64_t>(cell) < static_cast<uint64_t>(n_cells);
}

// The map that a scan is counted into.
struct Map {
  int32_t* hits;
  int32_t* misses;
  int64_t n_cells;
  int32_t fresh = 0;  // cells that have come to be known

  void Count(int32_t* counts, int64_t cell) {
    if (!IsInside(cell, n_cells)) return;
    if (misses[cell] == 0 && hits[cell] == 0) ++fresh;
    ++counts[cell];
  }
};

// The walls of the world, and whether something stops a beam on its way.
struct World {
  const bool* walls;
  int64_t n_cells;

  bool Stops(int64_t cell) const { return !IsInside(cell, n_cells) || walls[cell]; }

  bool Echoes(int64_t stands, const int32_t* seen, int64_t left, int64_t block, int64_t stride) const {
    for (; left > 0; left -= block, seen += stride)
      for (int64_t step = 0; step < std::min(left, block); ++step)
        if (Stops(stands + seen[step])) return true;
    return false;
  }
};

ffi::Error Look(Counts hits, Counts misses, Walls occupied, Table by_beam, Length length, Pose pose,
                ffi::Result<Counts> hits_out, ffi::Result<Counts> misses_out, ffi::Result<Fresh> fresh) {
  const auto shape = by_beam.dimensions();
  const int64_t n_headings = shape[0], n_beams = shape[2], block = shape[3], stride = n_beams * block;
  const int64_t width = hits.dimensions()[1];
  const int32_t* at = pose.typed_data();
  const World world{occupied.typed_data(), static_cast<int64_t>(occupied.element_count())};
  Map map{hits_out->typed_data(), misses_out->typed_data(), static_cast<int64_t>(hits.element_count())};
  // XLA gives these results the memory of the arguments that they replace; were it not so, they would be copied here.
  if (map.hits != hits.typed_data()) std::memcpy(map.hits, hits.typed_data(), hits.size_bytes());
  if (map.misses != misses.typed_data()) std::memcpy(map.misses, misses.typed_data(), misses.size_bytes());

  const int64_t stands = at[0] * width + at[1], believes = at[3] * width + at[4];
  const int64_t seen_at = std::clamp<int64_t>(at[2], 0, n_headings - 1);
  const int64_t told_at = std::clamp<int64_t>(at[5], 0, n_headings - 1);
  const int32_t* seen_table = by_beam.typed_data() + seen_at * shape[1] * stride;
  const int32_t* told_table = by_beam.typed_data() + told_at * shape[1] * stride;
  const int32_t* n_steps = length.typed_data() + seen_at * n_beams;
  const bool when = at[6] != 0, no_echo_is_free = at[7] != 0;
  if (when) map.Count(map.misses, believes);
  for (int64_t beam = 0; when && beam < n_beams; ++beam) {
    const int32_t* seen = seen_table + beam * block;
    const int32_t* told = told_table + beam * block;
    if (!no_echo_is_free && !world.Echoes(stands, seen, n_steps[beam], block, stride)) continue;
    bool stopped = false;
    for (int64_t left = n_steps[beam]; left > 0 && !stopped; left -= block, seen += stride, told += stride) {
      for (int64_t step = 0; step < std::min(left, block) && !stopped; ++step) {
        stopped = world.Stops(stands + seen[step]);
        if (stopped) {
          map.Count(map.hits, believes + told[step]);
        } else {
          map.Count(map.misses, believes + told[step]);
        }
      }
    }
  }
  *fresh->typed_data() = map.fresh;
  return ffi::Error::Success();
}

}  // namespace

XLA_FFI_DEFINE_HANDLER_SYMBOL(jexplore_look, Look,
                              ffi::Ffi::Bind()
                                  .Arg<Counts>()
                                  .Arg<Counts>()
                                  .Arg<Walls>()
                                  .Arg<Table>()
                                  .Arg<Length>()
                                  .Arg<Pose>()
                                  .Ret<Counts>()
                                  .Ret<Counts>()
                                  .Ret<Fresh>());
