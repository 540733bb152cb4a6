// Costs of the shortest paths from a cell, and the way back: for one core of a CPU.

#pragma once

#include <cstdint>
#include <utility>
#include <vector>

#include "rules.h"

namespace jexplore {

// The first motion by which the cost of a cell arises from that of the cell that it comes from; 8 where none does.
template <class Before, class Can>
int MotionInto(int cost, Before before, Can can) {
  int k = 0;
  while (k < 8 && (before(k) + (k < 4 ? kStraight : kDiagonal) != cost || !can(k))) ++k;
  return k;
}

// A map whose outermost cells cannot be entered, rows of which are `stride` apart.
struct Paths {
  static constexpr uint8_t kClear = 1, kNear = 2, kDriven = 4, kExhausted = 8, kCan = kClear | kNear | kDriven;
  static constexpr uint8_t kGrouped = 128;

  int stride, offsets[8], n_touched = 0;  // the first four across edges
  std::vector<uint8_t> mark;
  std::vector<int32_t> cost, touched;  // costs are `kFar` but while a plan is made
  std::vector<int32_t> bucket[3], group;

  Paths(int stride, int n_cells) : stride(stride), mark(n_cells), cost(n_cells, kFar), touched(n_cells) {
    for (auto& cells : bucket) cells.resize(n_cells);
    for (int k = 0; k < 8; ++k) offsets[k] = DRow(k) * stride + DCol(k);
  }

  // Costs from a cell, in order of whole straight steps: no motion within one leads to another of the same. Calls
  // `visit(cell, cost)` for each, which is final, and ends after the step in which `is_done()`.
  template <class Visit, class Done>
  void Search(int from, Visit visit, Done is_done) {
    // Names of its own: to the compiler what is written might be a member.
    const int side = stride;
    const uint8_t* can = mark.data();
    int32_t *least = cost.data(), *seen = touched.data();
    int32_t *now = bucket[0].data(), *next = bucket[1].data(), *last = bucket[2].data();  // after 0, 1 and 2 steps
    int n_now = 1, n_next = 0, n_last = 0, n_seen = 1;
    least[from] = 0, now[0] = seen[0] = from;
    for (int level = 0; n_now + n_next + n_last > 0; ++level) {
      auto relax = [&](int i, int to) {
        const int old = least[i];
        if (to >= old) return;
        if (old == kFar) seen[n_seen++] = i;
        if (old >> 16 != to >> 16) (to >> 16 == level + 1 ? next[n_next++] : last[n_last++]) = i;
        least[i] = to;
      };
      for (int j = 0; j < n_now; ++j) {
        const int i = now[j], here = least[i];
        if (here >> 16 != level) continue;
        visit(i, here);
        if (is_done()) continue;
        const int straight = here + kStraight, diagonal = here + kDiagonal;
        const bool e = can[i + 1] & kCan, n = can[i + side] & kCan, w = can[i - 1] & kCan, s = can[i - side] & kCan;
        if (e) relax(i + 1, straight);
        if (n) relax(i + side, straight);
        if (w) relax(i - 1, straight);
        if (s) relax(i - side, straight);
        if (n && e && can[i + side + 1] & kCan) relax(i + side + 1, diagonal);
        if (n && w && can[i + side - 1] & kCan) relax(i + side - 1, diagonal);
        if (s && w && can[i - side - 1] & kCan) relax(i - side - 1, diagonal);
        if (s && e && can[i - side + 1] & kCan) relax(i - side + 1, diagonal);
      }
      if (is_done()) break;
      std::swap(now, next), std::swap(next, last);
      n_now = n_next, n_next = n_last, n_last = 0;
    }
    n_touched = n_seen;
  }

  // Whether at least n cells, of which `is_one(cell)`, touch each other along edges or corners; one cell of them is given.
  template <class IsOne>
  bool IsLarge(int cell, int n, IsOne is_one) {
    if (n <= 1) return true;
    group.assign(1, cell), mark[cell] |= kGrouped;
    for (size_t j = 0; j < group.size() && static_cast<int>(group.size()) < n; ++j)
      for (int offset : offsets) {
        const int i = group[j] + offset;
        if (!(mark[i] & kGrouped) && is_one(i)) mark[i] |= kGrouped, group.push_back(i);
      }
    for (int i : group) mark[i] &= ~kGrouped;
    return static_cast<int>(group.size()) >= n;
  }

  bool CanMove(int from, int motion) const {
    const int to = from + offsets[motion];
    return mark[to] & kCan && (motion < 4 || (mark[from + DRow(motion) * stride] & kCan &&
                                            mark[from + DCol(motion)] & kCan));
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

  void Forget() {
    for (int j = 0; j < n_touched; ++j) cost[touched[j]] = kFar;
  }
};

}  // namespace jexplore
