// What a robot knows, a byte a cell: for one core of a CPU.
//
// Kept up to date where a cell comes to be known, so that no plan looks at the whole map: of every cell the occupied
// ones within the clearance, and the unknown ones at its side.

#pragma once

#include <cstring>
#include <vector>

#include "world.h"

namespace jexplore {

enum Counting { kKnownOnly, kCounts, kChanges };  // known or not; hits and misses as well; and classes that change

// `counting`: a scanner without noise never changes its mind about a cell, unless the robot began with a map.
template <Counting counting>
struct ByteMaps {
  static constexpr uint8_t kFree = 1, kOccupied = 2, kSeen = kFree | kOccupied, kWall = 4, kOutside = 8;
  static constexpr uint8_t kClear = 1, kNear = 2, kDriven = 4, kExhausted = 8, kCan = kClear | kNear | kDriven;

  const World& world;
  const Spec& p;
  const volatile int32_t* stop;  // not 0: the episode is to be given up
  std::vector<uint8_t> cell, mark, blank_cell, blank_mark;
  std::vector<int32_t> walls, blank_walls;        // occupied cells within the clearance
  std::vector<int8_t> unknown, blank_unknown;     // unknown cells at the side that are to be known
  std::vector<int32_t> hits, misses, blank_hits, blank_misses;
  std::vector<int32_t> cost, touched, candidates;
  std::vector<int32_t> bucket[3];
  std::vector<int8_t> way;  // motions, the last one first
  int n_touched = 0, n_known = 0, blank_known = 0;
  int offsets[8];

  ByteMaps(const World& world, const volatile int32_t* stop)
      : world(world), p(world.p), stop(stop), cell(world.n_cells, kWall | kOutside), mark(world.n_cells),
        walls(world.n_cells), unknown(world.n_cells), cost(world.n_cells, kFar), touched(world.n_cells),
        way(world.n_cells) {
    for (auto& cells : bucket) cells.resize(world.n_cells);
    if (counting != kKnownOnly) hits.resize(world.n_cells), misses.resize(world.n_cells);
    for (int k = 0; k < 8; ++k) offsets[k] = DRow(k) * world.stride + DCol(k);
    world.ForAll([&](int flat, int i) {
      cell[i] = (world.IsWall(flat) ? kWall : 0) | (world.IsWithin(flat) ? 0 : kOutside);
      if (world.IsWithin(flat))
        for (int offset : offsets) ++unknown[i + offset];
    });
    if (world.given.prior)
      world.ForAll([&](int flat, int i) {
        if (world.given.prior[flat] >= 0) Observe(i, world.given.prior[flat] > 0);
      });
    blank_cell = cell, blank_mark = mark, blank_walls = walls, blank_unknown = unknown;
    blank_hits = hits, blank_misses = misses, blank_known = n_known;
  }

  int Lane() const { return 0; }
  int Lanes() const { return 1; }
  int Row(int i) const { return i / world.stride; }
  int Col(int i) const { return i % world.stride; }
  int At(int row, int col) const { return world.Cell(row, col); }
  int Flat(int i) const { return world.Flat(i); }
  int Offset(int motion) const { return offsets[motion]; }
  int Room(int i) const { return world.given.rooms[Flat(i)]; }
  int Motion(int, int left) const { return left < 0 ? 0 : way[left]; }
  int known() const { return n_known; }
  bool GoesOn() const { return *stop == 0; }
  bool IsLive(int i) const { return unknown[i] > 0; }
  bool IsOpen(int i) const {
    return !(cell[i] & (kWall | kOutside)) && (cell[i] & kFree || mark[i] & kDriven);
  }
  void Drive(int i) {
    if (!(cell[i] & kOutside)) mark[i] |= kDriven;
  }
  void Exhaust(int i) { mark[i] |= kExhausted; }

  void Begin(int start) {
    cell = blank_cell, mark = blank_mark, walls = blank_walls, unknown = blank_unknown;
    hits = blank_hits, misses = blank_misses, n_known = blank_known;
    Drive(start);
  }

  // A cell of which nothing was known is free, or occupied.
  void Enter(int i, uint8_t as) {
    cell[i] |= as;
    if (!(cell[i] & kOutside)) {
      ++n_known;
      for (int offset : offsets) --unknown[i + offset];
    }
    Judge(i, as);
  }

  // What the class of a cell means for those round it.
  void Judge(int i, uint8_t as) {
    if (as == kOccupied) {
      for (int offset : world.clearance) ++walls[i + offset], mark[i + offset] &= ~kClear;
    } else if (walls[i] == 0 && !(cell[i] & kOutside)) {
      mark[i] |= kClear;
    }
  }

  void Observe(int i, bool is_hit) {
    if (counting != kKnownOnly) ++(is_hit ? hits : misses)[i];
    if (!(cell[i] & kSeen)) {
      Enter(i, is_hit ? kOccupied : kFree);
    } else if (counting == kChanges) {
      Reconsider(i);
    }
  }

  void Reconsider(int i) {
    const bool is_free = static_cast<float>(hits[i]) <= p.p_free * static_cast<float>(hits[i] + misses[i]);
    const uint8_t as = is_free ? kFree : kOccupied;
    if (cell[i] & as) return;
    cell[i] ^= kSeen;
    if (is_free) {
      for (int offset : world.clearance) {
        const int j = i + offset;
        if (--walls[j] == 0 && (cell[j] & (kFree | kOutside)) == kFree) mark[j] |= kClear;
      }
    }
    Judge(i, as);
  }

  // Calls `use(cell)` for the cells that a beam enters, until it says that the beam is stopped: whether it did.
  template <class Use>
  bool Trace(int from, int beam, Use use) const {
    const Beams& beams = world.given.beams;
    const int along = beams.way[2 * beam], across = beams.way[2 * beam + 1] * world.stride;
    const uint32_t* words = beams.is_row + static_cast<size_t>(beam) * beams.n_words;
    uint32_t word = 0;
    for (int step = 0, i = from, n = beams.length[beam]; step < n; ++step, word >>= 1) {
      if (step % 32 == 0) word = words[step / 32];
      i += word & 1 ? across : along;
      if (use(i)) return true;
    }
    return false;
  }

  void Scan(int from, int heading) {
    Observe(from, false);
    for (int beam = heading * p.n_beams, end = beam + p.n_beams; beam < end; ++beam) {
      if (!p.no_echo_is_free && !Trace(from, beam, [&](int i) { return (cell[i] & kWall) != 0; })) continue;
      Trace(from, beam, [&](int i) {
        const uint8_t is = cell[i];
        if (is == kFree) {
          if (counting != kKnownOnly) ++misses[i];
          return false;
        }
        if (counting == kKnownOnly && is == (kOccupied | kWall)) return true;
        Observe(i, is & kWall);
        return (is & kWall) != 0;
      });
    }
  }

  // Marks the free cells near the robot, or takes the marks away.
  void MarkNear(int from, bool on) {
    for (int offset : world.near) {
      const int i = from + offset;
      if (!on) mark[i] &= ~kNear;
      else if ((cell[i] & (kFree | kOutside)) == kFree) mark[i] |= kNear;
    }
  }

  bool IsFrontier(int i) const { return unknown[i] > 0 && (mark[i] & (kClear | kExhausted)) == kClear; }

  void Relax(int i, int to, int (&count)[3]) {
    if (to >= cost[i] || to >= kFar) return;
    if (cost[i] == kFar) touched[n_touched++] = i;
    if (cost[i] >> 16 != to >> 16) bucket[(to >> 16) % 3][count[(to >> 16) % 3]++] = i;
    cost[i] = to;
  }

  // Costs from a cell, in order of whole straight steps: no motion within one leads to another of the same. Calls
  // `visit(cell, cost)` for each, which is final, and ends after the step in which `is_done()`.
  template <class Visit, class Done>
  void Search(int from, Visit visit, Done is_done) {
    const int stride = world.stride;
    int count[3] = {1, 0, 0};
    cost[from] = 0, bucket[0][0] = from, touched[0] = from, n_touched = 1;
    for (int level = 0, idle = 0; idle < 3; ++level) {
      const int own = level % 3, n = count[own];
      idle = n ? 0 : idle + 1;
      for (int j = 0; j < n; ++j) {
        const int i = bucket[own][j], here = cost[i];
        if (here >> 16 != level) continue;
        visit(i, here);
        if (is_done()) continue;
        const int straight = here + kStraight, diagonal = here + kDiagonal;
        const bool e = mark[i + 1] & kCan, n_ = mark[i + stride] & kCan, w = mark[i - 1] & kCan, s = mark[i - stride] & kCan;
        if (e) Relax(i + 1, straight, count);
        if (n_) Relax(i + stride, straight, count);
        if (w) Relax(i - 1, straight, count);
        if (s) Relax(i - stride, straight, count);
        if (n_ && e && mark[i + stride + 1] & kCan) Relax(i + stride + 1, diagonal, count);
        if (n_ && w && mark[i + stride - 1] & kCan) Relax(i + stride - 1, diagonal, count);
        if (s && w && mark[i - stride - 1] & kCan) Relax(i - stride - 1, diagonal, count);
        if (s && e && mark[i - stride + 1] & kCan) Relax(i - stride + 1, diagonal, count);
      }
      count[own] = 0;
      if (is_done()) break;
    }
  }

  bool CanMove(int from, int motion) const {
    const int to = from + offsets[motion];
    return mark[to] & kCan && (motion < 4 || (mark[from + DRow(motion) * world.stride] & kCan && mark[from + DCol(motion)] & kCan));
  }

  // Lays the way to a target and forgets the costs, but for `saturated`: where no target is. The number of its motions.
  int Lay(int from, int target) {
    int n = 0;
    for (int i = target; target != kNone && i != from;) {
      int k = 0;
      while (cost[i - offsets[k]] + (k < 4 ? kStraight : kDiagonal) != cost[i] || (k >= 4 && !CanMove(i - offsets[k], k))) ++k;
      way[n++] = static_cast<int8_t>(k);
      i -= offsets[k];
    }
    if (target == kNone) CountSaturated();
    for (int j = 0; j < n_touched; ++j) cost[touched[j]] = kFar;
    MarkNear(from, false);
    return n;
  }

  // Cells one motion beyond those with a cost whose own would not fit.
  void CountSaturated() {
    n_saturated = 0;
    const int n = n_touched;  // what is counted is noted behind
    for (int j = 0; j < n; ++j) {
      const int i = touched[j];
      if (cost[i] < kFar - kDiagonal) continue;
      for (int k = 0; k < 8; ++k) {
        const int to = i + offsets[k];
        if (cost[to] != kFar || !CanMove(i, k)) continue;
        cost[to] = kFar + 1, touched[n_touched++] = to, ++n_saturated;
      }
    }
  }

  int n_saturated = 0;
  int Saturated() const { return n_saturated; }

  // The frontier cell with the shortest path, of equal ones the first.
  int Nearest(int from, int& left) {
    int target = kNone, least = kFar;
    MarkNear(from, true);
    Search(
        from,
        [&](int i, int here) {
          if (IsFrontier(i) && (here < least || (here == least && i < target))) least = here, target = i;
        },
        [&] { return target != kNone; });
    left = Lay(from, target);
    return target;
  }

  // One of the frontier cells that can be reached, drawn.
  int Uniform(int from, int& left, Key key) {
    candidates.clear();
    MarkNear(from, true);
    Search(
        from, [&](int i, int) { if (IsFrontier(i)) candidates.push_back(i); }, [] { return false; });
    int target = kNone;
    if (!candidates.empty()) {
      const auto at = candidates.begin() + RandomBelow(key, static_cast<uint32_t>(candidates.size()));
      std::nth_element(candidates.begin(), at, candidates.end());
      target = *at;
    }
    left = Lay(from, target);
    return target;
  }

  // Every cell as the robot at `from` knows it: 0 unknown, 1 free, 2 occupied, and `frontier` more where a frontier cell
  // can be reached; [H, W].
  void Show(int from, uint8_t frontier, uint8_t* codes) {
    world.ForAll([&](int flat, int i) { codes[flat] = cell[i] & kSeen; });
    MarkNear(from, true);
    Search(
        from, [&](int i, int) { if (IsFrontier(i)) codes[Flat(i)] += frontier; }, [] { return false; });
    Lay(from, from);
  }

  bool KnowsGoal(int goal) const {
    for (int number : world.goals[goal])
      for (int i : world.parts[number])
        if (!(cell[i] & kSeen)) return false;
    return true;
  }

  int Explored(int region) const {
    int n = 0;
    world.ForAll([&](int flat, int i) { n += world.given.region[flat] == region && !(cell[i] & kWall) && cell[i] & kSeen; });
    return n;
  }

  std::map<int, std::pair<int, int>> counts;  // of each region that was asked for
  const std::pair<int, int>& CountsOf(int region) {
    const auto at = counts.find(region);
    return at != counts.end() ? at->second : counts.emplace(region, world.Count(region)).first->second;
  }
  int Knowable(int region) { return CountsOf(region).first; }
  int Explorable(int region) { return CountsOf(region).second; }
};

// What a robot did: every step, and every plan.
struct FullLog {
  std::vector<int32_t> known_after, diagonal_after, spot, choices;  // choices: [n, 2]

  void Clear() { known_after.clear(), diagonal_after.clear(), spot.clear(), choices.clear(); }
  int known(int step) const { return known_after[step]; }
  int diagonal(int step) const { return diagonal_after[step]; }

  void Step(int step, int known, int diagonal, int at) {
    if (static_cast<int>(spot.size()) <= step) known_after.resize(step + 1), diagonal_after.resize(step + 1), spot.resize(step + 1);
    known_after[step] = known, diagonal_after[step] = diagonal, spot[step] = at;
  }
  void Decide(int plan, int step, int bumped) { choices.resize(2 * plan + 2, kNone), choices[2 * plan + 1] = 16 * step + bumped + 1; }
  void Chosen(int plan, int target) { choices[2 * plan] = target == kNone ? kNone : 2 * target; }
  void Leave(int, int, int) {}
  bool GoesOn() const { return true; }
};

}  // namespace jexplore
