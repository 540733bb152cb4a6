// Batches of whole episodes for Python, by one core of a CPU a call.

#include <cstdlib>
#include <functional>
#include <new>

#include "bytes.h"
#ifdef JEXPLORE_EMULATE
#include "warp_host.h"
#endif

namespace jexplore {
namespace {

// What a batch is asked for, and where it goes; in the order of `episodes.Batch`.
struct Batch {
  const Task* tasks;
  int64_t n;
  const volatile int32_t* stop;  // not 0: what is under way is given up
  Result* results;               // [n]; outcome `kRunning` where it was given up
  uint8_t* states;               // [n, H, W], 0 unknown, 1 free, 2 occupied, at the end; or null
  int32_t* paths;                // out: [sum of n_steps + 1, 2], spot and known cells; null unless asked for
  int64_t* n_steps;              // [n], or null: no paths
  int64_t whole;                 // number of the episode of which counts and choices are wanted; -1: none
  int32_t *hits, *misses;        // [H, W]
  int32_t* choices;              // out: [plans + 1, 2]; null unless asked for
};

int32_t* Grown(int32_t* values, int64_t n) {
  void* grown = std::realloc(values, n * sizeof(int32_t));
  if (!grown) throw std::bad_alloc();
  return static_cast<int32_t*>(grown);
}

template <Counting counting>
void Play(const World& world, Batch& batch, int64_t first, int64_t end, int64_t& n_paths) {
  ByteMaps<counting> maps(world, batch.stop);
  FullLog log;
  for (int64_t i = first; i < end; ++i) {
    const Task& task = batch.tasks[i];
    log.Clear();
    Episode episode(world.p, maps, log, batch.results[i]);
    episode.Run(task, world.IsStuck(world.Cell(task.row, task.col), task.goal));
    if (*batch.stop) {
      batch.results[i].outcome = kRunning;
      return;
    }
    if (batch.n_steps) {
      const int64_t n = static_cast<int64_t>(log.spot.size());
      batch.paths = Grown(batch.paths, 2 * (n_paths + n));
      for (int64_t step = 0; step < n; ++step) {
        batch.paths[2 * (n_paths + step)] = log.spot[step];
        batch.paths[2 * (n_paths + step) + 1] = log.known_after[step];
      }
      n_paths += n;
      batch.n_steps[i] = n - 1;
    }
    if (batch.states)
      world.ForAll([&](int flat, int cell) {
        batch.states[i * world.p.height * world.p.width + flat] = maps.cell[cell] & maps.kSeen;
      });
    if (i == batch.whole) {
      batch.choices = Grown(nullptr, static_cast<int64_t>(log.choices.size()));
      std::memcpy(batch.choices, log.choices.data(), 4 * log.choices.size());
      if constexpr (counting != kKnownOnly)
        world.ForAll([&](int flat, int cell) {
          batch.hits[flat] = maps.hits[cell], batch.misses[flat] = maps.misses[cell];
        });
    }
  }
}

// A recorded episode, and when it is to be seen; in the order of `episodes.Replay`.
struct Replay {
  const Task* task;
  int64_t n_plans;
  const int32_t* targets;   // [n_plans], flat
  const uint8_t* is_view;   // [n_plans], whether it is a view point
  const int64_t* ends;      // [n_plans], where the motions of each end in
  const int8_t* motions;    // made and refused, in order
  const int32_t* looked;    // [steps + 1], scans made in place
  int64_t n_shown;
  const int32_t* shown;     // [n_shown], steps made, ascending
  uint8_t frontier;         // is added to the codes of frontier cells
  uint8_t* codes;           // out: [n_shown, H, W]
  int32_t* headings;        // out: [n_shown], at the last scan there
};

// Maps whose owner chooses what a record says. Whether a view point was live is told by what the robot then did.
template <Counting counting>
struct ScriptMaps : ByteMaps<counting> {
  using Base = ByteMaps<counting>;
  const Replay& script;
  int64_t plan = -1;
  const Episode<ScriptMaps, struct ReplayLog>* episode = nullptr;

  ScriptMaps(const World& world, const volatile int32_t* stop, const Replay& script) : Base(world, stop), script(script) {}

  int Nearest(int, int& left) {
    if (++plan >= script.n_plans) return kNone;
    const int64_t first = plan ? script.ends[plan - 1] : 0;
    left = static_cast<int>(script.ends[plan] - first);
    for (int i = 0; i < left; ++i) this->way[left - 1 - i] = script.motions[first + i];
    return this->At(script.targets[plan] / this->p.width, script.targets[plan] % this->p.width);
  }

  bool IsLive(int target) const {
    if (!script.is_view[plan]) return Base::IsLive(target);
    const bool here = episode->at == target;
    return here ? script.looked[episode->straight + episode->diagonal] > episode->looked : episode->left > 0;
  }
};

struct ReplayLog : FullLog {
  const Replay& script;
  std::function<void(int, uint8_t*)> show;  // (cell, codes)
  int64_t next = 0;

  explicit ReplayLog(const Replay& script) : script(script) {}

  void Leave(int step, int at, int heading) {
    for (; next < script.n_shown && script.shown[next] <= step; ++next) {
      show(at, script.codes + next * n_cells);
      script.headings[next] = heading;
    }
  }
  int64_t n_cells = 0;
};

template <Counting counting>
int64_t Show(const World& world, const Replay& script) {
  const int32_t stop = 0;
  Result result;
  ScriptMaps<counting> maps(world, &stop, script);
  ReplayLog log(script);
  log.n_cells = static_cast<int64_t>(world.p.height) * world.p.width;
  log.show = [&](int at, uint8_t* codes) { maps.Show(at, script.frontier, codes); };
  Episode episode(world.p, maps, log, result);
  maps.episode = &episode;
  episode.Run(*script.task, world.IsStuck(world.Cell(script.task->row, script.task->col), script.task->goal));
  return log.next;
}

#ifdef JEXPLORE_EMULATE
// Episodes as a warp runs them, its lanes one after the other; `with_views`: scans by views, not by beams.
template <class Cell>
void Emulate(HostWorld& host, Result* results, bool with_views) {
  WarpWorld& w = host.w;
  std::vector<uint32_t> shared(host.SharedWords<Cell>()), other(host.OtherWords<Cell>()), views, extents, bits;
  std::vector<int32_t> steps(3 * (static_cast<size_t>(w.p.max_steps) + 1));
  if (with_views) {
    views.resize(static_cast<size_t>(host.n_free) * w.view_words), extents.resize(8 * host.n_free), bits.resize(host.LargestBox());
    for (int cell = 0; cell < w.n_cells; ++cell)
      for (int heading = 0; heading < 8 && w.view_of[cell] >= 0; ++heading)
        MakeView(w, cell, heading, bits.data(), &views[static_cast<size_t>(w.view_of[cell]) * w.view_words + w.box[heading].at],
                 &extents[8 * w.view_of[cell] + heading]);
    w.views = views.data(), w.extents = extents.data();
  }
  const WarpMemory<Cell> memory = Divide<Cell>(w, shared.data(), other.data());
  std::fill(memory.cost, memory.cost + w.n_cells, kUnreached);
  for (size_t i = 0; i < host.tasks.size(); ++i) {
    WarpMaps<Cell> maps(w, memory);
    WarpLog log(steps.data(), w.p.max_steps + 1);
    Episode episode(w.p, maps, log, results[i]);
    episode.Run(host.tasks[i], host.is_stuck[i]);
  }
}
#endif

}  // namespace
}  // namespace jexplore

using namespace jexplore;

extern "C" {

// A world for any number of batches; null without memory.
void* jexplore_world(const Spec* spec, const Given* given) try {
  return new World(*spec, *given);
} catch (const std::exception&) {
  return nullptr;
}

void jexplore_forget_world(void* world) { delete static_cast<World*>(world); }

void jexplore_free(void* memory) { std::free(memory); }

// Fills in what tasks are to know in the end. Not while episodes run in the world. 0, or 1 without memory.
int jexplore_goals(void* world_, Task* tasks, int64_t n) try {
  static_cast<World*>(world_)->FindGoals(tasks, n);
  return 0;
} catch (const std::exception&) {
  return 1;
}

#ifdef JEXPLORE_EMULATE
// Runs episodes as a GPU does. 0, 1 without memory, 2 in a world that does not suit.
int jexplore_emulate(const void* world_, const Batch* batch, int with_views) try {
  const World& world = *static_cast<const World*>(world_);
  if (!HostWorld::Suits(world)) return 2;
  HostWorld host(world, batch->tasks, batch->n);
  (host.w.n_cells < 1 << 16) ? Emulate<uint16_t>(host, batch->results, with_views) : Emulate<uint32_t>(host, batch->results, with_views);
  return 0;
} catch (const std::exception&) {
  return 1;
}
#endif

// Shows a recorded episode once more: how many of its places it came to. -1 without memory.
int64_t jexplore_replay(const void* world_, const Replay* script) try {
  const World& world = *static_cast<const World*>(world_);
  return world.given.prior ? Show<kChanges>(world, *script) : Show<kKnownOnly>(world, *script);
} catch (const std::exception&) {
  return -1;
}

// Runs episodes. 0, or 1 without memory.
int jexplore_episodes(const void* world_, Batch* batch) try {
  const World& world = *static_cast<const World*>(world_);
  int64_t n_paths = 0;
  if (world.given.prior) {
    Play<kChanges>(world, *batch, 0, batch->n, n_paths);
    return 0;
  }
  for (int64_t i = 0; i < batch->n && !*batch->stop;) {  // counts only where they are wanted
    const int64_t end = i < batch->whole ? std::min(batch->whole, batch->n) : batch->n;
    if (i == batch->whole) {
      Play<kCounts>(world, *batch, i, i + 1, n_paths);
      ++i;
    } else {
      Play<kKnownOnly>(world, *batch, i, end, n_paths);
      i = end;
    }
  }
  return 0;
} catch (const std::exception&) {
  return 1;
}
}
