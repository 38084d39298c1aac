#include <fmt/format.h>
#include <sys/resource.h>

#include <chrono>
#include <cstdlib>
#include <cstring>

#include "core/parallel.h"
#include "tests/calib/uncertainty_tally.h"

// What a calibration states against what is true, and what it costs.
//
//   calibration_bench truth [RIGS]            errors over their sigmas and over the Cramer-Rao bound
//   calibration_bench growth [CAMERAS] [BOARDS..]  seconds and peak memory of one solve with all its verdict

using namespace stuv;
using namespace stuv::test;

namespace {

using Clock = std::chrono::steady_clock;

void print(const char* what, const Tally& t) {
  fmt::print("  {:14} error/sigma {:.3f}  error/bound {:.3f}  ({} errors)\n", what, t.z(), t.over_bound(),
             t.count);
}

void run_truth(int rigs) {
  struct Kind {
    const char* name;
    int rows, cols, boards;
    double noise_px;
  };
  for (const Kind& kind :
       {Kind{"3x3, 8 boards, 0.3 px", 3, 3, 8, 0.3}, Kind{"2x4, 5 boards, 1 px", 2, 4, 5, 1},
        Kind{"4x4, 15 boards, 0.05 px", 4, 4, 15, 0.05}}) {
    std::vector<Tallies> each(static_cast<std::size_t>(rigs));
    parallel_for(rigs, [&](int i) {
      each[static_cast<std::size_t>(i)] =
          tally(static_cast<unsigned>(i + 1000), kind.noise_px, kind.rows, kind.cols, kind.boards);
    });
    Tallies all;
    for (const Tallies& t : each) all.add(t);
    fmt::print("{}, {} rigs\n", kind.name, rigs);
    print("centres", all.centres);
    print("rotations", all.rotations);
    print("focal lengths", all.focals);
    print("lattice", all.lattice);
  }
}

double peak_mb() {
  rusage usage = {};
  getrusage(RUSAGE_SELF, &usage);
  return static_cast<double>(usage.ru_maxrss) / 1024;
}

void run_growth(int cameras, const std::vector<int>& boards) {
  const int rows = cameras >= 100 ? 10 : 1, cols = cameras / rows;
  for (const int n : boards) {
    const Scene scene = make_scene(rows, cols, n, {}, 0.2, 1, 3);
    const auto begin = Clock::now();
    const Calibration c = calibrate(scene.observations, scene.recording, {});
    const double seconds = std::chrono::duration<double>(Clock::now() - begin).count();
    CalibrationOptions bare;
    bare.most_folds = 0;
    const auto again = Clock::now();
    calibrate(scene.observations, scene.recording, bare);
    const double solve = std::chrono::duration<double>(Clock::now() - again).count();
    fmt::print(
        "{} cameras, {} boards, {} corners: {:.1f} s, without validation {:.1f} s, peak {:.0f} MB, {}\n",
        rows * cols, n, c.solution.inliers, seconds, solve, peak_mb(), c.good ? "good" : "not good");
  }
}

}  // namespace

int main(int argc, char** argv) {
  const auto number = [&](int i, int otherwise) { return argc > i ? std::atoi(argv[i]) : otherwise; };
  if (argc > 1 && std::strcmp(argv[1], "growth") == 0) {
    std::vector<int> boards;
    for (int i = 3; i < argc; ++i) boards.push_back(std::atoi(argv[i]));
    run_growth(number(2, 100), boards.empty() ? std::vector<int>{15, 30, 60} : boards);
    return 0;
  }
  run_truth(number(2, 200));
}
