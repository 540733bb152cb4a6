// What all episodes in a world share, made ready on the host.

#pragma once

#include <algorithm>
#include <cmath>
#include <map>
#include <vector>

#include "rules.h"

namespace jexplore {

// The beams of a scanner: every step of one is to the next column, or to the next row, in a direction of its own.
struct Beams {
  const int32_t* way;      // [8, B, 2], direction of its columns and of its rows: -1, 0, 1
  const int32_t* length;   // [8, B], cells entered
  const uint32_t* is_row;  // [8, B, n_words], a bit a step: whether it is to the next row
  int32_t n_words;
};

// What is given of a world and a scanner. `[H, W]` arrays, row after row, with the ring of walls.
struct Given {
  const uint8_t* occupied;
  const int32_t* rooms;
  const int32_t* region;   // number of each 4-connected region of free cells within
  const uint8_t* within;   // where the robot may be and what it is to know; null: everywhere
  const int8_t* prior;     // what it knows before its first scan: -1, 0 free, 1 occupied; null: nothing
  Beams beams;
};

// Flat offsets of a disc, rows of which are `stride` apart; its centre among them.
inline std::vector<int32_t> Disc(int d2, int stride) {
  std::vector<int32_t> cells;
  const int radius = static_cast<int>(std::sqrt(static_cast<double>(d2)));
  for (int y = -radius; y <= radius; ++y)
    for (int x = -radius; x <= radius; ++x)
      if (y * y + x * x <= d2) cells.push_back(y * stride + x);
  return cells;
}

// A world with a margin as wide as whatever is looked at round a cell, so that nothing needs to look for the edge.
struct World {
  const Spec p;
  const Given given;
  int margin, stride, n_cells;
  std::vector<int32_t> near, clearance;   // offsets of the discs
  std::vector<uint8_t> is_clear;          // in the true world; with the margin, like all below
  std::vector<int32_t> part;              // number of each connected part of the clear cells; -1
  std::vector<std::vector<int32_t>> parts;  // their cells
  std::vector<std::vector<int32_t>> goals;  // parts that are to be known, of each goal
  std::map<std::vector<int32_t>, int32_t> goal_of;
  std::vector<uint8_t> to_reach;  // cells near a start that are still to be reached, while its goal is looked for

  World(const Spec& p, const Given& given) : p(p), given(given) {
    margin = static_cast<int>(std::sqrt(static_cast<double>(std::max(p.clearance_d2, p.near_d2)))) + 2;
    stride = p.width + 2 * margin;
    n_cells = stride * (p.height + 2 * margin);
    near = Disc(p.near_d2, stride);
    clearance = Disc(p.clearance_d2, stride);
    FindClear();
    FindParts();
  }

  int Cell(int row, int col) const { return (row + margin) * stride + col + margin; }
  int Flat(int cell) const { return (cell / stride - margin) * p.width + cell % stride - margin; }
  bool IsWall(int flat) const { return given.occupied[flat] != 0; }
  bool IsWithin(int flat) const { return !given.within || given.within[flat]; }
  bool MayEnter(int flat) const { return !IsWall(flat) && IsWithin(flat); }

  template <class Use>
  void ForAll(Use use) const {
    for (int row = 0; row < p.height; ++row)
      for (int col = 0; col < p.width; ++col) use(row * p.width + col, Cell(row, col));
  }

  void FindClear() {
    is_clear.assign(n_cells, 0);
    ForAll([&](int flat, int cell) { is_clear[cell] = MayEnter(flat); });
    ForAll([&](int flat, int cell) {
      if (IsWall(flat) && IsBesideFloor(flat))  // one of these is at least as near as a wall behind it
        for (int offset : clearance) is_clear[cell + offset] = 0;
    });
  }

  bool IsBesideFloor(int flat) const {
    const int row = flat / p.width, col = flat % p.width;
    return (row > 0 && !IsWall(flat - p.width)) || (row + 1 < p.height && !IsWall(flat + p.width)) ||
           (col > 0 && !IsWall(flat - 1)) || (col + 1 < p.width && !IsWall(flat + 1));
  }

  // 4-connected parts: a diagonal step needs both cells beside it.
  void FindParts() {
    part.assign(n_cells, -1);
    const int sides[4] = {1, -1, stride, -stride};
    ForAll([&](int, int seed) {
      if (!is_clear[seed] || part[seed] >= 0) return;
      std::vector<int32_t> cells{seed};
      part[seed] = static_cast<int32_t>(parts.size());
      for (size_t i = 0; i < cells.size(); ++i)
        for (int side : sides) {
          const int cell = cells[i] + side;
          if (is_clear[cell] && part[cell] < 0) part[cell] = part[seed], cells.push_back(cell);
        }
      parts.push_back(std::move(cells));
    });
  }

  // The number of what is to be known from a start, in `goals`: the parts to which a way leads over clear cells and
  // the free ones near the start.
  int GoalOf(int start) {
    const int beside[5] = {0, 1, -1, stride, -stride};
    std::vector<int32_t> found, waiting, reached{start};
    to_reach.resize(n_cells);
    for (int offset : near) {
      const int cell = start + offset;
      if (cell == start || !Holds(cell) || !MayEnter(Flat(cell))) continue;
      to_reach[cell] = 1;
      waiting.push_back(cell);
    }
    auto reach = [&](int cell) {
      if (to_reach[cell]) to_reach[cell] = 0, reached.push_back(cell);
    };
    auto touches = [&](int cell, int number) {
      return std::any_of(beside, beside + 5, [&](int side) { return part[cell + side] == number; });
    };
    for (size_t i = 0; i < reached.size(); ++i)
      for (int side : beside) {
        const int cell = reached[i] + side, number = part[cell];
        reach(cell);
        if (number < 0 || std::find(found.begin(), found.end(), number) != found.end()) continue;
        found.push_back(number);
        for (int other : waiting)
          if (to_reach[other] && touches(other, number)) reach(other);
      }
    for (int cell : waiting) to_reach[cell] = 0;
    std::sort(found.begin(), found.end());
    const auto [at, is_new] = goal_of.try_emplace(found, static_cast<int32_t>(goals.size()));
    if (is_new) goals.push_back(found);
    return at->second;
  }

  // Fills in goal and region of some tasks.
  void FindGoals(Task* tasks, int64_t n) {
    std::map<int, int> found;
    for (int64_t i = 0; i < n; ++i) {
      const int start = Cell(tasks[i].row, tasks[i].col);
      const auto known = found.find(start);
      tasks[i].goal = known != found.end() ? known->second : found.emplace(start, GoalOf(start)).first->second;
      tasks[i].region = given.region[tasks[i].row * p.width + tasks[i].col];
    }
  }

  bool Holds(int cell) const {
    const int row = cell / stride - margin, col = cell % stride - margin;
    return row >= 0 && row < p.height && col >= 0 && col < p.width;
  }

  // Whether no clear cell but the start itself can be reached.
  bool IsStuck(int start, int goal) const {
    size_t others = 0;
    for (int number : goals[goal]) others += parts[number].size();
    return IsWall(Flat(start)) || others <= static_cast<size_t>(is_clear[start]);
  }

  // Cells that a scanner can come to know of a region, and those of them that are free: `{knowable, explorable}`.
  std::pair<int, int> Count(int region) const {
    int knowable = 0, explorable = 0;
    auto is_own = [&](int row, int col) {
      const int flat = row * p.width + col;
      return row >= 0 && row < p.height && col >= 0 && col < p.width && !IsWall(flat) && given.region[flat] == region;
    };
    for (int row = 0; row < p.height; ++row)
      for (int col = 0; col < p.width; ++col) {
        const int flat = row * p.width + col;
        explorable += is_own(row, col);
        knowable += is_own(row, col) || (IsWall(flat) && IsWithin(flat) && (is_own(row, col + 1) || is_own(row + 1, col) ||
                                                                            is_own(row, col - 1) || is_own(row - 1, col)));
      }
    return {knowable, explorable};
  }
};

}  // namespace jexplore
