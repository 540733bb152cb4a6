// Batches of whole episodes for Python, by one core of a CPU a call.

#include <cstdlib>
#include <new>

#include "bytes.h"

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
    if (*batch.stop) return;
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

}  // namespace
}  // namespace jexplore

using namespace jexplore;

extern "C" {

// A world for any number of batches; null without memory.
void* jexplore_world(const Spec* spec, const Given* given) try {
  return new World(*spec, *given);
} catch (const std::bad_alloc&) {
  return nullptr;
}

void jexplore_forget_world(void* world) { delete static_cast<World*>(world); }

void jexplore_free(void* memory) { std::free(memory); }

// Fills in what tasks are to know in the end. Not while episodes run in the world. 0, or 1 without memory.
int jexplore_goals(void* world_, Task* tasks, int64_t n) try {
  World& world = *static_cast<World*>(world_);
  std::map<int, int> goal_of;
  for (int64_t i = 0; i < n; ++i) {
    const int start = world.Cell(tasks[i].row, tasks[i].col);
    const auto known = goal_of.find(start);
    tasks[i].goal = known != goal_of.end() ? known->second : goal_of.emplace(start, world.GoalOf(start)).first->second;
    tasks[i].region = world.given.region[tasks[i].row * world.p.width + tasks[i].col];
  }
  return 0;
} catch (const std::bad_alloc&) {
  return 1;
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
} catch (const std::bad_alloc&) {
  return 1;
}
}
