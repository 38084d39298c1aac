// Tracking on ../shared/data/castle against the truth: rms of |t| and of the rotation angle over the frames
// that are neither taught nor lost, for a number of seeds.
//   bench_tracking_castle DATA/castle [seeds=20] [step=1] [teach=1,14,27] [particles=100] [ar=0.5] ...
#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <ctime>
#include <fstream>
#include <map>
#include <sstream>

#include "calib/tracking/tracker.h"
#include "core/image_io.h"

namespace {

using namespace stuv;
using namespace stuv::tracking;

Pose read_pose(const std::string& file) {
  std::ifstream in(file);
  Eigen::Matrix4d m;
  for (int i = 0; i < 16; ++i) in >> m(i / 4, i % 4);
  if (!in) throw std::runtime_error(file + " is no 4x4 matrix");
  return {m.topLeftCorner<3, 3>(), m.topRightCorner<3, 1>()};
}

Grey read_grey(const std::string& file) {
  const Image image = read_image(file);
  Grey grey(image.width, image.height, 1);
  for (std::size_t i = 0; i < grey.data.size(); ++i)
    grey.data[i] = static_cast<std::uint8_t>(image.bytes[i * image.channels]);
  return grey;
}

struct Sums {
  double t2 = 0, r2 = 0, seconds = 0, cpu_seconds = 0, worst_fraction = 1;
  int count = 0, lost = 0, unnoticed = 0, flagged = 0, frames = 0;
};

}  // namespace

int main(int argc, char** argv) {
  if (argc < 2) return fmt::print("usage: bench_tracking_castle DATA/castle [key=value ...]\n"), 2;
  const std::string data = argv[1];
  std::map<std::string, std::string> given;
  for (int i = 2; i < argc; ++i) {
    const std::string a = argv[i];
    given[a.substr(0, a.find('='))] = a.substr(a.find('=') + 1);
  }
  const auto number = [&](const std::string& key, double fallback) {
    return given.count(key) > 0 ? std::stod(given[key]) : fallback;
  };
  Camera camera;
  camera.name = "castle";
  camera.intrinsics = {700, 700, 320, 240};
  camera.width = 640;
  camera.height = 480;
  TrackerOptions options;
  options.particles = static_cast<int>(number("particles", options.particles));
  options.autoregression = number("ar", options.autoregression);
  options.noise_px = number("noise", options.noise_px);
  options.search_px = number("search", options.search_px);
  options.spacing_px = number("spacing", options.spacing_px);
  options.contrast = number("contrast", options.contrast);
  options.least_cosine = number("cosine", options.least_cosine);
  options.likelihood.lambda_v = number("lv", options.likelihood.lambda_v);
  options.likelihood.lambda_e = number("le", options.likelihood.lambda_e);
  options.texture = number("texture", 1) != 0;
  options.reweigh = number("reweigh", 1) != 0;
  options.filter = number("filter", 1) != 0;
  options.adaptive = number("adaptive", 0) != 0;
  options.lost_part = number("lost", options.lost_part);
  const ObjectModel model = read_obj(data + "/castle.obj");
  const int step = static_cast<int>(number("step", 1));
  std::vector<int> taught;
  std::istringstream list(given.count("teach") > 0 ? given["teach"] : step == 1 ? "1,14,27" : "1");
  for (std::string item; std::getline(list, item, ',');) taught.push_back(std::stoi(item));
  std::vector<Keyframe> keyframes;
  const auto picture = [&](int i) { return read_grey(fmt::format("{}/Images/Image_{:04}.png", data, i)); };
  const auto truth = [&](int i) { return read_pose(fmt::format("{}/CameraPose/Camera_{:03}.txt", data, i)); };
  for (const int i : taught) {
    keyframes.push_back(teach_keyframe(std::to_string(i), picture(i), model, camera, truth(i)));
    fmt::print("keyframe {}: {} keypoints\n", i, keyframes.back().points.size());
  }
  Sums all;
  std::vector<double> frame_ms;
  for (int seed = 1; seed <= number("seeds", 20); ++seed) {
    options.seed = static_cast<std::uint64_t>(seed);
    Tracker tracker(model, camera, keyframes, options);
    Sums s;
    for (int i = 1; i <= 40; i += step) {
      const Grey frame = picture(i);
      const std::clock_t before = std::clock();
      const TrackedFrame f = tracker.track(frame);
      s.cpu_seconds += double(std::clock() - before) / CLOCKS_PER_SEC;
      frame_ms.push_back(1e3 * f.seconds.total);
      const Pose true_pose = truth(i);
      const double dt = (f.cam_from_object.t - true_pose.t).norm();
      const double dr = log({f.cam_from_object.R * true_pose.R.transpose(), {0, 0, 0}}).norm() * 180 / M_PI;
      if (number("verbose", 0) > 0)
        fmt::print(
            "{:3} {:6.2f} mm {:5.2f} deg  lost {}  init {} n_eff {:5.1f} edges {}/{} {:.2f} px  texture {} "
            "corr {:.2f} fit {:.2f} print {:.2f} rivals {:.2f} sigma "
            "{:.2f} px, {:.2f} mm {:.2f} deg, {:.1f} ms (g {:.1f} k {:.1f} t {:.1f} f {:.1f} e {:.1f})\n",
            i, 1e3 * dt, dr, f.lost, f.initialised, f.n_eff, f.edges.matched, f.edges.visible,
            f.edges.mean_distance_px, f.texture_points, f.correlation, f.fit, f.print, f.rivals,
            f.deviation_px, 1e3 * std::sqrt(f.covariance.topLeftCorner<3, 3>().trace()),
            180 / M_PI * std::sqrt(f.covariance.bottomRightCorner<3, 3>().trace()), 1e3 * f.seconds.total,
            1e3 * f.seconds.gradient, 1e3 * f.seconds.keypoints, 1e3 * f.seconds.texture,
            1e3 * f.seconds.filter, 1e3 * f.seconds.estimate);
      s.seconds += f.seconds.total;
      ++s.frames;
      if (f.edges.visible > 0)
        s.worst_fraction = std::min(s.worst_fraction, double(f.edges.matched) / f.edges.visible);
      const bool off = !f.has_pose || dt > 0.01 || dr > 5;
      s.flagged += f.lost ? 1 : 0;
      s.unnoticed += off && !f.lost ? 1 : 0;
      if (off || f.lost) {
        ++s.lost;
        continue;
      }
      if (std::find(taught.begin(), taught.end(), i) != taught.end()) continue;
      s.t2 += dt * dt;
      s.r2 += dr * dr;
      ++s.count;
    }
    fmt::print(
        "seed {:2}: {:.3f} mm {:.3f} deg, {} lost ({} flagged, {} unnoticed), least matched {:.2f}, {:.1f} "
        "ms a frame, {:.1f} ms of processor\n",
        seed, 1e3 * std::sqrt(s.t2 / s.count), std::sqrt(s.r2 / s.count), s.lost, s.flagged, s.unnoticed,
        s.worst_fraction, 1e3 * s.seconds / s.frames, 1e3 * s.cpu_seconds / s.frames);
    all.t2 += s.t2, all.r2 += s.r2, all.count += s.count, all.lost += s.lost, all.seconds += s.seconds,
        all.cpu_seconds += s.cpu_seconds, all.frames += s.frames;
  }
  std::sort(frame_ms.begin(), frame_ms.end());
  fmt::print(
      "all: {:.3f} mm {:.3f} deg, {} frames lost; {:.1f} ms a frame, {:.1f} the fastest quarter, {:.1f} ms "
      "of "
      "processor\n",
      1e3 * std::sqrt(all.t2 / all.count), std::sqrt(all.r2 / all.count), all.lost,
      1e3 * all.seconds / all.frames, frame_ms[frame_ms.size() / 4], 1e3 * all.cpu_seconds / all.frames);
}
