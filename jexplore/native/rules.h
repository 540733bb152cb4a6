// The rules of an exploration episode for one robot whose scanner is without noise, for any device.
//
// `exploration/environment.py` and `exploration/episode.py` are the reference; every number here equals theirs. The maps
// are a template argument: `bytes.h` holds a byte a cell for a CPU core, `warp.h` a bit a cell for a warp of a GPU,
// `counts.h` the arrays of a state in JAX.
// Cells are numbers; what lies beside a cell is a fixed number away.

#pragma once

#include <cstdint>

#ifdef __CUDACC__
#define DEVICE __device__ __forceinline__
#else
#define DEVICE inline
#endif

namespace jexplore {

constexpr int kStraight = 1 << 16, kDiagonal = 92682, kFar = 1 << 30;  // `reach.STRAIGHT` and so on
constexpr int kScanMs = 0, kPlanMs = 1, kTurnMs = 2, kRunMs = 7, kStepMs = 14, kMostMs = 1 << 30;  // `motion.SCAN` and so on
constexpr int kStraightLength = 408, kDiagonalLength = 577;  // `motion.LENGTHS`
constexpr int kWhole = 10000, kNever = INT32_MAX;            // `state.WHOLE` and `NEVER`
constexpr int kNone = -1, kMarks = 100, kPercentiles = 4, kLooks = 8, kLookAround = 4;

enum Outcome { kRunning, kComplete, kBlocked, kStepLimit, kPlanLimit, kStuck, kExplored = 10, kPathLimit, kTimeLimit };
enum Chooser { kNearest, kUniform };

// E, N, W, S, NE, NW, SW, SE, as `reach.MOTIONS`.
DEVICE int DRow(int motion) { return motion < 4 ? (motion == 1) - (motion == 3) : (motion < 6 ? 1 : -1); }
DEVICE int DCol(int motion) {
  return motion < 4 ? (motion == 0) - (motion == 2) : (motion == 4 || motion == 7 ? 1 : -1);
}
DEVICE int HeadingOf(int motion) { return motion < 4 ? 2 * motion : 2 * motion - 7; }
DEVICE int Turn(int from, int to) {
  const int turn = (to - from) & 7;
  return turn < 8 - turn ? turn : 8 - turn;
}

// What all episodes of a batch have in common; in the order of `episodes.Spec`.
struct Spec {
  int32_t height, width;                      // of the world with its ring, cells
  int32_t n_beams, first_scans;               // beams of a scan; scans all round at the start
  int32_t clearance_d2, near_d2, arrival_d2;  // cells^2
  int32_t scan_every, max_steps, max_plans;   // cost of the way; steps; plans
  int32_t look_around, recheck, no_echo_is_free;
  int32_t chooser;  // `Chooser`
  int32_t connectivity, least;            // of frontier and unknown cells; cells of the smallest group that is a frontier
  int32_t stop_at, return_home;           // share of `kWhole`, 0: none; bool
  int32_t max_path, max_ms;               // in units of `kStraightLength`, and ms
  float p_free;     // largest reflection probability of a free cell
  int32_t n_clock;
  const int32_t* clock;  // [n_clock], how long motions take: `exploration/motion.py`
};

// What an episode is given.
struct Task {
  int32_t row, col, heading;  // start; heading in units of 45 degrees
  uint32_t seed, draw;        // of which its key is made
  int32_t goal, region;       // numbers among those of the batch
};

// What an episode measured: `exploration.state.Result`, in its order.
struct Result {
  int32_t straight, diagonal, turns, scans, plans, exhausted, outcome, known, explored, explorable, room_entries;
  int32_t straight_at[kPercentiles], diagonal_at[kPercentiles];
  int32_t straight_along[kMarks], diagonal_along[kMarks];
  int32_t saturated, refused, overflow;
  int32_t time, starts, time_at[kPercentiles], time_along[kMarks];
};

struct Key {
  uint32_t a, b;
};

DEVICE uint32_t Rotated(uint32_t x, int by) { return x << by | x >> (32 - by); }

// Threefry-2x32 of 20 rounds (Salmon et al. 2011), as `jax.random` uses it.
DEVICE Key Threefry(Key key, Key count) {
  const uint32_t keys[3] = {key.a, key.b, key.a ^ key.b ^ 0x1BD11BDAu};
  const int rotations[2][4] = {{13, 15, 26, 6}, {17, 29, 16, 24}};
  uint32_t x = count.a + keys[0], y = count.b + keys[1];
  for (int i = 0; i < 5; ++i) {
    for (int k = 0; k < 4; ++k) {
      x += y;
      y = Rotated(y, rotations[i % 2][k]) ^ x;
    }
    x += keys[(i + 1) % 3];
    y += keys[(i + 2) % 3] + i + 1;
  }
  return {x, y};
}

// `jax.random.fold_in`.
DEVICE Key FoldIn(Key key, uint32_t data) { return Threefry(key, {0, data}); }

// `jax.random.randint(key, (), 0, span)` of int32.
DEVICE uint32_t RandomBelow(Key key, uint32_t span) {
  const Key high = Threefry(Threefry(key, {0, 0}), {0, 0}), low = Threefry(Threefry(key, {0, 1}), {0, 0});
  const uint32_t factor = 65536u % span * (65536u % span) % span;
  return (((high.a ^ high.b) % span) * factor + (low.a ^ low.b) % span) % span;
}

// The least count that is at least `parts / whole` of n.
DEVICE int Share(int parts, int whole, int n) {
  const int quotient = n / whole, rest = n % whole;
  return parts * quotient + (parts * rest + whole - 1) / whole;
}

// The first step after which `count` cells were known; `steps` where that many never were.
template <class Log>
DEVICE int FirstWith(const Log& log, int steps, int count) {
  int low = 0, high = steps;
  while (low < high) {
    const int middle = (low + high) / 2;
    if (log.known(middle) >= count) high = middle;
    else low = middle + 1;
  }
  return low;
}

// An episode, from its first scan to its end. `Maps` holds what the robot knows; `Log` what it did.
template <class Maps, class Log>
struct Episode {
  const Spec& p;
  Maps& maps;
  Log& log;
  Result& out;
  int at, came, target = kNone, left = 0;  // cells; motions of the way that are still to be made
  int heading, looking = 0, looked = 0, bumped = kNone, since_scan = 0, room = kNone;
  bool plan_active = false, held = false;  // held: another robot is in the way of the next step
  int straight = 0, diagonal = 0, turns = 0, scans = 0, plans = 0, exhausted = 0, refused = 0, entries = 0;
  int outcome = kRunning, saturated = 0;
  int home = kNone, homing = kRunning, enough = kNever;  // start; outcome of a robot on its way there; known cells
  int time = 0, run = 0, starts = 0;  // ms; steps since it stood; thousandths of the kinetic energy at full speed

  DEVICE Episode(const Spec& p, Maps& maps, Log& log, Result& out) : p(p), maps(maps), log(log), out(out) {}

  DEVICE int Looks() const { return p.first_scans > kLookAround ? p.first_scans : kLookAround; }

  DEVICE void Note() { log.Step(straight + diagonal, maps.known(), diagonal, kLooks * maps.Flat(at) + looked, time); }

  static DEVICE int Capped(int value) { return value < kMostMs ? value : kMostMs; }

  // `motion.tick`. What the table says of the steps since it stood.
  DEVICE const int32_t* Entry() const { return p.clock + kRunMs + 3 * (2 * run + (heading & 1)); }

  DEVICE void Wait(int ms) {
    const int32_t* entry = Entry();
    time = Capped(time + entry[1] - entry[0] + ms), starts = Capped(starts + entry[2]);
    run = 0;
  }

  DEVICE void Scan() {
    maps.Scan(at, heading);
    ++scans;
  }

  DEVICE void Face(int to) {
    const int turn = Turn(heading, to);
    if (turn > 0) Wait(p.clock[kTurnMs + turn]);
    turns += turn;
    heading = to;
  }

  // `environment._arrive` and the mark of a target that is exhausted.
  DEVICE void Arrive(bool arrived, bool live) {
    if (!arrived) return;
    plan_active = live && p.look_around && looked < Looks() - 1;
    if (plan_active) {
      looking = Looks() - 1;
    } else if (live) {
      ++exhausted;
      maps.Exhaust(target);
    }
  }

  // `environment._over`: the end, or the way home.
  DEVICE void Over(int as) {
    if (p.return_home && homing == kRunning && at != home) homing = as;
    else outcome = homing != kRunning ? homing : as;
  }

  // `environment._stop`: whether enough is known.
  DEVICE bool Stops() {
    if (maps.known() < enough || homing != kRunning || outcome != kRunning) return false;
    looking = 0;
    Over(kExplored);
    return true;
  }

  // The limit that the next motion of a plan would exceed, `kRunning` for none.
  DEVICE int Limit() const {
    if (looking == 0) {
      if (straight + diagonal >= p.max_steps) return kStepLimit;
      const bool is_diagonal = maps.Motion(at, left - 1) >= 4;
      const uint32_t length = static_cast<uint32_t>(kStraightLength) * (straight + !is_diagonal) +
                              static_cast<uint32_t>(kDiagonalLength) * (diagonal + is_diagonal);
      if (static_cast<int32_t>(length) > p.max_path) return kPathLimit;
    }
    return time >= p.max_ms ? kTimeLimit : kRunning;
  }

  // `environment._move` and `limit_plans`: a step along the way, or a turn in place.
  DEVICE void Move() {
    came = at;
    const int limit = plan_active ? Limit() : kRunning;
    if (limit != kRunning) {
      plan_active = false;
      outcome = limit;
      bumped = kNone;
    } else if (plan_active && looking > 0) {
      Face((heading + 8 / Looks()) & 7);
      Wait(p.clock[kScanMs]);
      --looking;
      ++looked;
      bumped = kNone;
    } else if (plan_active && held) {
      Wait(p.clock[kStepMs]);
      bumped = kNone;
    } else if (plan_active) {
      Step(maps.Motion(at, left - 1));
    }
    if (outcome == kRunning && !plan_active && plans >= p.max_plans) outcome = kPlanLimit;
  }

  DEVICE void Step(int motion) {
    const int to = at + maps.Offset(motion), seen_from = heading;
    Face(HeadingOf(motion));
    if (!maps.IsOpen(to)) {
      ++refused;
      Wait(p.clock[kScanMs]);
      bumped = motion;
      return;
    }
    log.Leave(straight + diagonal, at, seen_from);
    const bool is_diagonal = motion >= 4;
    const int came_ms = Entry()[0];
    ++run;
    time = Capped(time + Entry()[0] - came_ms);
    since_scan += is_diagonal ? kDiagonal : kStraight;
    diagonal += is_diagonal;
    straight += !is_diagonal;
    looked = 0;
    bumped = kNone;
    at = to;
    --left;
    const int here = maps.Room(to);
    if (here >= 0 && here != room) {
      room = here;
      ++entries;
    }
  }

  // `environment.decide` and `commit`.
  DEVICE void Plan(Key key) {
    log.Decide(plans, straight + diagonal, bumped);
    if (p.clock[kPlanMs] > 0) Wait(p.clock[kPlanMs]);
    if (homing != kRunning) target = maps.Home(at, home, left);
    else target = p.chooser == kNearest ? maps.Nearest(at, left) : maps.Uniform(at, left, FoldIn(key, plans));
    log.Chosen(plans, target == kNone ? kNone : maps.Flat(target), homing != kRunning);
    ++plans;
    bumped = kNone;
    plan_active = target != kNone;
    saturated = plan_active ? 0 : maps.Saturated();
    if (plan_active) Arrive(at == target, true);
    else Over(kComplete);
    Move();
  }

  DEVICE bool IsNear() const {
    const int y = maps.Row(target) - maps.Row(at), x = maps.Col(target) - maps.Col(at);
    return y * y + x * x <= p.arrival_d2;
  }

  // `environment.advance`, its first half: the scan that belongs to a motion.
  DEVICE void Look() {
    maps.Drive(at);
    const int dr = maps.Row(at) - maps.Row(came), dc = maps.Col(at) - maps.Col(came);
    if (dr != 0 && dc != 0) {
      maps.Drive(came + maps.Offset(2 - dr));  // N is motion 1, S is 3
      maps.Drive(came + maps.Offset(1 - dc));  // E is motion 0, W is 2
    }
    if (at == target || bumped != kNone || since_scan >= p.scan_every) {
      since_scan = 0;
      Scan();
    }
    Note();
  }

  // The other half: what it means for the plan, and the next motion.
  DEVICE void Judge(bool live) {
    const bool here = at == target, hit = Stops() || bumped != kNone;
    const bool is_last = homing != kRunning && p.return_home;  // a team's rendezvous is not the end
    plan_active = !hit && !((p.recheck || IsNear()) && !live && !here && homing == kRunning);
    if (plan_active && here && is_last) outcome = homing;
    Arrive(here && !hit && looking == 0, live && !is_last);
    Move();
  }

  DEVICE void Advance() {
    Look();
    Judge(maps.IsLive(target));
  }

  // The scans at the start, of `environment.begin`.
  DEVICE void LookRound(bool is_stuck) {
    for (int i = 0; i < p.first_scans && !is_stuck; ++i, heading = (heading + 8 / p.first_scans) & 7) Scan();
    Note();
    if (!is_stuck) Stops();
  }

  DEVICE void Run(const Task& task, bool is_stuck) {
    at = came = home = maps.At(task.row, task.col);
    if (p.stop_at > 0) enough = Share(p.stop_at, kWhole, maps.Knowable(task.region));
    heading = task.heading;
    maps.Begin(at);
    room = maps.Room(at);
    entries = room >= 0;
    if (is_stuck) outcome = kStuck;
    LookRound(is_stuck);
    const Key key = FoldIn(FoldIn({0, task.seed}, task.draw), 1);  // `engine.one_by_one.chunk`; `Stream.POLICY`
    while (outcome == kRunning && maps.GoesOn() && log.GoesOn()) {
      Plan(key);
      while (plan_active && outcome == kRunning && maps.GoesOn()) Advance();
    }
    if (outcome == kComplete && !maps.KnowsGoal(task.goal)) outcome = kBlocked;
    if (!maps.GoesOn() || !log.GoesOn()) outcome = kRunning;  // given up
    log.Decide(plans, straight + diagonal, bumped);
    log.Leave(straight + diagonal, at, heading);
    Finish(task);
  }

  // `episode.finish`. On a warp each lane fills a part.
  DEVICE void Finish(const Task& task) {
    const int steps = straight + diagonal, known = maps.known();
    const int explored = maps.Explored(task.region), knowable = maps.Knowable(task.region);
    Wait(0);
    if (maps.Lane() == 0) {
      out.straight = straight, out.diagonal = diagonal, out.turns = turns, out.scans = scans, out.plans = plans;
      out.exhausted = exhausted, out.outcome = outcome, out.known = known, out.explored = explored;
      out.explorable = maps.Explorable(task.region), out.room_entries = entries;
      out.saturated = saturated, out.refused = refused, out.overflow = 0, out.time = time, out.starts = starts;
    }
    const int percentiles[kPercentiles] = {50, 90, 95, 99};
    for (int i = maps.Lane(); i < kPercentiles; i += maps.Lanes()) {
      const int step = FirstWith(log, steps, Share(percentiles[i], 100, known));
      out.diagonal_at[i] = log.diagonal(step);
      out.straight_at[i] = step - out.diagonal_at[i];
      out.time_at[i] = log.time(step);
    }
    for (int i = maps.Lane(); i < kMarks; i += maps.Lanes()) {
      const int mark = Share(i + 1, kMarks, knowable), step = FirstWith(log, steps, mark);
      const bool is_reached = mark > 0 && mark <= known;
      out.diagonal_along[i] = is_reached ? log.diagonal(step) : kNone;
      out.straight_along[i] = is_reached ? step - log.diagonal(step) : kNone;
      out.time_along[i] = is_reached ? log.time(step) : kNone;
    }
  }
};

}  // namespace jexplore
