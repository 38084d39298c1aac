// The paper's table on synthetic sequences with truth: IRLS alone, the paper's filter, and all of ours.
//   bench_tracking_synthetic [only=PART of names] [methods=PART of names] [seeds=3] [pictures=FOLDER]
//   [verbose=1]
// Prints one Markdown table. Pictures are kept in the folder (build/bench/tracking) and made once; remove it
// when the scenes change. Errors are rms over all frames in which the object can be seen and a pose was
// given, whatever the method thinks of it; "good" leaves out those off by more than 2 cm or 8 degrees.
#include <fmt/format.h>
#include <unistd.h>

#include <ctime>
#include <filesystem>
#include <map>
#include <numbers>

#include "calib/tracking/tracker.h"
#include "core/image_io.h"
#include "tests/support/tracking_scenes.h"

namespace {

using namespace stuv;
using namespace stuv::tracking;
using namespace stuv::test;
namespace fs = std::filesystem;

constexpr double kDegree = 180 / std::numbers::pi;

struct Sequence {
  std::string name;
  Scene scene;
  Camera camera = plain_camera(640, 480, 700);
  std::function<Pose(double)> pose;  // of the frame's number
  std::function<Disc(int)> disc = [](int) { return Disc{}; };
  std::function<double(int)> gain = [](int) { return 1.0; };
  int frames = 60;
  int blur = 1;          // samples of the exposure
  double shutter = 0.3;  // of a frame's time
  double noise = 6;
  std::vector<Pose> taught = {};  // on a plain ground
  bool taught_in_place = false;   // or in the sequence's own surroundings
};

struct Row {
  double t2 = 0, r2 = 0, good_t2 = 0, good_r2 = 0, seconds = 0, cpu_seconds = 0;
  int there = 0, posed = 0, good = 0, flagged = 0, unnoticed = 0, longest_unnoticed = 0, longest_recovery = 0,
      frames = 0;
};

/// The object is there if four fifths of its corners are in the picture and not behind the disc.
bool is_there(const Sequence& s, const Pose& pose, int frame) {
  int seen = 0;
  for (const Eigen::Vector3d& v : s.scene.model.vertices) {
    const Eigen::Vector2d q = project(s.camera, {pose * v})[0];
    const Disc d = s.disc(frame);
    seen += q.x() > 0 && q.y() > 0 && q.x() < s.camera.width && q.y() < s.camera.height &&
                    (q - d.at).norm() > d.radius_px
                ? 1
                : 0;
  }
  return 10 * seen >= 8 * static_cast<int>(s.scene.model.vertices.size());
}

void run(const Sequence& s, const std::vector<Grey>& pictures, const std::vector<Keyframe>& keyframes,
         const TrackerOptions& options, bool verbose, Row& row) {
  Tracker tracker(s.scene.model, s.camera, keyframes, options);
  if (!options.filter) tracker.start(s.pose(0));  // in favour of IRLS alone, which has no way to start
  int unnoticed = 0, recovering = 0;
  for (int i = 0; i < s.frames; ++i) {
    const std::clock_t before = std::clock();
    const TrackedFrame f = tracker.track(pictures[i]);
    row.cpu_seconds += double(std::clock() - before) / CLOCKS_PER_SEC;
    const Pose truth = s.pose(i);
    const double dt = (f.cam_from_object.t - truth.t).norm(),
                 dr = tracking::log({f.cam_from_object.R * truth.R.transpose(), {0, 0, 0}}).norm();
    const bool there = is_there(s, truth, i);
    const bool off = !f.has_pose || dt > 0.02 || dr > 8 / kDegree;
    if (verbose)
      fmt::print(
          "{:2} {:.2f} mm {:.2f} deg{}{}{}{} edges {}/{} n_eff {:.1f} of {} texture {} corr {:.2f} like "
          "{:.2f} fit {:.2f} print {:.2f} dev "
          "{:.2f}, {:.1f} "
          "ms (g {:.1f} k {:.1f} t {:.1f} f {:.1f} e {:.1f})\n",
          i, 1e3 * dt, dr * kDegree, there ? "" : " GONE", f.lost ? " lost" : "",
          f.initialised ? " init" : "", off && !f.lost ? " UNNOTICED" : "", f.edges.matched, f.edges.visible,
          f.n_eff, f.particles, f.texture_points, f.correlation, f.likeness, f.fit, f.print, f.deviation_px,
          1e3 * f.seconds.total, 1e3 * f.seconds.gradient, 1e3 * f.seconds.keypoints, 1e3 * f.seconds.texture,
          1e3 * f.seconds.filter, 1e3 * f.seconds.estimate);
    row.seconds += f.seconds.total;
    ++row.frames;
    row.flagged += f.lost ? 1 : 0;
    unnoticed = off && !f.lost ? unnoticed + 1 : 0;
    row.unnoticed += unnoticed > 0 ? 1 : 0;
    row.longest_unnoticed = std::max(row.longest_unnoticed, unnoticed);
    recovering = there && (off || f.lost) ? recovering + 1 : 0;
    row.longest_recovery = std::max(row.longest_recovery, recovering);
    if (!there) continue;
    ++row.there;
    if (!f.has_pose) continue;
    ++row.posed;
    row.t2 += dt * dt, row.r2 += dr * dr;
    if (off || f.lost) continue;
    ++row.good;
    row.good_t2 += dt * dt, row.good_r2 += dr * dr;
  }
}

void print(const std::string& sequence, const std::string& method, const Row& r) {
  const auto rms = [](double sum_sq, int n) { return n > 0 ? std::sqrt(sum_sq / n) : std::nan(""); };
  fmt::print(
      "| {} | {} | {:.2f} | {:.2f} | {:.2f} | {:.2f} | {} of {} | {} | {} | {} | {} | {:.1f} | {:.1f} |\n",
      sequence, method, 1e3 * rms(r.t2, r.posed), kDegree * rms(r.r2, r.posed), 1e3 * rms(r.good_t2, r.good),
      kDegree * rms(r.good_r2, r.good), r.good, r.there, r.flagged, r.unnoticed, r.longest_unnoticed,
      r.longest_recovery, 1e3 * r.seconds / r.frames, 1e3 * r.cpu_seconds / r.frames);
  std::fflush(stdout);
}

Pose orbit(double i, double speed) {
  const double a = speed * i;
  return view_of(0.5 + 0.06 * std::sin(0.05 * a), 0.45 * std::sin(0.07 * a) + 0.3,
                 0.35 + 0.25 * std::cos(0.05 * a), 0.2 * std::sin(0.04 * a), 0.05 * std::sin(0.09 * a),
                 0.03 * std::cos(0.08 * a));
}

/// A hand's tremor on top of the orbit: 1 mm and 0.2 degrees at 5 to 11 Hz of 30 frames a second, some 5 px a
/// frame.
Pose hand_held(double i, double speed) {
  Pose p = orbit(i, speed);
  p.t += 0.001 *
         Eigen::Vector3d(std::sin(1.1 * i) + std::sin(2.3 * i + 1), std::cos(1.3 * i) + std::sin(1.9 * i), 0);
  const Eigen::Vector3d turn =
      0.0035 * Eigen::Vector3d(std::sin(1.7 * i + 2), std::sin(1.2 * i + 4), std::sin(0.9 * i + 5));
  return Pose{rotation_from_vector(turn), Eigen::Vector3d::Zero()} * p;
}

struct Object {
  std::string name, obj;
  double texture, cell, floor;
};

std::vector<Object> objects() {
  return {{"box", box_obj(0.12, 0.09, 0.07), 0.45, 0.011, 0.036},
          {"book", box_obj(0.16, 0.12, 0.025), 0.35, 0.016, 0.0126},
          {"cup", cylinder_obj(0.04, 0.1, 24), 0.4, 0.012, 0.041},
          {"door", door_obj(), 0.2, 0.02, 0.0121}};
}

Sequence sequence_of(const Object& o, bool cluttered) {
  const fs::path temporary = fs::temp_directory_path() / fmt::format("bench_tracking_{}.obj", ::getpid());
  Sequence s;
  s.scene.model = model_of(o.obj, temporary);
  fs::remove(temporary);
  s.scene.texture = o.texture;
  s.scene.cell = o.cell;
  s.scene.floor_z = o.floor;
  s.scene.cluttered = cluttered;
  s.scene.reach = 0.15;
  s.name = o.name + (cluttered ? ", cluttered" : ", plain");
  s.pose = [](double i) { return orbit(i, 1); };
  for (const double turn : {-0.2, 0.3, 0.75}) s.taught.push_back(view_of(0.5, turn, 0.4));
  return s;
}

Camera distorted(Camera camera) {
  camera.lens_model = "LENSMODEL_OPENCV4";
  camera.intrinsics.insert(camera.intrinsics.end(), {-0.25, 0.08, 0.001, -0.001});
  return camera;
}

/// Hand-held among scraps: a lens with distortion, an exposure that drifts, noise, blur; taught from frames
/// of its own.
Sequence hand_held_cube(const std::string& name, bool textured) {
  Sequence cube = sequence_of({"cube", box_obj(0.08, 0.08, 0.08), textured ? 0.4 : 0.0, 0.012, 0.041}, true);
  cube.name = name;
  cube.camera = distorted(cube.camera);
  cube.pose = [](double i) { return hand_held(i, 1.5); };
  cube.gain = [](int i) { return 0.85 + 0.25 * std::sin(0.15 * i); };
  cube.blur = 3;
  cube.noise = 14;
  cube.taught_in_place = true;
  cube.scene.grid = false;
  cube.taught = {cube.pose(0), cube.pose(25), cube.pose(50)};
  return cube;
}

/// Sequences like the paper's, and with what a hand-held camera adds.
std::vector<Sequence> all_sequences() {
  std::vector<Sequence> sequences;
  for (const bool cluttered : {false, true})
    for (const Object& o : objects()) sequences.push_back(sequence_of(o, cluttered));
  Sequence fast = sequences[0];
  fast.name = "box, fast";
  fast.pose = [](double i) { return orbit(i, 4.5); };
  Sequence out = sequences[4];
  out.name = "box, leaves the picture";
  out.pose = [](double i) {
    Pose p = orbit(i, 1);
    if (i > 20 && i < 40) p.t.x() += 0.5 * std::sin(M_PI * (i - 20) / 20);
    return p;
  };
  Sequence hidden = sequences[4];
  hidden.name = "box, occluded";
  hidden.disc = [](int i) { return Disc{{60.0 + 18 * (i - 10), 240}, i >= 10 && i < 45 ? 110.0 : 0.0}; };
  Sequence shaken = sequences[5];
  shaken.name = "book, shaken and blurred";
  shaken.pose = [](double i) {
    Pose p = orbit(i, 1);
    if (i > 20 && i < 35) p.t += 0.03 * Eigen::Vector3d(std::sin(2.1 * i), std::cos(1.7 * i), 0);
    return p;
  };
  shaken.blur = 5;
  for (const Sequence& s : {fast, out, hidden, shaken}) sequences.push_back(s);
  for (const bool textured : {true, false}) {
    const std::string name = textured ? "cube" : "cube without texture";
    sequences.push_back(hand_held_cube(name + ", hand-held", textured));
    Sequence grid = hand_held_cube(name + " on a grid, hand-held", textured);
    grid.scene.grid = true;
    Sequence quick = grid, small = grid;
    quick.name = name + " on a grid, twice as quick";
    quick.pose = [](double i) { return hand_held(2 * i, 1.5); };
    quick.taught = {quick.pose(0), quick.pose(25), quick.pose(50)};
    small.name = name + " on a grid, 384x288";
    small.camera = distorted(plain_camera(384, 288, 420));
    for (const Sequence& s : {grid, quick, small}) sequences.push_back(s);
  }
  return sequences;
}

Grey picture_of(const Sequence& s, int i) {
  std::vector<Pose> exposure;
  for (int k = 0; k < s.blur; ++k)
    exposure.push_back(s.pose(i + (s.blur > 1 ? s.shutter * (k / (s.blur - 1.0) - 0.5) : 0)));
  Scene scene = s.scene;
  scene.gain = s.gain(i);
  return photograph(scene, s.camera, exposure, s.disc(i), s.noise, i);
}

/// From the folder, or made and put there.
Grey kept_picture(const Sequence& s, int i, const fs::path& folder) {
  const fs::path file = folder / fmt::format("{}_{:02}.png", s.name, i);
  if (fs::exists(file)) {
    const Image image = read_image(file);
    Grey grey(image.width, image.height, 1);
    std::transform(image.bytes.begin(), image.bytes.end(), grey.data.begin(),
                   [](std::byte b) { return static_cast<std::uint8_t>(b); });
    return grey;
  }
  Grey grey = picture_of(s, i);
  Image image;
  image.width = grey.width, image.height = grey.height;
  image.bytes.resize(grey.data.size());
  std::transform(grey.data.begin(), grey.data.end(), image.bytes.begin(),
                 [](std::uint8_t v) { return std::byte{v}; });
  write_image(file, image);
  return grey;
}

std::vector<Keyframe> teach(const Sequence& s) {
  Scene scene = s.scene;
  scene.cluttered = s.taught_in_place && s.scene.cluttered;
  std::vector<Keyframe> keyframes;
  for (const Pose& pose : s.taught)
    keyframes.push_back(teach_keyframe(fmt::format("{}", keyframes.size()),
                                       photograph(scene, s.camera, {pose}, {}, s.noise, 999), s.scene.model,
                                       s.camera, pose));
  return keyframes;
}

std::vector<std::pair<std::string, TrackerOptions>> all_methods() {
  const TrackerOptions ours;
  TrackerOptions paper, walk, alone, our_walk;
  paper.polish = paper.reweigh = false;
  walk = paper;
  walk.autoregression = our_walk.autoregression = 0;
  alone = paper;
  alone.filter = false;
  return {{"IRLS alone", alone},
          {"paper's filter, random walk", walk},
          {"paper's filter", paper},
          {"ours, random walk", our_walk},
          {"ours", ours}};
}

}  // namespace

int main(int argc, char** argv) {
  std::map<std::string, std::string> given = {
      {"only", ""}, {"methods", ""}, {"seeds", "3"}, {"pictures", "build/bench/tracking"}, {"verbose", "0"}};
  for (int i = 1; i < argc; ++i) {
    const std::string a = argv[i];
    const std::string key = a.substr(0, a.find('='));
    if (given.count(key) == 0 || a.size() == key.size()) return fmt::print("unknown argument {}\n", a), 2;
    given[key] = a.substr(a.find('=') + 1);
  }
  fs::create_directories(given["pictures"]);
  fmt::print(
      "| sequence | method | t [mm] | angle [deg] | t, good | angle, good | good | flagged | unnoticed | "
      "longest "
      "unnoticed | longest recovery | ms | ms of processor |\n|{}\n",
      "---|---|---|---|---|---|---|---|---|---|---|---|---|");
  for (const Sequence& s : all_sequences()) {
    if (s.name.find(given["only"]) == std::string::npos) continue;
    std::vector<Grey> pictures;
    for (int i = 0; i < s.frames; ++i) pictures.push_back(kept_picture(s, i, given["pictures"]));
    const std::vector<Keyframe> keyframes = teach(s);
    if (given["verbose"] != "0")
      for (const Keyframe& k : keyframes) fmt::print("keyframe {}: {} keypoints\n", k.name, k.points.size());
    for (auto& [name, options] : all_methods()) {
      if (name.find(given["methods"]) == std::string::npos && given["methods"] != name) continue;
      if (given["methods"] == "ours" && name != "ours") continue;
      Row row;
      // IRLS alone draws nothing.
      const int seeds = options.filter ? std::stoi(given["seeds"]) : 1;
      for (int seed = 1; seed <= seeds; ++seed) {
        TrackerOptions seeded = options;
        seeded.seed = static_cast<std::uint64_t>(seed);
        run(s, pictures, keyframes, seeded, given["verbose"] != "0", row);
      }
      print(s.name, name, row);
    }
  }
}
