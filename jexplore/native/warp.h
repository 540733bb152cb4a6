// What a robot knows, a bit a cell: for a warp of a GPU, whose lanes work on it together.
//
// By a compiler for CPUs (without __CUDACC__) the 32 lanes are a loop, phase after phase: the same numbers, which tests
// hold to those of JAX without a GPU. What a lane alone knows is a `PerLane`; a phase ends where all lanes have come.

#pragma once

#include "rules.h"

#ifdef __CUDACC__
#define LANES(lane)                                                                                       \
  {                                                                                                       \
    const int lane = threadIdx.x & 31;                                                                    \
    {
#define END_LANES \
  }               \
  }               \
  __syncwarp();
#else
#define LANES(lane) for (int lane = 0; lane < 32; ++lane) {
#define END_LANES }
#endif

namespace jexplore {

constexpr int kMaxRadius = 31;      // cells: what counts round a cell lies in its word and those beside it
constexpr int kBucket = 512;        // cells of a bucket of the search in shared memory, whole warps; the rest lies in the GPU's
constexpr uint32_t kUnreached = kFar;

#ifdef __CUDACC__
template <class T>
struct PerLane {
  T value;
  DEVICE T& operator[](int) { return value; }
};
DEVICE int Sum(PerLane<int>& x) { return __reduce_add_sync(~0u, x.value); }
DEVICE uint32_t Least(PerLane<uint32_t>& x) { return __reduce_min_sync(~0u, x.value); }
DEVICE uint32_t Ballot(PerLane<int>& x) { return __ballot_sync(~0u, x.value); }
DEVICE uint32_t OrAt(uint32_t* at, uint32_t bits) { return atomicOr(at, bits); }
DEVICE uint32_t MinAt(uint32_t* at, uint32_t value) { return atomicMin(at, value); }
DEVICE int AddAt(int* at, int n) { return atomicAdd(at, n); }
DEVICE uint32_t Fresh(const uint32_t* at) { return __ldcg(at); }  // atomics go past the first cache
DEVICE int Bits(uint32_t x) { return __popc(x); }
DEVICE int LowestBit(uint32_t x) { return __ffs(x) - 1; }
DEVICE uint32_t Shifted(uint32_t low, uint32_t high, int by) { return __funnelshift_r(low, high, by); }
#else
template <class T>
struct PerLane {
  T value[32];
  T& operator[](int lane) { return value[lane]; }
};
inline int Sum(PerLane<int>& x) {
  int sum = 0;
  for (int value : x.value) sum += value;
  return sum;
}
inline uint32_t Least(PerLane<uint32_t>& x) {
  uint32_t least = x.value[0];
  for (uint32_t value : x.value) least = value < least ? value : least;
  return least;
}
inline uint32_t Ballot(PerLane<int>& x) {
  uint32_t bits = 0;
  for (int lane = 0; lane < 32; ++lane) bits |= static_cast<uint32_t>(x.value[lane] != 0) << lane;
  return bits;
}
inline uint32_t OrAt(uint32_t* at, uint32_t bits) {
  const uint32_t old = *at;
  *at |= bits;
  return old;
}
inline uint32_t MinAt(uint32_t* at, uint32_t value) {
  const uint32_t old = *at;
  if (value < old) *at = value;
  return old;
}
inline int AddAt(int* at, int n) {
  const int old = *at;
  *at += n;
  return old;
}
inline uint32_t Fresh(const uint32_t* at) { return *at; }
inline int Bits(uint32_t x) { return __builtin_popcount(x); }
inline int LowestBit(uint32_t x) { return __builtin_ctz(x); }
inline uint32_t Shifted(uint32_t low, uint32_t high, int by) { return by ? low >> by | high << (32 - by) : low; }
#endif

DEVICE int Min(int a, int b) { return a < b ? a : b; }
DEVICE int Max(int a, int b) { return a > b ? a : b; }

// What a scan with a heading can show: words of rows, relative to the robot's.
struct Box {
  int32_t row, n_rows, col, n_words;  // first row; rows; first column; words of a row
  int32_t at;                         // words before it, of the views of one cell
};

// A world as warps read it. Maps are `[H, n_words]` words of 32 columns; the margin right of the world is wall.
struct WarpWorld {
  Spec p;
  int32_t n_rest;                       // cells of a bucket beyond `kBucket`; where it overflows the episode is given up
  int32_t row_words, n_words, n_cells;  // an odd number of words a row: rows then lie in different banks
  const uint32_t *truth, *inside;       // walls; where the robot may be and what it is to know
  const int32_t* rooms;                 // [n_cells], or null
  const uint32_t *goals, *regions;      // [G, n_words], [R, n_words]: what is to be known; explorable cells
  const int32_t* counts;                // [R, 2]: knowable, explorable cells
  const int32_t *way, *length;          // as in `Beams`
  const uint32_t* is_row;
  int32_t beam_words;
  const int32_t* view_of;   // [n_cells], number of a free cell; -1
  const uint32_t* views;    // [free cells, words of all boxes], cells that a scan shows; null: beams are traced
  const uint32_t* extents;  // [free cells, 8], first and last row of a view that shows a cell: low, high half
  Box box[8];
  int32_t view_words;
  int32_t radius, near_radius;                           // of the discs, cells
  int8_t half[kMaxRadius + 1], near_half[kMaxRadius + 1];  // half their width, row by row from the centre
};

// Memory of a warp: shared first, then the GPU's. Maps in shared memory would leave room for half as many warps, and took
// 1.7 times the time on an H100.
template <class Cell>
struct WarpMemory {
  uint32_t* stale;                // [ceil(n_words / 32)], words of which the masks must be made again
  Cell* queue;                    // [3, kBucket]
  int* count;                     // [4], cells in each bucket; cells touched

  uint32_t* known;               // [n_words], which atomics change behind the back of the first cache
  uint32_t *can, *front;         // [n_words], traversable (but near the robot) and frontier cells
  uint32_t *driven, *exhausted;  // [n_words]
  uint32_t* cost;                // [n_cells], kUnreached but during a search
  Cell* touched;                 // [n_cells]
  Cell* rest;                    // [3, n_rest], cells of the search beyond those of `queue`
  int8_t* way;                   // [n_cells], motions, the last one first
  uint32_t* saved;               // [63 * 3], words of `can` without the cells near the robot
};

// Cells of a beam, as `ByteMaps::Trace`.
template <class Use>
DEVICE bool TraceBeam(const WarpWorld& w, int from, int beam, Use use) {
  const int along = w.way[2 * beam], across = w.way[2 * beam + 1] * w.row_words * 32;
  const uint32_t* words = w.is_row + static_cast<int64_t>(beam) * w.beam_words;
  uint32_t word = 0;
  for (int step = 0, i = from, n = w.length[beam]; step < n; ++step, word >>= 1) {
    if (step % 32 == 0) word = words[step / 32];
    i += word & 1 ? across : along;
    if (use(i)) return true;
  }
  return false;
}

DEVICE bool IsSet(const uint32_t* bits, int i) { return bits[i >> 5] >> (i & 31) & 1; }

// Marks what a beam shows, `mark(cell)`.
template <class Mark>
DEVICE void ShowBeam(const WarpWorld& w, int from, int beam, Mark mark) {
  const auto stops = [&](int i) { return IsSet(w.truth, i); };
  if (!w.p.no_echo_is_free && !TraceBeam(w, from, beam, stops)) return;
  TraceBeam(w, from, beam, [&](int i) {
    mark(i);
    return stops(i);
  });
}

// The view of one scan: a warp writes its words, `[words of a row][rows]`, and its extent. `bits`: as many words.
DEVICE void MakeView(const WarpWorld& w, int cell, int heading, uint32_t* bits, uint32_t* view, uint32_t* extent) {
  const Box& box = w.box[heading];
  const int width = w.row_words * 32, row = cell / width, word = (cell % width + box.col) >> 5;
  const int n = box.n_rows * box.n_words;
  LANES(lane)
  for (int i = lane; i < n; i += 32) bits[i] = 0;
  END_LANES
  const auto mark = [&](int i) {
    OrAt(&bits[((i % width >> 5) - word) * box.n_rows + i / width - row - box.row], 1u << (i & 31));
  };
  LANES(lane)
  if (lane == 0) mark(cell);
  for (int beam = lane; beam < w.p.n_beams; beam += 32) ShowBeam(w, cell, heading * w.p.n_beams + beam, mark);
  END_LANES
  PerLane<uint32_t> first, after;  // the lowest; and how far the highest is from the end
  LANES(lane)
  first[lane] = after[lane] = box.n_rows;
  for (int i = lane; i < n; i += 32) {
    view[i] = bits[i];
    if (!bits[i]) continue;
    first[lane] = Min(first[lane], i % box.n_rows);
    after[lane] = Min(after[lane], box.n_rows - 1 - i % box.n_rows);
  }
  END_LANES
  const uint32_t low = Least(first), high = box.n_rows - 1 - Least(after);
  LANES(lane)
  if (lane == 0) *extent = low | high << 16;
  END_LANES
}

// Parts of an episode of which the time is told.
enum Part { kScanning, kJudging, kSearching, kLaying, kParts };

template <class Cell>
struct WarpMaps {
  const WarpWorld& w;
  const Spec& p;
  WarpMemory<Cell> m;
  int n_known = 0, width;
  bool goes_on = true;
#ifdef JEXPLORE_CLOCKS
  long long clocks[kParts] = {}, since = 0;
  DEVICE void Begins() { since = clock64(); }
  DEVICE void Ends(Part part) { clocks[part] += clock64() - since; }
#else
  DEVICE void Begins() {}
  DEVICE void Ends(Part) {}
#endif

  DEVICE uint32_t Known(int word) const { return Fresh(&m.known[word]); }
  DEVICE bool IsKnown(int i) const { return Known(i >> 5) >> (i & 31) & 1; }

  DEVICE WarpMaps(const WarpWorld& w, const WarpMemory<Cell>& m) : w(w), p(w.p), m(m), width(w.row_words * 32) {}

#ifdef __CUDACC__
  DEVICE int Lane() const { return threadIdx.x & 31; }
  DEVICE int Lanes() const { return 32; }
#else
  int Lane() const { return 0; }
  int Lanes() const { return 1; }
#endif
  DEVICE int Row(int i) const { return i / width; }
  DEVICE int Col(int i) const { return i % width; }
  DEVICE int At(int row, int col) const { return row * width + col; }
  DEVICE int Flat(int i) const { return i; }
  DEVICE int Offset(int motion) const { return DRow(motion) * width + DCol(motion); }
  DEVICE int Room(int i) const { return w.rooms ? w.rooms[i] : kNone; }
  DEVICE int Motion(int, int left) const { return left < 0 ? 0 : m.way[left]; }
  DEVICE int known() const { return n_known; }
  DEVICE bool GoesOn() const { return goes_on; }
  DEVICE int Knowable(int region) const { return w.counts[2 * region]; }
  DEVICE int Explorable(int region) const { return w.counts[2 * region + 1]; }
  DEVICE int Saturated() const { return 0; }  // an episode with costs that hardly fit is given up

  DEVICE void Begin(int start) {
    n_known = 0;
    goes_on = true;
    LANES(lane)
    for (int i = lane; i < w.n_words; i += 32)
      m.known[i] = m.can[i] = m.front[i] = m.driven[i] = m.exhausted[i] = 0;
    for (int i = lane; i < (w.n_words + 31) / 32; i += 32) m.stale[i] = 0;
    END_LANES
    Drive(start);
  }

  DEVICE void Drive(int i) {
    const uint32_t bit = 1u << (i & 31);
    LANES(lane)
    if (lane == 0 && w.inside[i >> 5] & bit) m.driven[i >> 5] |= bit, m.can[i >> 5] |= bit;
    END_LANES
  }

  DEVICE void Exhaust(int i) {
    const uint32_t bit = 1u << (i & 31);
    LANES(lane)
    if (lane == 0) m.exhausted[i >> 5] |= bit, m.front[i >> 5] &= ~bit;
    END_LANES
  }

  DEVICE bool IsOpen(int i) const {
    return !IsSet(w.truth, i) && IsSet(w.inside, i) && (IsKnown(i) || IsSet(m.driven, i));
  }

  // A target is clear, so that all cells round it are of the world.
  DEVICE bool IsLive(int target) const {
    PerLane<int> is_unknown;
    LANES(lane)
    const int i = target + Offset(lane & (p.connectivity - 1));
    is_unknown[lane] = IsSet(w.inside, i) && !IsKnown(i);
    END_LANES
    return Ballot(is_unknown) != 0;
  }

  // Adds cells of a word to what is known: how many of them count.
  DEVICE int Learn(int word, uint32_t bits) {
    const uint32_t fresh = bits & ~Known(word);
    if (!fresh) return 0;
    m.known[word] |= fresh;
    OrAt(&m.stale[word >> 5], 1u << (word & 31));
    return Bits(fresh & w.inside[word]);
  }

  DEVICE void Scan(int from, int heading) {
    Begins();
    PerLane<int> fresh;
    if (!w.views) {
      LANES(lane)
      fresh[lane] = 0;
      const auto mark = [&](int i) {
        const uint32_t bit = 1u << (i & 31);
        if (Known(i >> 5) & bit || OrAt(&m.known[i >> 5], bit) & bit) return;
        OrAt(&m.stale[i >> 10], 1u << (i >> 5 & 31));
        fresh[lane] += (w.inside[i >> 5] & bit) != 0;
      };
      if (lane == 0) mark(from);
      for (int beam = lane; beam < p.n_beams; beam += 32) ShowBeam(w, from, heading * p.n_beams + beam, mark);
      END_LANES
    } else {
      const Box& box = w.box[heading];
      const int64_t number = w.view_of[from];
      const uint32_t* view = w.views + number * w.view_words + box.at;
      const uint32_t extent = w.extents[number * 8 + heading];
      const int first = extent & 0xffff, last = extent >> 16, top = Row(from) + box.row, left = (Col(from) + box.col) >> 5;
      LANES(lane)
      fresh[lane] = 0;
      for (int row = first + lane; row <= last; row += 32)  // rows that show a cell are of the world
        for (int k = 0; k < box.n_words; ++k)
          if (const uint32_t bits = view[k * box.n_rows + row]) fresh[lane] += Learn((top + row) * w.row_words + left + k, bits);
      END_LANES
    }
    n_known += Sum(fresh);
    Ends(kScanning);
  }

  // Bits that are set within `half` columns of a bit of `here`; `left` and `right` are the words beside it.
  DEVICE uint32_t Smeared(uint32_t left, uint32_t here, uint32_t right, int half) const {
    uint64_t up = static_cast<uint64_t>(here) << 32 | left, down = static_cast<uint64_t>(right) << 32 | here;
    for (int done = 0; done < half;) {
      const int by = Min(done + 1, half - done);
      up |= up << by;
      down |= down >> by;
      done += by;
    }
    return static_cast<uint32_t>(up >> 32) | static_cast<uint32_t>(down);
  }

  // The masks of one word: clear cells have no wall known within the clearance, frontier cells an unknown one beside.
  DEVICE void Judge(int word) {
    const int row = word / w.row_words, col = word % w.row_words;
    uint32_t blocked = 0, unseen = 0;
    for (int dy = -Max(w.radius, 1); dy <= Max(w.radius, 1); ++dy) {
      const int y = row + dy, far = dy < 0 ? -dy : dy;
      if (y < 0 || y >= p.height) continue;
      const int at = word + dy * w.row_words;
      const bool has_left = col > 0, has_right = col + 1 < w.row_words;
      const uint32_t left = has_left ? Known(at - 1) : 0, here = Known(at), right = has_right ? Known(at + 1) : 0;
      if (far <= w.radius)
        blocked |= Smeared(has_left ? left & w.truth[at - 1] : 0, here & w.truth[at], has_right ? right & w.truth[at + 1] : 0, w.half[far]);
      if (far <= 1)
        unseen |= Smeared(has_left ? ~left & w.inside[at - 1] : 0, ~here & w.inside[at], has_right ? ~right & w.inside[at + 1] : 0,
                          p.connectivity == 8 || far == 0);
    }
    const uint32_t clear = Known(word) & ~w.truth[word] & w.inside[word] & ~blocked;
    m.can[word] = clear | m.driven[word];
    m.front[word] = clear & unseen & ~m.exhausted[word];
  }

  // Makes the masks anew wherever something near has come to be known.
  DEVICE void Refresh() {
    const int reach = Max(w.radius, 1), words = w.row_words;
    int n = 0;  // words in the list
    Cell* list = m.queue;
    for (int first = 0; first < w.n_words; first += 32) {
      PerLane<int> is_stale;
      LANES(lane)
      const int word = first + lane;
      is_stale[lane] = 0;
      if (word < w.n_words) {
        const int row = word / words;
        for (int y = Max(row - reach, 0); y <= Min(row + reach, p.height - 1); ++y) {
          const int at = word + (y - row) * words - 1;  // and two more; beyond a row's ends no cell is free
          const int low = Max(at, 0);
          const uint32_t bits = Shifted(m.stale[low >> 5], low / 32 + 1 < (w.n_words + 31) / 32 ? m.stale[low / 32 + 1] : 0, low & 31);
          is_stale[lane] |= bits & (at < 0 ? 3 : 7);
        }
      }
      END_LANES
      const uint32_t chosen = Ballot(is_stale);
      LANES(lane)
      if (chosen >> lane & 1) list[n + Bits(chosen & ((1u << lane) - 1))] = static_cast<Cell>(first + lane);
      END_LANES
      n += Bits(chosen);
      if (n >= 3 * kBucket - 32 || (first + 32 >= w.n_words && n)) {
        LANES(lane)
        for (int j = lane; j < n; j += 32) Judge(list[j]);
        END_LANES
        n = 0;
      }
    }
    LANES(lane)
    for (int i = lane; i < (w.n_words + 31) / 32; i += 32) m.stale[i] = 0;
    END_LANES
  }

  // Makes the free cells near the robot traversable, or undoes that.
  DEVICE void MarkNear(int from, bool on) {
    const int row = Row(from), col = Col(from), r = w.near_radius, first = Max(col - r, 0) >> 5;
    LANES(lane)
    for (int j = lane; j < 3 * (2 * r + 1); j += 32) {
      const int dy = j / 3 - r, y = row + dy, word = first + j % 3;
      if (y < 0 || y >= p.height || word >= w.row_words) continue;
      const int at = y * w.row_words + word, half = w.near_half[dy < 0 ? -dy : dy];
      if (!on) {
        m.can[at] = m.saved[j];
        continue;
      }
      const int low = Max(col - half - 32 * word, 0), high = Min(col + half - 32 * word, 31);
      m.saved[j] = m.can[at];
      if (low > high) continue;
      const uint32_t near = (~0u >> (31 - high)) & (~0u << low);
      m.can[at] |= near & Known(at) & ~w.truth[at] & w.inside[at];
    }
    END_LANES
  }

  // Three cells of a row of `can`, beginning at one.
  DEVICE uint32_t Three(int cell) const { return Shifted(m.can[cell >> 5], m.can[(cell >> 5) + 1], cell & 31) & 7; }

  DEVICE Cell& Queued(int bucket, int slot) const {
    return slot < kBucket ? m.queue[bucket * kBucket + slot] : m.rest[bucket * w.n_rest + slot - kBucket];
  }

  // Costs from a cell in order of whole straight steps. With `first_only` it ends with the step in which the first
  // frontier cell is found: the cheapest of it, and of equal ones the first; kNone.
  DEVICE int Search(int from, bool first_only) {
    LANES(lane)
    if (lane == 0) {
      m.cost[from] = 0;
      m.queue[0] = m.touched[0] = static_cast<Cell>(from);
      m.count[0] = m.count[3] = 1;
      m.count[1] = m.count[2] = 0;
    }
    END_LANES
    for (int level = 0, idle = 0; idle < 3; ++level) {
      const int own = level % 3, n = m.count[own];
      idle = n ? 0 : idle + 1;
      if (n > kBucket + w.n_rest) goes_on = false;
      if (!goes_on || level >= (kFar >> 16) - 2) {  // costs that hardly fit are for a CPU
        goes_on = false;
        return kNone;
      }
      if (!n) continue;
      PerLane<uint32_t> cheapest, which;
      LANES(lane)
      cheapest[lane] = kUnreached, which[lane] = ~0u;
      END_LANES
      for (int first = 0; first < n; first += 32) {
        LANES(lane)
        if (first + lane < n) Visit(Queued(own, first + lane), level, first_only, cheapest[lane], which[lane]);
        END_LANES
      }
      LANES(lane)
      if (lane == 0) m.count[own] = 0;
      END_LANES
      if (!first_only) continue;
      const uint32_t best = Least(cheapest);
      if (best == kUnreached) continue;
      LANES(lane)
      if (cheapest[lane] != best) which[lane] = ~0u;
      END_LANES
      return Least(which);
    }
    return kNone;
  }

  DEVICE void Visit(int i, int level, bool first_only, uint32_t& cheapest, uint32_t& which) {
    const uint32_t here = Fresh(&m.cost[i]);
    if (static_cast<int>(here >> 16) != level) return;  // it was reached by a cheaper way since
    if (first_only && IsSet(m.front, i) && (here < cheapest || (here == cheapest && static_cast<uint32_t>(i) < which)))
      cheapest = here, which = i;
    const uint32_t south = Three(i - width - 1), middle = Three(i - 1), north = Three(i + width - 1);
    const uint32_t e = middle >> 2, n = north >> 1 & 1, w_ = middle & 1, s = south >> 1 & 1;
    const uint32_t open = e | n << 1 | w_ << 2 | s << 3 | (n & e & north >> 2) << 4 | (n & w_ & north) << 5 |
                          (s & w_ & south) << 6 | (s & e & south >> 2) << 7;
    uint32_t before[8];
#ifdef __CUDACC__
#pragma unroll
#endif
    for (int k = 0; k < 8; ++k) before[k] = open >> k & 1 ? Fresh(&m.cost[i + Offset(k)]) : 0;
#ifdef __CUDACC__
#pragma unroll
#endif
    for (int k = 0; k < 8; ++k) {
      const uint32_t to = here + (k < 4 ? kStraight : kDiagonal);
      if (to >= before[k]) continue;
      const int cell = i + Offset(k);
      const uint32_t old = MinAt(&m.cost[cell], to);
      if (to >= old) continue;
      if (old == kUnreached) m.touched[AddAt(&m.count[3], 1)] = static_cast<Cell>(cell);
      if (old >> 16 == to >> 16) continue;
      const int bucket = (to >> 16) % 3, slot = AddAt(&m.count[bucket], 1);
      if (slot < kBucket + w.n_rest) Queued(bucket, slot) = static_cast<Cell>(cell);
    }
  }

  // Lays the way to a target and forgets the costs; the number of its motions.
  DEVICE int Lay(int from, int target) {
    Begins();
    int n = 0;
    for (int i = target; target != kNone && i != from;) {
      PerLane<int> fits;
      const uint32_t own = Fresh(&m.cost[i]);
      LANES(lane)
      const int k = lane & 7, back = i - Offset(k);
      fits[lane] = lane < 8 && Fresh(&m.cost[back]) + (k < 4 ? kStraight : kDiagonal) == own &&
                   (k < 4 || (IsSet(m.can, i - DRow(k) * width) && IsSet(m.can, i - DCol(k))));
      END_LANES
      const int k = LowestBit(Ballot(fits));
      LANES(lane)
      if (lane == 0) m.way[n] = static_cast<int8_t>(k);
      END_LANES
      ++n;
      i -= Offset(k);
    }
    Forget(from);
    Ends(kLaying);
    return n;
  }

  DEVICE void Forget(int from) {
    const int n = m.count[3];
    LANES(lane)
    for (int j = lane; j < n; j += 32) m.cost[m.touched[j]] = kUnreached;
    END_LANES
    MarkNear(from, false);
  }

  DEVICE int Nearest(int from, int& left) {
    Prepare(from);
    Begins();
    const int target = Search(from, true);
    Ends(kSearching);
    left = Lay(from, target);
    return target;
  }

  DEVICE int Home(int from, int home, int& left) {
    Prepare(from);
    Search(from, false);
    const int target = goes_on && Fresh(&m.cost[home]) < kUnreached ? home : kNone;
    left = Lay(from, target);
    return target;
  }

  DEVICE void Prepare(int from) {
    Begins();
    Refresh();
    MarkNear(from, true);
    Ends(kJudging);
  }

  DEVICE int Uniform(int from, int& left, Key key) {
    Prepare(from);
    Begins();
    Search(from, false);
    const int n = goes_on ? CountReached(~0u) : 0;
    const int target = n ? CountReached(RandomBelow(key, n)) : kNone;
    Ends(kSearching);
    left = Lay(from, target);
    return target;
  }

  // Frontier cells that have been reached; or, below that number, the k-th of them in (row, col) order.
  DEVICE int CountReached(uint32_t k) {
    int before = 0;
    for (int first = 0; first < w.n_words; first += 32) {
      PerLane<int> own;
      PerLane<uint32_t> bits;
      LANES(lane)
      const int word = first + lane;
      uint32_t left = word < w.n_words ? m.front[word] : 0;
      bits[lane] = 0;
      for (; left; left &= left - 1) {
        const uint32_t bit = left & (0u - left);
        if (Fresh(&m.cost[32 * word + LowestBit(bit)]) < kUnreached) bits[lane] |= bit;
      }
      own[lane] = Bits(bits[lane]);
      END_LANES
      const int here = Sum(own);
      if (k != ~0u && static_cast<uint32_t>(before + here) > k) {
        for (int j = 0; j < 32; ++j) {
          PerLane<int> only;
          PerLane<uint32_t> word_bits;
          LANES(lane)
          only[lane] = lane == j ? own[lane] : 0;
          word_bits[lane] = lane == j ? bits[lane] : ~0u;
          END_LANES
          const int in_word = Sum(only);
          uint32_t left = Least(word_bits);
          if (in_word == 0 || static_cast<uint32_t>(before + in_word) <= k) {
            before += in_word;
            continue;
          }
          for (; static_cast<uint32_t>(before) < k; ++before) left &= left - 1;
          return 32 * (first + j) + LowestBit(left);
        }
      }
      before += here;
    }
    return before;
  }

  DEVICE bool KnowsGoal(int goal) const {
    PerLane<int> is_missed;
    LANES(lane)
    is_missed[lane] = 0;
    for (int i = lane; i < w.n_words; i += 32)
      is_missed[lane] |= (w.goals[static_cast<int64_t>(goal) * w.n_words + i] & ~Known(i)) != 0;
    END_LANES
    return Ballot(is_missed) == 0;
  }

  DEVICE int Explored(int region) const {
    PerLane<int> n;
    LANES(lane)
    n[lane] = 0;
    for (int i = lane; i < w.n_words; i += 32)
      n[lane] += Bits(w.regions[static_cast<int64_t>(region) * w.n_words + i] & Known(i));
    END_LANES
    return Sum(n);
  }
};

// Known cells, diagonal steps and time after each step; an episode of more steps than fit is given up.
struct WarpLog {
  int32_t* steps;  // [capacity, 3]
  int capacity;
  bool fits = true;

  DEVICE WarpLog(int32_t* steps, int capacity) : steps(steps), capacity(capacity) {}
  DEVICE int known(int step) const { return steps[3 * step]; }
  DEVICE int diagonal(int step) const { return steps[3 * step + 1]; }
  DEVICE int time(int step) const { return steps[3 * step + 2]; }
  DEVICE bool GoesOn() const { return fits; }
  DEVICE void Step(int step, int known, int diagonal, int, int time) {
    if (step >= capacity) fits = false;
    LANES(lane)
    if (lane == 0 && fits) steps[3 * step] = known, steps[3 * step + 1] = diagonal, steps[3 * step + 2] = time;
    END_LANES
  }
  DEVICE void Decide(int, int, int) {}
  DEVICE void Chosen(int, int, bool) {}
  DEVICE void Leave(int, int, int) {}
};

}  // namespace jexplore
