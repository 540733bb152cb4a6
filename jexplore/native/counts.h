// What a robot knows, as the arrays of a state in JAX (`exploration.state.State`): hits and misses of every cell.

#pragma once

#include <algorithm>
#include <cstdint>

#include "rules.h"

namespace jexplore {

constexpr int kNothing = INT32_MIN, kNotSeen = INT32_MAX;  // the second: `team.state.ENDED`

// Calls `pass(offset)` for the cells that a beam passes: the offset of the one that stops it, or `kNothing`. Its cells
// stand in blocks, `next` apart.
template <class Stops, class Pass>
int TraceBeam(Stops is_stop, const int32_t* first, int length, int block, int next, Pass pass) {
  for (int left = length; left > 0; left -= block, first += next)
    for (const int32_t *step = first, *end = first + std::min(left, block); step < end; ++step) {
      if (is_stop(*step)) return *step;
      pass(*step);
    }
  return kNothing;
}

// Cells are flat indices. Nothing leaves the map: its outermost rows and columns are walls, which `IsWalled` tells.
struct CountMaps {
  int height, width;
  int32_t *hits, *misses;      // [H, W]
  bool *driven, *exhausted;    // [H, W]
  const int8_t* route;         // [H, W], the motion in every cell of the way
  const bool* occupied;        // [H, W], the true world
  const int32_t* rooms;        // [H, W]
  const bool* within;          // [H, W], where the robot may be and what it is to know; null: everywhere
  const int32_t* by_beam;      // [8, n_blocks, n_beams, block], `raycast.Beams`
  const int32_t* length;       // [8, n_beams]
  const int32_t* blind;        // [8, n_beams]
  int n_blocks, n_beams, block;
  int extent[2];               // height and width of the world without padding
  bool no_echo_is_free;
  int connectivity;            // of frontier and unknown cells
  float p_free;                // largest reflection probability of a free cell
  int n_known = 0;             // known cells within
  int32_t* seen_at = nullptr;  // [H, W], clock when any robot of a team first knew each cell; null: no team
  int now = 0, grown = 0;      // the clock; cells within that no robot knew before

  bool IsWithin(int i) const { return !within || within[i]; }
  int Row(int i) const { return i / width; }
  int Col(int i) const { return i % width; }
  int Flat(int i) const { return i; }
  int Offset(int motion) const { return DRow(motion) * width + DCol(motion); }
  int Room(int i) const { return rooms[i]; }
  int Motion(int at, int) const { return route[at] & 7; }
  int known() const { return n_known; }
  void Drive(int i) { driven[i] = true; }
  void Exhaust(int i) { exhausted[i] = true; }

  void See(int i) {
    if (seen_at[i] != kNotSeen) return;
    seen_at[i] = now;
    grown += IsWithin(i);
  }

  bool IsWalled() const {
    const int last = (height - 1) * width;
    bool walled = height > 0 && width > 0;
    for (int col = 0; walled && col < width; ++col) walled = occupied[col] && occupied[last + col];
    for (int i = 0; walled && i <= last; i += width) walled = occupied[i] && occupied[i + width - 1];
    return walled;
  }

  // `planning.is_open`, of a cell that is no wall.
  bool IsOpen(int i) const {
    if (occupied[i] || !IsWithin(i)) return false;
    const int n = hits[i] + misses[i];
    return driven[i] || (n > 0 && static_cast<float>(hits[i]) <= p_free * static_cast<float>(n));
  }

  // `planning.is_live`.
  bool IsLive(int i) const {
    const int row = Row(i), col = Col(i);
    for (int motion = 0; motion < connectivity; ++motion) {
      const int r = row + DRow(motion), c = col + DCol(motion), j = r * width + c;
      if (r < 0 || r >= extent[0] || c < 0 || c >= extent[1] || !IsWithin(j)) continue;
      if ((hits[j] | misses[j]) == 0) return true;
    }
    return false;
  }

  // `raycast.scan`, `sensing.without_silent` and `raycast.fold`. What the loops use has names of its own: to the
  // compiler a count that is written might be a member.
  void Scan(int from, int heading) {
    const bool* walls = occupied + from;
    int32_t *hit = hits + from, *missed = misses + from;
    const int beams = n_beams, part = block, next = n_beams * block;
    const int32_t *ends = length + heading * beams, *table = by_beam + static_cast<int64_t>(heading) * n_blocks * next;
    const int32_t* near = blind + heading * beams;
    const bool may_be_silent = !no_echo_is_free;
    int fresh = 0;
    auto count = [&](int32_t* counts, const int32_t* others, int i) {
      if (counts[i]++ != 0 || others[i] != 0) return;
      fresh += IsWithin(from + i);
      if (seen_at) See(from + i);
    };
    auto is_wall = [&](int i) { return walls[i]; };
    auto miss = [&](int i) { count(missed, hit, i); };
    // Whether a beam says anything, which `silent` steps are too near for.
    auto speaks = [&](const int32_t* first, int length, int silent) {
      const bool stops = TraceBeam(is_wall, first, length, part, next, [&](int) { --silent; }) != kNothing;
      return stops ? silent <= 0 : no_echo_is_free;
    };
    miss(0);
    for (int beam = 0; beam < beams; ++beam) {
      const int32_t* first = table + static_cast<int64_t>(beam) * part;
      if ((may_be_silent || near[beam] > 0) && !speaks(first, ends[beam], near[beam])) continue;
      const int stop = TraceBeam(is_wall, first, ends[beam], part, next, miss);
      if (stop != kNothing) count(hit, missed, stop);
    }
    n_known += fresh;
  }
};

}  // namespace jexplore
