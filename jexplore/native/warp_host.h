// A world and the tasks of a batch as warps read them, made ready on the host.

#pragma once

#include "warp.h"
#include "world.h"

namespace jexplore {

struct HostWorld {
  WarpWorld w{};
  std::vector<uint32_t> truth, inside, goals, regions;
  std::vector<int32_t> rooms, counts, view_of;
  std::vector<Task> tasks;
  std::vector<uint8_t> is_stuck;
  int n_free = 0;

  static bool Suits(const World& world) {
    return !world.given.prior && world.p.least <= 1 && world.p.clearance_d2 <= kMaxRadius * kMaxRadius && world.p.near_d2 <= kMaxRadius * kMaxRadius;
  }

  // `tasks`: with their goals, of `World::GoalOf`, and regions.
  HostWorld(const World& world, const Task* given, int64_t n) : tasks(given, given + n) {
    const Spec& p = w.p = world.p;
    w.row_words = (p.width + 31) / 32 | 1;
    w.n_words = p.height * w.row_words;
    w.n_cells = 32 * w.n_words;
    w.n_rest = w.n_cells / 16;  // a wave through an open square of n cells has some 4 sqrt(n) at once
    truth.assign(w.n_words, ~0u), inside.assign(w.n_words, 0), view_of.assign(w.n_cells, -1);
    if (std::any_of(world.given.rooms, world.given.rooms + p.height * p.width, [](int room) { return room >= 0; }))
      rooms.assign(w.n_cells, -1);
    ForAll(world, [&](int flat, int, int word, uint32_t bit) {
      const int w_cell = flat / p.width * 32 * w.row_words + flat % p.width;
      if (!rooms.empty()) rooms[w_cell] = world.given.rooms[flat];
      if (world.IsWithin(flat)) inside[word] |= bit;
      if (world.IsWall(flat)) return;
      truth[word] &= ~bit;
      view_of[w_cell] = n_free++;
    });
    for (const auto& parts : world.goals) AddGoal(world, parts);
    std::map<int32_t, int32_t> number;
    for (Task& task : tasks) {
      is_stuck.push_back(world.IsStuck(world.Cell(task.row, task.col), task.goal));
      const auto [at, is_new] = number.try_emplace(task.region, static_cast<int32_t>(number.size()));
      if (is_new) AddRegion(world, task.region);
      task.region = at->second;
    }
    w.radius = Halves(p.clearance_d2, w.half);
    w.near_radius = Halves(p.near_d2, w.near_half);
    FindBoxes(world.given.beams);
    Point(world.given.beams);
  }

  // Calls `use(flat, cell of the world, word, bit)`.
  template <class Use>
  void ForAll(const World& world, Use use) const {
    world.ForAll([&](int flat, int cell) {
      const int row = flat / w.p.width, col = flat % w.p.width;
      use(flat, cell, row * w.row_words + col / 32, 1u << col % 32);
    });
  }

  void AddGoal(const World& world, const std::vector<int32_t>& parts) {
    const size_t first = goals.size();
    goals.resize(first + w.n_words);
    ForAll(world, [&](int, int cell, int word, uint32_t bit) {
      if (std::find(parts.begin(), parts.end(), world.part[cell]) != parts.end()) goals[first + word] |= bit;
    });
  }

  void AddRegion(const World& world, int32_t region) {
    const size_t first = regions.size();
    regions.resize(first + w.n_words);
    ForAll(world, [&](int flat, int, int word, uint32_t bit) {
      if (!world.IsWall(flat) && world.given.region[flat] == region) regions[first + word] |= bit;
    });
    const auto [knowable, explorable] = world.Count(region);
    counts.push_back(knowable), counts.push_back(explorable);
  }

  static int Halves(int d2, int8_t* half) {
    int radius = 0;
    while ((radius + 1) * (radius + 1) <= d2) ++radius;
    for (int dy = 0; dy <= radius; ++dy)
      for (half[dy] = 0; (half[dy] + 1) * (half[dy] + 1) + dy * dy <= d2;) ++half[dy];
    return radius;
  }

  void FindBoxes(const Beams& beams) {
    w.view_words = 0;
    for (int heading = 0; heading < 8; ++heading) {
      int low_row = 0, high_row = 0, low_col = 0, high_col = 0;
      for (int beam = heading * w.p.n_beams; beam < (heading + 1) * w.p.n_beams; ++beam) {
        int row = 0, col = 0;
        for (int step = 0; step < beams.length[beam]; ++step) {
          const bool is_row = beams.is_row[static_cast<size_t>(beam) * beams.n_words + step / 32] >> step % 32 & 1;
          (is_row ? row : col) += beams.way[2 * beam + is_row];
        }
        low_row = std::min(low_row, row), high_row = std::max(high_row, row);
        low_col = std::min(low_col, col), high_col = std::max(high_col, col);
      }
      w.box[heading] = {low_row, high_row - low_row + 1, low_col, (high_col - low_col + 31) / 32 + 1, w.view_words};
      w.view_words += w.box[heading].n_rows * w.box[heading].n_words;
    }
  }

  int LargestBox() const {
    int most = 0;
    for (const Box& box : w.box) most = std::max(most, box.n_rows * box.n_words);
    return most;
  }

  void Point(const Beams& beams) {
    w.truth = truth.data(), w.inside = inside.data(), w.rooms = rooms.empty() ? nullptr : rooms.data();
    w.goals = goals.data(), w.regions = regions.data(), w.counts = counts.data(), w.view_of = view_of.data();
    w.way = beams.way, w.length = beams.length, w.is_row = beams.is_row, w.beam_words = beams.n_words;
  }

  // Words of memory of a warp: shared, and the GPU's.
  template <class Cell>
  size_t SharedWords() const {
    return (w.n_words + 31) / 32 + 4 + (3 * kBucket * sizeof(Cell) + 3) / 4;
  }
  template <class Cell>
  size_t OtherWords() const {
    const size_t lists = (w.n_cells + 3 * static_cast<size_t>(w.n_rest)) * sizeof(Cell);
    return 5 * w.n_words + w.n_cells + (lists + 3) / 4 + w.n_cells / 4 + 3 * (2 * kMaxRadius + 1);
  }
};

template <class Cell>
DEVICE WarpMemory<Cell> Divide(const WarpWorld& w, uint32_t* shared, uint32_t* other) {
  WarpMemory<Cell> m;
  m.stale = shared;
  m.count = reinterpret_cast<int*>(shared + (w.n_words + 31) / 32);
  m.queue = reinterpret_cast<Cell*>(m.count + 4);
  m.cost = other, m.known = other + w.n_cells, m.can = m.known + w.n_words, m.front = m.can + w.n_words;
  m.driven = m.front + w.n_words, m.exhausted = m.driven + w.n_words, m.saved = m.exhausted + w.n_words;
  m.touched = reinterpret_cast<Cell*>(m.saved + 3 * (2 * kMaxRadius + 1));
  m.rest = m.touched + w.n_cells;
  m.way = reinterpret_cast<int8_t*>(m.rest + 3 * w.n_rest);
  return m;
}

}  // namespace jexplore
