// An episode in JAX driven on until its strategy must be asked: motions, scans and what they tell the map, in one call
// of JAX's typed FFI, in the memory of the state. Whole numbers, and one comparison in single precision as JAX makes it.

#include "sweep.h"

namespace jexplore {
namespace {

using Walls = ffi::Buffer<ffi::PRED, 3>;
using Rooms = ffi::Buffer<ffi::S32, 3>;
using Real = ffi::Buffer<ffi::F32, 0>;

enum Stage { kFirstScans, kNextScan, kAnswered };
constexpr int kPatience = 2;  // `team.environment.PATIENCE`

// The numbers of a state that driving changes, in the order of `drive.CHANGED`; then what it comes back with.
struct Changed {
  int32_t row, col, heading, looking, looked, plan_active, bumped, since_scan, known, room, straight, diagonal, turns, scans,
      exhausted, outcome, room_entries, refused, time, run, starts, homing, came_row, came_col;
  int32_t asks;  // whether it waits for what the strategy says of its target
};

// What it reads, in the order of `drive._terms`.
struct Terms {
  int32_t target_row, target_col, is_view, plans, stage, live, scene, height, width, first_scans, arrival_d2,
      scan_every, max_steps, max_plans, look_around, recheck, no_echo_is_free, may_ask, connectivity, home_row, home_col, enough,
      return_home, max_path, max_ms;
};

// What a robot did, as `trail.note_step` has it.
struct TrailLog {
  int32_t* trail;  // [n, 3]
  int64_t n;  // 0: nothing is kept

  void Step(int step, int known, int, int spot, int time) {
    if (step >= n) return;
    trail[3 * step] = spot, trail[3 * step + 1] = known, trail[3 * step + 2] = time;
  }
  void Leave(int, int, int) {}
};

using Drive = Episode<CountMaps, TrailLog>;

void Restore(Drive& episode, const Changed& in, const Terms& terms) {
  const int width = episode.maps.width;
  episode.at = in.row * width + in.col, episode.came = in.came_row * width + in.came_col;
  episode.target = terms.target_row < 0 ? kNone : terms.target_row * width + terms.target_col;
  episode.heading = in.heading & 7, episode.looking = in.looking, episode.looked = in.looked;
  episode.plan_active = in.plan_active, episode.bumped = in.bumped, episode.since_scan = in.since_scan, episode.room = in.room;
  episode.straight = in.straight, episode.diagonal = in.diagonal, episode.turns = in.turns, episode.scans = in.scans;
  episode.plans = terms.plans, episode.exhausted = in.exhausted, episode.refused = in.refused;
  episode.entries = in.room_entries, episode.outcome = in.outcome;
  episode.time = in.time, episode.run = in.run, episode.starts = in.starts, episode.homing = in.homing;
  episode.home = terms.home_row * width + terms.home_col, episode.enough = terms.enough;
}

Changed Saved(const Drive& episode, bool asks) {
  const CountMaps& maps = episode.maps;
  return {maps.Row(episode.at), maps.Col(episode.at), episode.heading, episode.looking, episode.looked,
          episode.plan_active, episode.bumped, episode.since_scan, maps.n_known, episode.room, episode.straight,
          episode.diagonal, episode.turns, episode.scans, episode.exhausted, episode.outcome, episode.entries,
          episode.refused, episode.time, episode.run, episode.starts, episode.homing, maps.Row(episode.came), maps.Col(episode.came), asks};
}

bool IsOn(const CountMaps& maps, int row, int col) {
  return 0 <= row && row < maps.height && 0 <= col && col < maps.width;
}

// Drives on; whether the strategy must be asked before it can go on.
bool GoOn(Drive& episode, const Terms& terms, bool may_ask) {
  if (terms.stage == kFirstScans) {
    episode.LookRound(episode.outcome != kRunning);
    return false;
  }
  if (terms.stage == kAnswered) episode.Judge(terms.live);
  while (episode.plan_active && episode.outcome == kRunning) {
    episode.Look();
    if (may_ask && episode.homing == kRunning && (episode.p.recheck || episode.IsNear())) return true;
    episode.Judge(episode.maps.IsLive(episode.target));
  }
  return false;
}

Spec SpecOf(const Terms& own, const Numbers& clock) {
  Spec spec{};
  spec.first_scans = own.first_scans, spec.arrival_d2 = own.arrival_d2, spec.scan_every = own.scan_every;
  spec.max_steps = own.max_steps, spec.max_plans = own.max_plans, spec.look_around = own.look_around;
  spec.return_home = own.return_home, spec.max_path = own.max_path, spec.max_ms = own.max_ms;
  spec.recheck = own.recheck, spec.clock = clock.typed_data();
  return spec;
}

// Puts the maps of a robot into its world, and gives it all of its scanner but the lengths of beams.
void Place(CountMaps& maps, const Terms& own, const Walls& occupied, const Rooms& rooms, const Table& by_beam,
           const Counts& blind, const Real& p_free) {
  const int64_t last = occupied.dimensions()[0] - 1;
  const int64_t world = std::clamp<int64_t>(own.scene, 0, last) * maps.height * maps.width;
  maps.occupied = occupied.typed_data() + world, maps.rooms = rooms.typed_data() + world;
  const auto beams = by_beam.dimensions();
  maps.n_blocks = static_cast<int>(beams[1]), maps.n_beams = static_cast<int>(beams[2]), maps.block = static_cast<int>(beams[3]);
  maps.by_beam = by_beam.typed_data(), maps.blind = blind.typed_data(), maps.p_free = *p_free.typed_data();
  maps.extent[0] = own.height, maps.extent[1] = own.width;
  maps.no_echo_is_free = own.no_echo_is_free != 0, maps.connectivity = std::min(own.connectivity, 8);
}

ffi::Error Run(Counts hits, Counts misses, Flags driven, Flags exhausted, Counts trail, Numbers changed, Motions route,
               Walls occupied, Rooms rooms, Flags within, Table by_beam, Counts length, Counts blind, Numbers terms, Real p_free, Numbers clock,
               ffi::Result<Counts> hits_out, ffi::Result<Counts> misses_out, ffi::Result<Flags> driven_out,
               ffi::Result<Flags> exhausted_out, ffi::Result<Counts> trail_out, ffi::Result<Numbers> changed_out) {
  if (changed.size_bytes() != sizeof(Changed) || terms.size_bytes() != sizeof(Terms))
    return ffi::Error::InvalidArgument("numbers of a state must be as many as in drive.cc");
  Changed now;
  Terms own;
  std::memcpy(&now, changed.typed_data(), sizeof now);
  std::memcpy(&own, terms.typed_data(), sizeof own);
  const auto shape = hits.dimensions();
  CountMaps maps{static_cast<int>(shape[0]), static_cast<int>(shape[1]), InPlace(hits, hits_out),
                 InPlace(misses, misses_out), InPlace(driven, driven_out), InPlace(exhausted, exhausted_out),
                 route.typed_data()};
  if (within.element_count() == hits.element_count()) maps.within = within.typed_data();
  Place(maps, own, occupied, rooms, by_beam, blind, p_free);
  maps.length = length.typed_data(), maps.n_known = now.known;
  if (!maps.IsWalled() || !IsOn(maps, now.row, now.col) || !IsOn(maps, now.came_row, now.came_col))
    return ffi::Error::InvalidArgument("a robot must be on a map with walls all round");
  TrailLog log{InPlace(trail, trail_out), trail.dimensions()[0]};
  const Spec spec = SpecOf(own, clock);
  Result unused;
  Drive episode(spec, maps, log, unused);
  Restore(episode, now, own);
  now = Saved(episode, GoOn(episode, own, own.may_ask && own.is_view));
  std::memcpy(changed_out->typed_data(), &now, sizeof now);
  return ffi::Error::Success();
}

// A robot of a team: its numbers, then those of `drive.MEMBER`.
struct Member {
  Changed own;
  int32_t clock, waits, in_a_row, hemmed;
};

// What a team counts, in the order of `drive.TALLY`; then which robot acts, and how many it hears, itself included.
struct Tally {
  int32_t known, n_log, last, links;
  int32_t robot, heard;
  int32_t goes_on;  // whether others act after it, until one must plan
};

struct Team {
  Member* members;
  int n;
  Tally& tally;
  int32_t *log, *way;  // [H * W + 1, 4], [N, n_way, 3]
  int n_way;

  bool IsHere(int i) const { return members[i].own.outcome == kRunning; }

  // `team.state.next_robot`; `kNone` where all have ended.
  int Next() const {
    int next = kNone;
    for (int i = 0; i < n; ++i)
      if (IsHere(i) && (next == kNone || members[i].clock < members[next].clock)) next = i;
    return next;
  }

  // `team.environment.is_held`.
  bool IsHeld(int robot, int motion) const {
    const int to_row = DRow(motion), to_col = DCol(motion);
    for (int i = 0; i < n; ++i) {
      const int row = members[i].own.row - members[robot].own.row, col = members[i].own.col - members[robot].own.col;
      const bool between = to_row != 0 && to_col != 0 && ((row == to_row && col == 0) || (row == 0 && col == to_col));
      if (i != robot && IsHere(i) && ((row == to_row && col == to_col) || between)) return true;
    }
    return false;
  }

  // `team.environment._note`.
  void Note(int i, const Changed& before, int pace, bool grew) {
    const int32_t entry[4] = {tally.known, pace * (before.straight + members[i].waits), pace * before.diagonal,
                              std::min(before.time, kMostMs / pace) * pace};
    const int32_t* next = log + 4 * tally.n_log;
    const bool again = tally.n_log > 0 && tally.last == i && next[-3] == entry[1] && next[-2] == entry[2];
    if (!again && !grew) return;
    if (!again) ++tally.n_log, tally.last = i;
    std::memcpy(log + 4 * (tally.n_log - 1), entry, sizeof entry);
  }

  // `team.environment.act`.
  void Act(int i, const Changed& before, const Terms& terms, int pace, bool held, int width) {
    Member& robot = members[i];
    Changed& own = robot.own;
    const int step = own.straight + own.diagonal;
    const bool moved = step != before.straight + before.diagonal;
    const bool waited = held && own.plan_active && own.looked == before.looked;
    robot.in_a_row = moved ? 0 : robot.in_a_row + waited;
    robot.hemmed = waited && robot.in_a_row >= kPatience + i;
    if (robot.hemmed) own.plan_active = robot.in_a_row = 0;
    if (own.outcome == kRunning && !own.plan_active && terms.plans >= terms.max_plans) own.outcome = kPlanLimit;
    robot.waits += waited;
    robot.clock = pace * (kStraightLength * (own.straight + robot.waits) + kDiagonalLength * own.diagonal);
    if (!moved) return;
    tally.links += tally.heard - 1;
    const int target = terms.target_row < 0 ? kNone : terms.target_row * width + terms.target_col;
    const int32_t here[3] = {own.row * width + own.col, robot.clock, target};
    if (step < n_way) std::memcpy(way + 3 * (static_cast<int64_t>(i) * n_way + step), here, sizeof here);
  }
};

// The next turn of a team, or all until a robot must plan. Robots' arrays have a leading axis N.
ffi::Error TakeTurns(Rooms hits, Rooms misses, Walls driven, Walls exhausted, Counts members, Counts seen_at, Counts log,
                     Rooms way, Numbers tally, ffi::Buffer<ffi::S8, 3> route, Walls occupied, Rooms rooms, Walls within,
                     Table by_beam, Rooms length, Counts blind, Counts terms, Numbers paces, Real p_free, Numbers clock,
                     ffi::Result<Rooms> hits_out, ffi::Result<Rooms> misses_out, ffi::Result<Walls> driven_out,
                     ffi::Result<Walls> exhausted_out, ffi::Result<Counts> members_out, ffi::Result<Counts> seen_at_out,
                     ffi::Result<Counts> log_out, ffi::Result<Rooms> way_out, ffi::Result<Numbers> tally_out) {
  const auto shape = hits.dimensions();
  const int n = static_cast<int>(shape[0]), height = static_cast<int>(shape[1]), width = static_cast<int>(shape[2]);
  if (members.size_bytes() != n * sizeof(Member) || terms.size_bytes() != n * sizeof(Terms) ||
      tally.size_bytes() != sizeof(Tally))
    return ffi::Error::InvalidArgument("numbers of a team must be as many as in drive.cc");
  Tally& told = *reinterpret_cast<Tally*>(InPlace(tally, tally_out));
  Team team{reinterpret_cast<Member*>(InPlace(members, members_out)), n, told, InPlace(log, log_out),
            InPlace(way, way_out), static_cast<int>(way.dimensions()[1])};
  CountMaps all{height, width, InPlace(hits, hits_out), InPlace(misses, misses_out), InPlace(driven, driven_out),
                InPlace(exhausted, exhausted_out)};
  all.seen_at = InPlace(seen_at, seen_at_out);
  TrailLog none{nullptr, 0};
  Result unused;
  for (int i = told.robot; i != kNone && team.members[i].own.plan_active;) {
    Terms own;
    std::memcpy(&own, terms.typed_data() + i * sizeof own / sizeof(int32_t), sizeof own);
    CountMaps maps = all;
    const int64_t first = static_cast<int64_t>(i) * height * width;
    maps.hits += first, maps.misses += first, maps.driven += first, maps.exhausted += first;
    maps.route = route.typed_data() + first;
    maps.within = within.element_count() == hits.element_count() ? within.typed_data() + first : nullptr;
    Place(maps, own, occupied, rooms, by_beam, blind, p_free);
    maps.length = length.typed_data() + (length.dimensions()[0] == n ? i * blind.element_count() : 0);
    const Changed before = team.members[i].own;
    if (!maps.IsWalled() || !IsOn(maps, before.row, before.col) || !IsOn(maps, before.came_row, before.came_col))
      return ffi::Error::InvalidArgument("a robot must be on a map with walls all round");
    maps.n_known = before.known, maps.now = team.members[i].clock;
    const Spec spec = SpecOf(own, clock);
    Drive episode(spec, maps, none, unused);
    Restore(episode, before, own);
    episode.held = team.IsHeld(i, maps.Motion(episode.at, 0));
    episode.Look();
    episode.Judge(maps.IsLive(episode.target));
    team.members[i].own = Saved(episode, false);
    told.known += maps.grown;
    const int pace = paces.typed_data()[i];
    team.Note(i, before, pace, maps.grown > 0);
    team.Act(i, before, own, pace, episode.held, width);
    i = told.goes_on ? team.Next() : kNone;
  }
  return ffi::Error::Success();
}

}  // namespace

XLA_FFI_DEFINE_HANDLER_SYMBOL(jexplore_drive, Run);
XLA_FFI_DEFINE_HANDLER_SYMBOL(jexplore_turns, TakeTurns);

}  // namespace jexplore
