// What a robot knows, a byte a cell: for one core of a CPU.
//
// Kept up to date where a cell comes to be known, so that no plan looks at the whole map: of every cell the occupied
// ones within the clearance, and the unknown ones at its side.

#pragma once

#include <cstring>
#include <vector>

#include "paths.h"
#include "world.h"

namespace jexplore {

enum Counting { kKnownOnly, kCounts, kChanges };  // known or not; hits and misses as well; and classes that change

// `counting`: a scanner without noise never changes its mind about a cell, unless the robot began with a map.
template <Counting counting>
struct ByteMaps : Paths {
  static constexpr uint8_t kFree = 1, kOccupied = 2, kSeen = kFree | kOccupied, kWall = 4, kOutside = 8;

  const World& world;
  const Spec& p;
  const volatile int32_t* stop;  // not 0: the episode is to be given up
  std::vector<uint8_t> cell, blank_cell, blank_mark;
  std::vector<int32_t> walls, blank_walls;        // occupied cells within the clearance
  std::vector<int8_t> unknown, blank_unknown;     // unknown cells at the side that are to be known
  std::vector<int32_t> hits, misses, blank_hits, blank_misses;
  std::vector<int32_t> candidates;
  std::vector<int8_t> way;  // motions, the last one first
  int n_known = 0, blank_known = 0;

  ByteMaps(const World& world, const volatile int32_t* stop)
      : Paths(world.stride, world.n_cells), world(world), p(world.p), stop(stop), cell(world.n_cells, kWall | kOutside),
        walls(world.n_cells), unknown(world.n_cells), way(world.n_cells) {
    if (counting != kKnownOnly) hits.resize(world.n_cells), misses.resize(world.n_cells);
    world.ForAll([&](int flat, int i) {
      cell[i] = (world.IsWall(flat) ? kWall : 0) | (world.IsWithin(flat) ? 0 : kOutside);
      if (world.IsWithin(flat))
        for (int k = 0; k < p.connectivity; ++k) ++unknown[i + offsets[k]];
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
      for (int k = 0; k < p.connectivity; ++k) --unknown[i + offsets[k]];
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

  bool IsFrontier(int i) {
    const auto is_one = [&](int i) { return unknown[i] > 0 && (mark[i] & (kClear | kExhausted)) == kClear; };
    return is_one(i) && IsLarge(i, p.least, is_one);
  }

  // Lays the way to a target and forgets the costs, but for `saturated`: where no target is. The number of its motions.
  int Lay(int from, int target) {
    int n = 0;
    for (int i = target; target != kNone && i != from;) {
      const int k = MotionInto(
          cost[i], [&](int k) { return cost[i - offsets[k]]; }, [&](int k) { return k < 4 || CanMove(i - offsets[k], k); });
      way[n++] = static_cast<int8_t>(k);
      i -= offsets[k];
    }
    if (target == kNone) CountSaturated();
    Forget();
    MarkNear(from, false);
    return n;
  }

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

  // The robot's start, if a path leads there.
  int Home(int from, int home, int& left) {
    bool is_found = false;
    MarkNear(from, true);
    Search(from, [&](int i, int) { is_found |= i == home; }, [&] { return is_found; });
    left = Lay(from, is_found ? home : kNone);
    return is_found ? home : kNone;
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
  std::vector<int32_t> known_after, diagonal_after, time_after, spot, choices;  // choices: [n, 2]

  void Clear() { known_after.clear(), diagonal_after.clear(), time_after.clear(), spot.clear(), choices.clear(); }
  int known(int step) const { return known_after[step]; }
  int diagonal(int step) const { return diagonal_after[step]; }
  int time(int step) const { return time_after[step]; }

  void Step(int step, int known, int diagonal, int at, int time) {
    for (auto* each : {&known_after, &diagonal_after, &time_after, &spot})
      if (static_cast<int>(each->size()) <= step) each->resize(step + 1);
    known_after[step] = known, diagonal_after[step] = diagonal, time_after[step] = time, spot[step] = at;
  }
  void Decide(int plan, int step, int bumped) { choices.resize(2 * plan + 2, kNone), choices[2 * plan + 1] = 16 * step + bumped + 1; }
  void Chosen(int plan, int target, bool is_view) { choices[2 * plan] = target == kNone ? kNone : 2 * target + is_view; }
  void Leave(int, int, int) {}
  bool GoesOn() const { return true; }
};

}  // namespace jexplore
