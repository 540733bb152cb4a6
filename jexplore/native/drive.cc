// An episode in JAX driven on until its strategy must be asked: motions, scans and what they tell the map, in one call
// of JAX's typed FFI, in the memory of the state. Whole numbers, and one comparison in single precision as JAX makes it.

#include "sweep.h"

namespace jexplore {
namespace {

using Walls = ffi::Buffer<ffi::PRED, 3>;
using Rooms = ffi::Buffer<ffi::S32, 3>;
using Real = ffi::Buffer<ffi::F32, 0>;

enum Stage { kFirstScans, kNextScan, kAnswered };

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
  int64_t n;

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
  const auto shape = hits.dimensions(), beams = by_beam.dimensions();
  const int height = static_cast<int>(shape[0]), width = static_cast<int>(shape[1]);
  const int64_t n_worlds = occupied.dimensions()[0];
  const int64_t world = std::clamp<int64_t>(own.scene, 0, n_worlds - 1) * height * width;
  CountMaps maps{height, width, InPlace(hits, hits_out), InPlace(misses, misses_out), InPlace(driven, driven_out),
                 InPlace(exhausted, exhausted_out), route.typed_data(), occupied.typed_data() + world,
                 rooms.typed_data() + world,
                 within.element_count() == hits.element_count() ? within.typed_data() : nullptr, by_beam.typed_data(),
                 length.typed_data(), blind.typed_data(), static_cast<int>(beams[1]), static_cast<int>(beams[2]),
                 static_cast<int>(beams[3]), {own.height, own.width}, own.no_echo_is_free != 0, std::min(own.connectivity, 8), *p_free.typed_data(),
                 now.known};
  if (!maps.IsWalled() || !IsOn(maps, now.row, now.col) || !IsOn(maps, now.came_row, now.came_col))
    return ffi::Error::InvalidArgument("a robot must be on a map with walls all round");
  TrailLog log{InPlace(trail, trail_out), trail.dimensions()[0]};
  Spec spec{};
  spec.first_scans = own.first_scans, spec.arrival_d2 = own.arrival_d2, spec.scan_every = own.scan_every;
  spec.max_steps = own.max_steps, spec.max_plans = own.max_plans, spec.look_around = own.look_around;
  spec.return_home = own.return_home, spec.max_path = own.max_path, spec.max_ms = own.max_ms;
  spec.recheck = own.recheck, spec.clock = clock.typed_data();
  Result unused;
  Drive episode(spec, maps, log, unused);
  Restore(episode, now, own);
  now = Saved(episode, GoOn(episode, own, own.may_ask && own.is_view));
  std::memcpy(changed_out->typed_data(), &now, sizeof now);
  return ffi::Error::Success();
}

}  // namespace

XLA_FFI_DEFINE_HANDLER_SYMBOL(jexplore_drive, Run);

}  // namespace jexplore
