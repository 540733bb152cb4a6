// What a robot knows, as the arrays of a state in JAX (`exploration.state.State`): hits and misses of every cell.

#pragma once

#include <algorithm>
#include <cstdint>

#include "rules.h"

namespace jexplore {

// Cells are flat indices. Nothing leaves the map, whose outermost rows and columns are walls; nothing beyond it is
// touched even if something did.
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
  int n_blocks, n_beams, block;
  int extent[2];               // height and width of the world without padding
  bool no_echo_is_free;
  float p_free;                // largest reflection probability of a free cell
  int n_known = 0;             // known cells within

  bool IsInside(int64_t i) const { return static_cast<uint64_t>(i) < static_cast<uint64_t>(height) * width; }
  bool IsWithin(int i) const { return !within || within[i]; }
  bool IsWall(int64_t i) const { return !IsInside(i) || occupied[i]; }
  int Row(int i) const { return i / width; }
  int Col(int i) const { return i % width; }
  int Flat(int i) const { return i; }
  int Offset(int motion) const { return DRow(motion) * width + DCol(motion); }
  int Room(int i) const { return rooms[i]; }
  int Motion(int at, int) const { return route[at] & 7; }
  int known() const { return n_known; }
  void Drive(int i) {
    if (IsInside(i)) driven[i] = true;
  }
  void Exhaust(int i) {
    if (IsInside(i)) exhausted[i] = true;
  }

  // `planning.is_open`, of a cell that is no wall.
  bool IsOpen(int i) const {
    if (IsWall(i) || !IsWithin(i)) return false;
    const int n = hits[i] + misses[i];
    return driven[i] || (n > 0 && static_cast<float>(hits[i]) <= p_free * static_cast<float>(n));
  }

  // `planning.is_live`.
  bool IsLive(int i) const {
    const int row = Row(i), col = Col(i);
    for (int motion = 0; motion < 8; ++motion) {
      const int r = row + DRow(motion), c = col + DCol(motion), j = r * width + c;
      if (r < 0 || r >= extent[0] || c < 0 || c >= extent[1] || !IsWithin(j)) continue;
      if ((hits[j] | misses[j]) == 0) return true;
    }
    return false;
  }

  void Count(int32_t* counts, int64_t i) {
    if ((hits[i] | misses[i]) == 0) n_known += IsWithin(static_cast<int>(i));
    ++counts[i];
  }

  bool Echoes(int64_t from, const int32_t* steps, int left) const {
    for (const int64_t next = static_cast<int64_t>(n_beams) * block; left > 0; left -= block, steps += next)
      for (int step = 0; step < std::min(left, block); ++step)
        if (IsWall(from + steps[step])) return true;
    return false;
  }

  // Counts the cells that a beam enters.
  void Follow(int64_t from, const int32_t* steps, int left) {
    for (const int64_t next = static_cast<int64_t>(n_beams) * block; left > 0; left -= block, steps += next)
      for (int step = 0; step < std::min(left, block); ++step) {
        const int64_t i = from + steps[step];
        if (IsWall(i)) {
          if (IsInside(i)) Count(hits, i);
          return;
        }
        Count(misses, i);
      }
  }

  // `raycast.scan`, `sensing.without_silent` and `raycast.fold`.
  void Scan(int from, int heading) {
    Count(misses, from);
    const int32_t* table = by_beam + static_cast<int64_t>(heading) * n_blocks * n_beams * block;
    for (int beam = 0; beam < n_beams; ++beam) {
      const int n = length[heading * n_beams + beam];
      const int32_t* steps = table + static_cast<int64_t>(beam) * block;
      if (no_echo_is_free || Echoes(from, steps, n)) Follow(from, steps, n);
    }
  }
};

}  // namespace jexplore
