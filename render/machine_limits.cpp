#include "render/machine_limits.h"

#include <tbb/task_arena.h>

#include <chrono>
#include <cstdint>
#include <functional>
#include <numeric>
#include <thread>
#include <vector>

#include "render/cpu/sweep_kernels.h"
#include "render/gl/gl_limits.h"

namespace stuv {
namespace {

using Clock = std::chrono::steady_clock;

constexpr double kSeconds = 0.15;

/// The sum of what every thread reaches while the others run.
double on_all_threads(const std::function<double()>& rate) {
  const auto count = static_cast<std::size_t>(tbb::this_task_arena::max_concurrency());
  std::vector<double> rates(count);
  std::vector<std::thread> threads;
  for (std::size_t i = 0; i < count; ++i) threads.emplace_back([&, i] { rates[i] = rate(); });
  for (std::thread& thread : threads) thread.join();
  return std::accumulate(rates.begin(), rates.end(), 0.0);
}

double read_bytes() {
  // More than the caches hold.
  const std::vector<std::uint64_t> memory(std::size_t{16} << 20, 1);
  double done = 0, elapsed = 0;
  std::uint64_t sum = 0;
  const auto start = Clock::now();
  while (elapsed < kSeconds) {
    sum = std::accumulate(memory.begin(), memory.end(), sum);
    done += static_cast<double>(memory.size()) * sizeof(memory[0]);
    elapsed = std::chrono::duration<double>(Clock::now() - start).count();
  }
  // So that the loop is not optimised away.
  return sum > 0 ? done / elapsed : 0;
}

}  // namespace

MachineLimits measure_machine_limits(bool opengl) {
  MachineLimits out;
  out.multiply_adds_per_s = on_all_threads([] { return kernels::measure_multiply_adds(kSeconds); });
  out.bytes_per_s = on_all_threads(read_bytes);
  if (opengl) out.texels_per_s = measure_texel_fetches(kSeconds);
  return out;
}

}  // namespace stuv
