// Batches of whole episodes for Python, by an NVIDIA GPU: a warp an episode, from a queue until it is empty.

#include <cuda_runtime.h>

#include <chrono>
#include <cstdio>
#include <stdexcept>
#include <string>

#include "warp_host.h"

namespace jexplore {

// What a run was like; in the order of `gpu.Measured`.
struct Measured {
  double prepare_s, views_s, run_s;
  int64_t views_bytes, memory_bytes;
  int32_t warps_per_sm, n_sms, given_up;
  int64_t clocks[kParts + 1];
};

namespace {

constexpr double kLaunchS = 1.0;       // seconds that a launch should take: how long Ctrl-C waits
constexpr int kMostSteps = 1 << 15;    // steps of an episode that there is room for; one of more is given up
constexpr double kViewsShare = 0.5;    // of the free memory, which views may take

void Check(cudaError_t code, const char* what) {
  if (code == cudaSuccess) return;
  cudaGetLastError();
  if (code == cudaErrorMemoryAllocation) throw std::bad_alloc();
  throw std::runtime_error(std::string(what) + ": " + cudaGetErrorString(code));
}

// Memory of the device, which is let go with its owner.
template <class T>
struct Device {
  T* data = nullptr;
  explicit Device(size_t n = 0) {
    if (n) Check(cudaMalloc(reinterpret_cast<void**>(&data), n * sizeof(T)), "memory of the GPU");
  }
  Device(const T* values, size_t n) : Device(n) {
    if (n) Check(cudaMemcpy(data, values, n * sizeof(T), cudaMemcpyHostToDevice), "copy to the GPU");
  }
  explicit Device(const std::vector<T>& values) : Device(values.data(), values.size()) {}
  Device(const Device&) = delete;
  Device(Device&& other) : data(other.data) { other.data = nullptr; }
  Device& operator=(Device&& other) {
    std::swap(data, other.data);
    return *this;
  }
  ~Device() { cudaFree(data); }
};

__global__ void Fill(uint32_t* values, int64_t n, int64_t stride, int64_t length) {
  for (int64_t i = blockIdx.x * static_cast<int64_t>(blockDim.x) + threadIdx.x; i < n * length; i += static_cast<int64_t>(gridDim.x) * blockDim.x)
    values[i / length * stride + i % length] = kUnreached;
}

__global__ void MakeViews(const __grid_constant__ WarpWorld w, const int32_t* cells, int n, uint32_t* views, uint32_t* extents) {
  extern __shared__ uint32_t bits[];
  for (int64_t i = blockIdx.x; i < 8ll * n; i += gridDim.x) {
    const int heading = i % 8;
    const int64_t number = i / 8;
    MakeView(w, cells[number], heading, bits, views + number * w.view_words + w.box[heading].at, extents + i);
    __syncwarp();
  }
}

struct Work {
  const Task* tasks;
  const uint8_t* is_stuck;
  Result* results;
  int n;
  int* next;
  uint32_t* other;  // of each warp
  int64_t other_words;
  int32_t* steps;
  int capacity;
  unsigned long long* clocks;  // [kParts + 1], with JEXPLORE_CLOCKS
};

template <class Cell>
__global__ void __launch_bounds__(32) RunEpisodes(const __grid_constant__ WarpWorld w, const __grid_constant__ Work work) {
  extern __shared__ uint32_t shared[];
  const int64_t slot = blockIdx.x;
  const WarpMemory<Cell> memory = Divide<Cell>(w, shared, work.other + slot * work.other_words);
  for (;;) {
    int i = 0;
    if (threadIdx.x == 0) i = atomicAdd(work.next, 1);
    i = __shfl_sync(~0u, i, 0);
    if (i >= work.n) return;
#ifdef JEXPLORE_CLOCKS
    const long long began = clock64();
#endif
    WarpMaps<Cell> own(w, memory);
    WarpLog log(work.steps + 3 * slot * work.capacity, work.capacity);
    Episode episode(w.p, own, log, work.results[i]);
    episode.Run(work.tasks[i], work.is_stuck[i]);
#ifdef JEXPLORE_CLOCKS
    if (threadIdx.x == 0) {
      for (int k = 0; k < kParts; ++k) atomicAdd(&work.clocks[k], own.clocks[k]);
      atomicAdd(&work.clocks[kParts], clock64() - began);
    }
#endif
    __syncwarp();
  }
}

double Now() { return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count(); }

template <class Cell>
void Run(HostWorld& host, Result* results, const volatile int32_t* stop, Measured& measured, int most_warps) {
  WarpWorld& w = host.w;
  const double began = Now();
  cudaDeviceProp device;
  int number = 0, per_sm = 0;
  Check(cudaGetDevice(&number), "GPU");
  Check(cudaGetDeviceProperties(&device, number), "GPU");
  const Beams beams{w.way, w.length, w.is_row, w.beam_words};
  const size_t n_beams = 8 * static_cast<size_t>(w.p.n_beams);
  Device<uint32_t> truth(host.truth), inside(host.inside), goals(host.goals), regions(host.regions), is_row(beams.is_row, n_beams * beams.n_words);
  Device<int32_t> rooms(host.rooms), counts(host.counts), view_of(host.view_of), way(beams.way, 2 * n_beams), length(beams.length, n_beams);
  w.truth = truth.data, w.inside = inside.data, w.goals = goals.data, w.regions = regions.data, w.is_row = is_row.data;
  w.rooms = rooms.data, w.counts = counts.data, w.view_of = view_of.data, w.way = way.data, w.length = length.data;

  const size_t shared_bytes = 4 * host.SharedWords<Cell>();
  const auto kernel = RunEpisodes<Cell>;
  Check(cudaFuncSetAttribute(kernel, cudaFuncAttributeMaxDynamicSharedMemorySize, static_cast<int>(shared_bytes)), "shared memory");
  Check(cudaOccupancyMaxActiveBlocksPerMultiprocessor(&per_sm, kernel, 32, shared_bytes), "occupancy");
  if (most_warps > 0) per_sm = std::min(per_sm, most_warps);
  const int64_t n_tasks = static_cast<int64_t>(host.tasks.size());
  const int64_t slots = std::min<int64_t>(static_cast<int64_t>(per_sm) * device.multiProcessorCount, n_tasks);

  Work work{};
  work.capacity = std::min(w.p.max_steps + 1, kMostSteps);
  work.other_words = host.OtherWords<Cell>();
  Device<uint32_t> other(slots * work.other_words);
  Device<int32_t> steps(3 * slots * work.capacity), next(1), clock(w.p.clock, w.p.n_clock);
  w.p.clock = clock.data;
  Device<Task> tasks(host.tasks);
  Device<uint8_t> is_stuck(host.is_stuck);
  Device<Result> found(n_tasks);
  Device<unsigned long long> clocks(kParts + 1);
  Check(cudaMemset(clocks.data, 0, (kParts + 1) * sizeof(unsigned long long)), "clocks");
  Fill<<<1024, 256>>>(other.data, slots, work.other_words, w.n_cells);
  Check(cudaDeviceSynchronize(), "filling");
  measured.prepare_s = Now() - began;

  size_t free_bytes = 0, all_bytes = 0;
  Check(cudaMemGetInfo(&free_bytes, &all_bytes), "memory");
  const double since = Now();
  Device<uint32_t> views, extents;
  Device<int32_t> cells;
  const size_t view_bytes = 4 * static_cast<size_t>(host.n_free) * w.view_words, box_bytes = 4 * static_cast<size_t>(host.LargestBox());
  if (view_bytes < kViewsShare * free_bytes && box_bytes <= device.sharedMemPerBlockOptin) {
    std::vector<int32_t> free_cells(host.n_free);
    for (int cell = 0; cell < w.n_cells; ++cell)
      if (host.view_of[cell] >= 0) free_cells[host.view_of[cell]] = cell;
    cells = Device<int32_t>(free_cells), views = Device<uint32_t>(view_bytes / 4), extents = Device<uint32_t>(8 * host.n_free);
    Check(cudaFuncSetAttribute(MakeViews, cudaFuncAttributeMaxDynamicSharedMemorySize, static_cast<int>(box_bytes)), "shared memory");
    MakeViews<<<32 * device.multiProcessorCount, 32, box_bytes>>>(w, cells.data, host.n_free, views.data, extents.data);
    Check(cudaDeviceSynchronize(), "views");
    w.views = views.data, w.extents = extents.data;
    measured.views_bytes = view_bytes;
  }
  measured.views_s = Now() - since;

  work.tasks = tasks.data, work.is_stuck = is_stuck.data, work.results = found.data, work.next = next.data;
  work.other = other.data, work.steps = steps.data, work.clocks = clocks.data;
  Check(cudaMemGetInfo(&free_bytes, &all_bytes), "memory");
  measured.memory_bytes = all_bytes - free_bytes;
  measured.warps_per_sm = per_sm, measured.n_sms = device.multiProcessorCount;
  int64_t many = 4 * slots;
  for (int64_t first = 0; first < n_tasks && !*stop;) {
    const double launched = Now();
    work.n = static_cast<int>(std::min(first + many, n_tasks));
    const int from = static_cast<int>(first);
    Check(cudaMemcpy(next.data, &from, sizeof from, cudaMemcpyHostToDevice), "queue");
    kernel<<<static_cast<int>(slots), 32, shared_bytes>>>(w, work);
    Check(cudaGetLastError(), "launch");
    Check(cudaMemcpy(results + first, found.data + first, (work.n - first) * sizeof(Result), cudaMemcpyDeviceToHost), "episodes");
    const double took = Now() - launched;
    measured.run_s += took;
    many = std::max<int64_t>(4 * slots, static_cast<int64_t>((work.n - first) * kLaunchS / std::max(took, 1e-3)));
    first = work.n;
  }
  for (int64_t i = 0; i < n_tasks; ++i) measured.given_up += results[i].outcome == kRunning;
  Check(cudaMemcpy(measured.clocks, clocks.data, sizeof measured.clocks, cudaMemcpyDeviceToHost), "clocks");
}

}  // namespace
}  // namespace jexplore

using namespace jexplore;

extern "C" {

// The number of GPUs; 0 without a driver.
int jexplore_gpus() {
  int n = 0;
  return cudaGetDeviceCount(&n) == cudaSuccess ? n : 0;
}

// Runs episodes of a world of its own; those with an outcome of 0 were given up. `most_warps` of a
// multiprocessor; 0: as many as fit. Returns 0, 1 without memory, 2 in a world that does not suit, 3 with an error, in
// `why`.
int jexplore_gpu_episodes(const Spec* spec, const Given* given, Task* tasks, int64_t n, Result* results,
                          const volatile int32_t* stop, int most_warps, Measured* measured, char* why, int64_t size) {
  try {
    World world(*spec, *given);
    if (!HostWorld::Suits(world)) return 2;
    world.FindGoals(tasks, n);
    HostWorld host(world, tasks, n);
    if (host.w.n_cells < 1 << 16) Run<uint16_t>(host, results, stop, *measured, most_warps);
    else Run<uint32_t>(host, results, stop, *measured, most_warps);
    return 0;
  } catch (const std::bad_alloc&) {
    return 1;
  } catch (const std::exception& error) {
    std::snprintf(why, size, "%s", error.what());
    return 3;
  }
}
}
