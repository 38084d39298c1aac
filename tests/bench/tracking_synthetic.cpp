// The paper's table on synthetic sequences with truth: IRLS alone, the paper's filter, and all of ours.
//   bench_tracking_synthetic [PART of the sequences' names [FOLDER for pictures]]     prints one Markdown
//   table
#include <fmt/format.h>

#include <filesystem>
#include <numbers>

#include "calib/tracking/tracker.h"
#include "core/image_io.h"
#include "tests/support/tracking_scenes.h"

namespace {

using namespace stuv;
using namespace stuv::tracking;
using namespace stuv::test;

struct Sequence {
  std::string name;
  Scene scene;
  std::function<Pose(double)> pose;  // of the frame's number
  std::function<Disc(int)> disc = [](int) { return Disc{}; };
  int frames = 60;
  int blur = 1;
};

struct Row {
  Eigen::Matrix<double, 6, 1> sum_sq = Eigen::Matrix<double, 6, 1>::Zero();
  double t2 = 0, r2 = 0, seconds = 0;
  int count = 0, off = 0, flagged = 0, longest_unnoticed = 0, longest_recovery = 0;
};

/// The object is there if its middle is well inside the picture and not behind the disc.
bool is_there(const Sequence& s, const Camera& camera, const Pose& pose, int frame) {
  int seen = 0;
  for (const Eigen::Vector3d& v : s.scene.model.vertices) {
    const Eigen::Vector2d q = project(camera, {pose * v})[0];
    const Disc d = s.disc(frame);
    seen += q.x() > 0 && q.y() > 0 && q.x() < camera.width && q.y() < camera.height &&
                    (q - d.at).norm() > d.radius_px
                ? 1
                : 0;
  }
  return 10 * seen >= 8 * static_cast<int>(s.scene.model.vertices.size());
}

Row run(const Sequence& s, const Camera& camera, const std::vector<Grey>& pictures,
        const std::vector<Keyframe>& keyframes, const TrackerOptions& options) {
  Tracker tracker(s.scene.model, camera, keyframes, options);
  if (!options.filter) tracker.start(s.pose(0));  // in favour of IRLS alone, which has no way to start
  Row row;
  int unnoticed = 0, recovering = 0;
  for (int i = 0; i < s.frames; ++i) {
    const TrackedFrame f = tracker.track(pictures[i]);
    const Pose truth = s.pose(i);
    const Twist d = tracking::log(f.cam_from_object * truth.inverse());
    const double dt = (f.cam_from_object.t - truth.t).norm(), dr = d.tail<3>().norm();
    if (std::getenv("VERBOSE") != nullptr)
      fmt::print(
          "{:2} {:.2f} mm {:.2f} deg lost {} init {} edges {}/{} n_eff {:.1f} texture {} corr {:.2f} dev "
          "{:.2f}\n",
          i, 1e3 * dt, dr * 57.3, f.lost, f.initialised, f.edges.matched, f.edges.visible, f.n_eff,
          f.texture_points, f.correlation, f.deviation_px);
    row.seconds += f.seconds.total();
    const bool off = !f.has_pose || dt > 0.02 || dr > 8 * std::numbers::pi / 180;
    row.flagged += f.lost ? 1 : 0;
    unnoticed = off && !f.lost ? unnoticed + 1 : 0;
    row.longest_unnoticed = std::max(row.longest_unnoticed, unnoticed);
    const bool there = is_there(s, camera, truth, i);
    recovering = there && (off || f.lost) ? recovering + 1 : 0;
    row.longest_recovery = std::max(row.longest_recovery, recovering);
    if (!there) continue;
    if (off) {
      ++row.off;
      continue;
    }
    if (f.lost) continue;
    const Eigen::Matrix3d dR = f.cam_from_object.R * truth.R.transpose();
    const Eigen::Vector3d rpy(std::atan2(dR(2, 1), dR(2, 2)), -std::asin(std::clamp(dR(2, 0), -1.0, 1.0)),
                              std::atan2(dR(1, 0), dR(0, 0)));
    row.sum_sq.head<3>() += (f.cam_from_object.t - truth.t).cwiseAbs2();
    row.sum_sq.tail<3>() += rpy.cwiseAbs2();
    row.t2 += dt * dt, row.r2 += dr * dr;
    ++row.count;
  }
  return row;
}

void print(const std::string& sequence, const std::string& method, const Row& r, int frames) {
  const Eigen::Matrix<double, 6, 1> rms = (r.sum_sq / std::max(1, r.count)).cwiseSqrt();
  const double degrees = 180 / std::numbers::pi;
  fmt::print(
      "| {} | {} | {:.2f} | {:.2f} | {:.2f} | {:.2f} | {:.2f} | {:.2f} | {:.2f} | {:.2f} | {} | {} | {} | {} "
      "| {:.0f} |\n",
      sequence, method, 1e3 * rms[0], 1e3 * rms[1], 1e3 * rms[2], degrees * rms[3], degrees * rms[4],
      degrees * rms[5], 1e3 * std::sqrt(r.t2 / std::max(1, r.count)),
      degrees * std::sqrt(r.r2 / std::max(1, r.count)), r.off, r.flagged, r.longest_unnoticed,
      r.longest_recovery, 1e3 * r.seconds / frames);
  std::fflush(stdout);
}

Pose orbit(double i, double speed) {
  const double a = speed * i;
  return view_of(0.5 + 0.06 * std::sin(0.05 * a), 0.45 * std::sin(0.07 * a) + 0.3,
                 0.35 + 0.25 * std::cos(0.05 * a), 0.2 * std::sin(0.04 * a), 0.05 * std::sin(0.09 * a),
                 0.03 * std::cos(0.08 * a));
}

}  // namespace

int main(int argc, char** argv) {
  const std::filesystem::path temporary = std::filesystem::temp_directory_path() / "bench_tracking.obj";
  const Camera camera = plain_camera(640, 480, 700);
  struct Object {
    std::string name, obj;
    double texture, cell, floor;
  };
  const std::vector<Object> objects = {{"box", box_obj(0.12, 0.09, 0.07), 0.45, 0.011, 0.036},
                                       {"book", box_obj(0.16, 0.12, 0.025), 0.35, 0.016, 0.0126},
                                       {"cup", cylinder_obj(0.04, 0.1, 24), 0.4, 0.012, 0.041},
                                       {"door", door_obj(), 0.2, 0.02, 0.0121}};
  std::vector<Sequence> sequences;
  for (const bool cluttered : {false, true})
    for (const Object& o : objects) {
      Sequence s;
      s.scene.model = model_of(o.obj, temporary);
      s.scene.texture = o.texture;
      s.scene.cell = o.cell;
      s.scene.floor_z = o.floor;
      s.scene.cluttered = cluttered;
      s.scene.reach = 0.12;
      s.name = o.name + (cluttered ? ", cluttered" : ", plain");
      s.pose = [](double i) { return orbit(i, 1); };
      sequences.push_back(s);
    }
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

  const TrackerOptions ours;
  TrackerOptions paper, walk, alone, our_walk;
  paper.polish = paper.reweigh = false;
  walk = paper;
  walk.autoregression = our_walk.autoregression = 0;
  alone = paper;
  alone.filter = false;
  const std::vector<std::pair<std::string, TrackerOptions>> methods = {{"IRLS alone", alone},
                                                                       {"paper's filter, random walk", walk},
                                                                       {"paper's filter", paper},
                                                                       {"ours, random walk", our_walk},
                                                                       {"ours", ours}};
  fmt::print(
      "| sequence | method | x | y | z [mm] | roll | pitch | yaw [deg] | t [mm] | angle [deg] | off | "
      "flagged | longest unnoticed | longest recovery | ms |\n|{}\n",
      "---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|");
  for (const Sequence& s : sequences) {
    if (argc > 1 && s.name.find(argv[1]) == std::string::npos) continue;
    std::vector<Grey> pictures;
    for (int i = 0; i < s.frames; ++i) {
      std::vector<Pose> exposure;
      for (int k = 0; k < s.blur; ++k)
        exposure.push_back(s.pose(i + (s.blur > 1 ? 0.3 * (k / (s.blur - 1.0) - 0.5) : 0)));
      pictures.push_back(photograph(s.scene, camera, exposure, s.disc(i), 6, i));
      if (argc > 2 && i % 15 == 0) {
        Image image;
        image.width = camera.width, image.height = camera.height;
        image.bytes.resize(pictures.back().data.size());
        std::transform(pictures.back().data.begin(), pictures.back().data.end(), image.bytes.begin(),
                       [](std::uint8_t v) { return std::byte{v}; });
        write_image(std::filesystem::path(argv[2]) / fmt::format("{}_{:02}.png", s.name, i), image);
      }
    }
    std::vector<Keyframe> keyframes;
    // Taught before the sequence, on a plain ground, from three sides.
    Scene bare = s.scene;
    bare.cluttered = false;
    for (const double turn : {-0.2, 0.3, 0.75}) {
      const Pose pose = view_of(0.5, turn, 0.4);
      keyframes.push_back(teach_keyframe(fmt::format("{}", turn), photograph(bare, camera, {pose}),
                                         s.scene.model, camera, pose));
    }
    for (const auto& [name, options] : methods)
      print(s.name, name, run(s, camera, pictures, keyframes, options), s.frames);
  }
}
