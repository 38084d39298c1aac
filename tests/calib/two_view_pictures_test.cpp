#include <cmath>
#include <limits>

#include "calib/two_view/disparity.h"
#include "calib/two_view/estimate.h"
#include "calib/two_view/match_pictures.h"
#include "calib/two_view/no_board.h"
#include "calib/two_view/rectify_pair.h"
#include "calib/two_view/refine_tracks.h"
#include "core/error.h"
#include "core/image_io.h"
#include "core/json.h"
#include "tests/calib/two_view_scenes.h"
#include "tests/support/support.h"

using namespace stuv;
using namespace stuv::test;
using Catch::Contains;

namespace {

/// Random dots of 2 px, blurred by being bilinear.
ImageF dots(int width, int height, unsigned seed) {
  SceneMaker maker(seed);
  ImageF coarse(width / 2 + 2, height / 2 + 2, 1);
  for (float& v : coarse.data) v = static_cast<float>(0.5 + 0.5 * maker.uniform());
  ImageF out(width, height, 1);
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; ++x) {
      const float fx = 0.5F * static_cast<float>(x), fy = 0.5F * static_cast<float>(y);
      const int ix = static_cast<int>(fx), iy = static_cast<int>(fy);
      const float tx = fx - static_cast<float>(ix), ty = fy - static_cast<float>(iy);
      out.at(x, y) = (1 - ty) * ((1 - tx) * coarse.at(ix, iy) + tx * coarse.at(ix + 1, iy)) +
                     ty * ((1 - tx) * coarse.at(ix, iy + 1) + tx * coarse.at(ix + 1, iy + 1));
    }
  return out;
}

/// B such that the pixel (x, y) of A is at (x + D, y): background D = -10, a square D = -30.
struct StereoPair {
  Image a, b;
  ImageF truth;
};
StereoPair stereo_pair() {
  const int w = 320, h = 200;
  const ImageF back = dots(w + 100, h, 1), front = dots(w + 100, h, 2);
  ImageF a(w, h, 1), b(w, h, 1), truth(w, h, 1);
  const auto in_square = [](int x, int y) { return x >= 120 && x < 200 && y >= 60 && y < 140; };
  for (int y = 0; y < h; ++y)
    for (int x = 0; x < w; ++x) {
      a.at(x, y) = in_square(x, y) ? front.at(x, y) : back.at(x, y);
      truth.at(x, y) = in_square(x, y) ? -30.0F : -10.0F;
      b.at(x, y) = in_square(x + 30, y) ? front.at(x + 30, y) : back.at(x + 10, y);
    }
  return {from_float(a, PixelType::u8), from_float(b, PixelType::u8), truth};
}

double epipolar_rows_error(const RectifiedPair& pair, const Matches& matches) {
  double worst = 0;
  int seen = 0;
  for (std::size_t i = 0; i < matches.size(); i += pair.polar ? 20 : 1)
    if (const auto m = rectified(pair, matches[i]))
      worst = std::max(worst, std::abs(m->a.y() - m->b.y())), ++seen;
  REQUIRE(seen >= 5);
  return worst;
}

Image grey(int width, int height) { return from_float(dots(width, height, 3), PixelType::u8); }

}  // namespace

TEST_CASE("disparity of a square before a wall, with its edges, and the neighbour rebuilt from it") {
  const StereoPair pair = stereo_pair();
  for (const int low : {-40, -200}) {  // one level, and a pyramid
    const Disparity d = find_disparity(pair.a, pair.b, {.min_px = low, .max_px = 0});
    int wrong = 0, sure_and_wrong = 0, sure = 0;
    for (std::size_t i = 0; i < d.d_px.data.size(); ++i) {
      const bool bad = !(std::abs(d.d_px.data[i] - pair.truth.data[i]) < 1);
      wrong += bad;
      sure += d.confidence.data[i] > 0;
      sure_and_wrong += bad && d.confidence.data[i] > 0;
    }
    CHECK(wrong < 0.03 * double(d.d_px.data.size()));
    CHECK(sure > 0.85 * double(d.d_px.data.size()));
    CHECK(sure_and_wrong < 0.015 * double(d.d_px.data.size()));
    const Image again = rebuild(pair.b, d);
    const ImageF x = to_float(again), y = to_float(pair.a);
    double sum = 0, n = 0;
    for (std::size_t i = 0; i < x.data.size(); ++i)
      if (again.mask.data[i] != 0) sum += std::abs(x.data[i] - y.data[i]), ++n;
    CHECK(sum / n < 0.02);
  }
}

TEST_CASE("disparity: masked, tiny and textureless pictures are no trouble") {
  StereoPair pair = stereo_pair();
  pair.a.mask = Mask(pair.a.width, pair.a.height, 1, 255);
  for (int y = 0; y < 50; ++y)
    for (int x = 0; x < 50; ++x) pair.a.mask.at(x, y) = 0;
  const Disparity d = find_disparity(pair.a, pair.b, {.min_px = -40, .max_px = 0});
  CHECK(std::isnan(d.d_px.at(10, 10)));
  CHECK(std::abs(d.d_px.at(150, 100) + 30) < 1);
  // What B lacks is not found there, whatever else looks alike.
  pair.b.mask = Mask(pair.b.width, pair.b.height, 1, 255);
  for (int y = 150; y < pair.b.height; ++y)
    for (int x = 0; x < pair.b.width; ++x) pair.b.mask.at(x, y) = 0;
  const Disparity half = find_disparity(pair.a, pair.b, {.min_px = -40, .max_px = 0});
  int found = 0;
  for (int y = 150; y < pair.b.height; ++y)
    for (int x = 0; x < pair.b.width; ++x) found += half.confidence.at(x, y) > 0 ? 1 : 0;
  CHECK(found == 0);
  CHECK(half.confidence.at(150, 100) > 0);
  const Image flat = from_float(ImageF(64, 48, 1, 0.5F), PixelType::u8);
  CHECK(find_disparity(flat, flat, {.min_px = -8, .max_px = 8}).d_px.data.size() == 64U * 48U);
  const Image dot = from_float(ImageF(1, 1, 3, 0.5F), PixelType::u8);
  CHECK(find_disparity(dot, dot, {}).d_px.data.size() == 1);
  CHECK(find_disparity(flat, dot, {}).d_px.empty());
}

TEST_CASE("planar rectification: matches on one row, whole pictures, little distortion") {
  for (unsigned seed = 0; seed < 8; ++seed) {
    SceneMaker maker(seed);
    const TwoViewScene s = maker.make({.points = 100});
    const auto H = rectifying_homographies(s.F, s.exact, {640, 480}, {640, 480});
    if (!H) continue;  // an epipole near the picture
    const RectifiedPair pair = rectify_planar(grey(640, 480), grey(640, 480), *H);
    CHECK(epipolar_rows_error(pair, s.exact) < 1e-6);
    CHECK(pair.a.width <= 1280);
    CHECK(pair.a.height <= 960);
    // Calibrated: the same promise.
    const RectifiedPair calibrated =
        rectify_planar(grey(640, 480), grey(640, 480), rectifying_homographies(s.K, s.K, s.b_from_a));
    CHECK(epipolar_rows_error(calibrated, s.exact) < 1e-6);
  }
}

TEST_CASE("polar rectification where planar is impossible: epipole in the picture") {
  for (unsigned seed = 0; seed < 3; ++seed) {
    SceneMaker maker(seed);
    const TwoViewScene s = maker.make({.points = 300, .forward = true, .baseline = 1});
    CHECK_FALSE(rectifying_homographies(s.F, s.exact, {640, 480}, {640, 480}));
    const auto pair = rectify_pair(grey(640, 480), grey(640, 480), s.F, s.exact);
    REQUIRE(pair);
    CHECK(pair->polar);
    CHECK(pair->a.height == pair->b.height);
    // Rows are pixels; a match near the epipole covers several.
    Matches far;
    const Eigen::Vector2d e = epipole_a(s.F).hnormalized();
    for (const Match& m : s.exact)
      if ((m.a - e).norm() > 150) far.push_back(m);
    CHECK(epipolar_rows_error(*pair, far) < 8);
  }
}

TEST_CASE("polar rectification leaves pictures the right way up on either side of the epipole") {
  for (const double e_x : {-150.0, 790.0}) {
    const Eigen::Vector2d e(e_x, 250);
    Matches matches;
    for (int i = 0; i < 300; ++i) {
      const Eigen::Vector2d a(40 + 27 * (i % 20), 40 + 26 * (i / 20));
      matches.push_back({a, e + 1.05 * (a - e)});
    }
    const auto pair = rectify_polar(grey(640, 480), grey(640, 480), cross_matrix(e.homogeneous()), matches);
    REQUIRE(pair);
    CHECK(epipolar_rows_error(*pair, matches) < 2);
    for (const ImageF* from : {&pair->from_a, &pair->from_b}) {
      const int x = from->width / 2, y = from->height / 2;
      CHECK(from->at(x + 50, y, 0) > from->at(x - 50, y, 0));
      CHECK(from->at(x, y + 50, 1) > from->at(x, y - 50, 1));
    }
  }
}

TEST_CASE("pictures are matched by features, along epipolar lines, and by corners") {
  const StereoPair pair = stereo_pair();
  const Features fa = detect_features(pair.a), fb = detect_features(pair.b);
  const auto count_right = [](const Matches& m) {
    int right = 0;
    for (const Match& q : m) {
      const double d = q.b.x() - q.a.x();
      right += std::abs(q.a.y() - q.b.y()) < 1 && (std::abs(d + 10) < 1 || std::abs(d + 30) < 1);
    }
    return right;
  };
  const Matches plain = match_features(fa, fb);
  CHECK(count_right(plain) > 100);
  CHECK(count_right(plain) > 0.95 * double(plain.size()));
  Eigen::Matrix3d rows;
  rows << 0, 0, 0, 0, 0, -1, 0, 1, 0;
  const Matches guided = guided_matches(fa, fb, rows, 1.5);
  CHECK(count_right(guided) > count_right(plain));
  const Matches corners = match_corners(pair.a, pair.b, 40);
  CHECK(count_right(corners) > 100);
  CHECK(count_right(corners) > 0.9 * double(corners.size()));
  CHECK(match_corners(pair.a, from_float(ImageF(64, 48, 1, 0.5F), PixelType::u8), 40).empty());
}

TEST_CASE("an array without a board: places to three sigma, lens known or one focal length") {
  for (const bool focal_known : {true, false}) {
    SceneMaker maker(5);
    Recording recording;
    recording.rows = recording.cols = 5;
    SfmProblem problem;
    problem.cameras = 25;
    problem.focal_px = focal_known ? 600 : 660;
    problem.focal_known = focal_known;
    NoBoardOptions options;
    options.spacing_m = 0.03;
    std::vector<Pose> truth;
    for (int i = 0; i < 25; ++i) {
      const std::string name = "c" + std::to_string(i);
      recording.cameras.push_back({name, i / 5, i % 5});
      Pose pose;
      pose.R =
          rotation_from_vector(0.01 * Eigen::Vector3d(maker.uniform(), maker.uniform(), maker.uniform()));
      const Eigen::Vector3d centre(0.03 * (i % 5 - 2) + 0.001 * maker.uniform(),
                                   0.03 * (i / 5 - 2) + 0.001 * maker.uniform(), 0.001 * maker.uniform());
      pose.t = -(pose.R * centre);
      truth.push_back(pose);
      options.lenses.push_back({name, "LENSMODEL_PINHOLE", {600, 600, 319.5, 239.5}, 640, 480, {}});
    }
    for (int k = 0; k < 400; ++k) {
      const double z = 1 + 0.8 * maker.uniform();
      const Eigen::Vector3d X(0.5 * z * maker.uniform(), 0.4 * z * maker.uniform(), z);
      Track t;
      for (int i = 0; i < 25; ++i) {
        const Eigen::Vector2d at = 600 * (truth[i] * X).hnormalized() + maker.noise(0.3);
        if (std::abs(at.x()) > 320 || std::abs(at.y()) > 240) continue;
        t.camera.push_back(i);
        t.at_px.push_back(
            maker.uniform() > 0.98 ? Eigen::Vector2d(300 * maker.uniform(), 200 * maker.uniform()) : at);
      }
      if (t.camera.size() > 1) problem.tracks.push_back(t);
    }
    const Calibration c = calibrate_without_board(problem, recording, options);
    REQUIRE(c.solution.converged);
    CHECK(c.good);
    CHECK(c.solution.rms_px == Approx(0.3).epsilon(0.1));
    // Aligned by a similarity, as the covariance is.
    Eigen::Matrix3Xd found(3, 25), exact(3, 25);
    for (int i = 0; i < 25; ++i) {
      found.col(i) = c.rig.cameras[i].camera.cam_from_rig.centre();
      exact.col(i) = truth[i].centre();
    }
    const Eigen::Matrix3Xd aligned =
        (Eigen::umeyama(found, exact, true) * found.colwise().homogeneous()).topRows<3>();
    double sum = 0;
    for (int i = 0; i < 25; ++i) {
      const Eigen::Vector3d sigma = c.rig.cameras[i].position_sigma_m;
      const Eigen::Vector3d off = aligned.col(i) - exact.col(i);
      INFO("camera " << i << ": " << off.transpose() << " sigma " << sigma.transpose());
      CHECK((off.array().abs() < 4 * sigma.array()).all());
      sum += (off.array() / sigma.array()).square().sum() / 75;
    }
    CHECK(std::sqrt(sum) > 0.6);
    CHECK(std::sqrt(sum) < 1.3);
  }
}

TEST_CASE("an array without a board: lenses that are known with a covariance are refined within it") {
  SceneMaker maker(7);
  Recording recording;
  recording.rows = 1;
  recording.cols = 12;
  SfmProblem problem;
  problem.cameras = 12;
  problem.focal_px = 600;
  NoBoardOptions options;
  options.spacing_m = 0.05;
  // fx and fy are nearly one, as a calibration finds them.
  Eigen::Matrix4d C = Eigen::Vector4d(1.5 * 1.5, 1.5 * 1.5, 9, 9).asDiagonal();
  C(0, 1) = C(1, 0) = 0.99 * 1.5 * 1.5;
  const Eigen::Matrix4d root = C.llt().matrixL();
  std::vector<Pose> truth;
  std::vector<Camera> lenses;
  std::vector<Eigen::Vector4d> y;
  for (int i = 0; i < 12; ++i) {
    const std::string name = "c" + std::to_string(i);
    recording.cameras.push_back({name, 0, i});
    Pose pose;
    pose.R = rotation_from_vector(0.01 * Eigen::Vector3d(maker.uniform(), maker.uniform(), maker.uniform()));
    pose.t = -(pose.R * Eigen::Vector3d(0.05 * i, 0.001 * maker.uniform(), 0.001 * maker.uniform()));
    truth.push_back(pose);
    Camera lens{name, "LENSMODEL_PINHOLE", {600, 600, 319.5, 239.5}, 640, 480, {}};
    options.lenses.push_back(lens);
    const Eigen::Vector2d u = maker.noise(1), v = maker.noise(1);
    y.emplace_back(u.x(), u.y(), v.x(), v.y());
    const Eigen::Vector4d change = root * y.back();
    for (int k = 0; k < 4; ++k) lens.intrinsics[k] += change[k];
    lenses.push_back(lens);
    problem.lens_root.emplace_back(root);
  }
  for (int k = 0; k < 400; ++k) {
    const double z = 1.5 + maker.uniform();
    const Eigen::Vector3d X(0.3 + 0.5 * z * maker.uniform(), 0.4 * z * maker.uniform(), z);
    Track t;
    for (int i = 0; i < 12; ++i) {
      const Eigen::Vector2d q = project(lenses[i], {truth[i] * X})[0] + maker.noise(0.1);
      if (q.x() < 0 || q.y() < 0 || q.x() > 639 || q.y() > 479) continue;
      t.camera.push_back(i);
      t.at_px.push_back(600 * unproject(options.lenses[i], {q})[0].hnormalized());
      t.by_lens.push_back(lens_slope(options.lenses[i], root, 600, t.at_px.back()));
    }
    if (t.camera.size() > 1) problem.tracks.push_back(t);
  }
  // Error of the centres after a similarity, rms in metres and in stated deviations.
  const auto errors = [&](const SfmProblem& p) {
    const Calibration c = calibrate_without_board(p, recording, options);
    REQUIRE(c.solution.converged);
    Eigen::Matrix3Xd found(3, 12), exact(3, 12);
    for (int i = 0; i < 12; ++i) {
      found.col(i) = c.rig.cameras[i].camera.cam_from_rig.centre();
      exact.col(i) = truth[i].centre();
    }
    const Eigen::Matrix3Xd off =
        (Eigen::umeyama(found, exact, true) * found.colwise().homogeneous()).topRows<3>() - exact;
    double sum = 0;
    for (int i = 0; i < 12; ++i)
      sum += off.col(i).cwiseQuotient(c.rig.cameras[i].position_sigma_m).squaredNorm() / 36;
    return std::pair(off.norm() / 6, std::sqrt(sum));
  };
  const auto [refined_m, refined_sigmas] = errors(problem);
  SfmProblem exact = problem;
  exact.lens_root.clear();
  for (Track& t : exact.tracks) t.by_lens.clear();
  const auto [fixed_m, fixed_sigmas] = errors(exact);
  std::printf("centres: %.3f mm with lenses refined (%.2f sigma), %.3f mm with them as given (%.2f sigma)\n",
              1e3 * refined_m, refined_sigmas, 1e3 * fixed_m, fixed_sigmas);
  CHECK(refined_m < 0.5 * fixed_m);
  CHECK(refined_sigmas > 0.6);
  CHECK(refined_sigmas < 1.3);

  const SfmSolution s = solve_sfm(problem, 1);
  double sum = 0;
  for (int i = 0; i < 12; ++i) {
    const Eigen::Vector4d off = s.lens[i].head<4>() - y[i];
    sum += off.dot(s.lens_covariance[i].topLeftCorner<4, 4>().ldlt().solve(off)) / 48;
  }
  CHECK(std::sqrt(sum) > 0.6);
  CHECK(std::sqrt(sum) < 1.3);
}

TEST_CASE("stuv two-view: result, outputs, bad input") {
  const TempFolder folder;
  SceneMaker maker(1);
  const TwoViewScene s = maker.make({.points = 100});
  const std::string a = (folder / "a.png").string(), b = (folder / "b.png").string();
  write_image(a, grey(640, 480));
  write_image(b, grey(640, 480));
  const std::string list = (folder / "m.txt").string(), out = (folder / "out").string();
  write_matches(list, maker.measured(s.exact, 0.3, 0.2));
  const std::string line = "two-view " + a + " " + b + " --matches " + list + " -o " + out;
  auto run = run_stuv(line);
  INFO(run.err);
  REQUIRE(run.exit_code == 0);
  const Json json = read_json(folder / "out/two_view.json");
  CHECK(json["status"] == "ok");
  CHECK(json["matches"] == 100);
  CHECK(json["inliers"].get<int>() > 70);
  CHECK(json["sampson_rms_px"].get<double>() == Approx(0.3).margin(0.1));
  Eigen::Matrix3d F;
  for (int i = 0; i < 9; ++i) F(i / 3, i % 3) = json["F"][i / 3][i % 3];
  CHECK(median_line_distance(F, s.truth) < 1);
  for (const char* name :
       {"matches.png", "epipolar_lines.png", "rectified.png", "disparity.pfm", "report.json"})
    CHECK(std::filesystem::exists(folder / "out" / name));

  run = run_stuv(line);
  CHECK(run.exit_code == 1);
  CHECK_THAT(run.err, Contains("--force"));
  CHECK(run_stuv(line + " --force --no-disparity").exit_code == 0);
  CHECK_FALSE(std::filesystem::exists(folder / "out/rectified.png"));

  write_matches(list, maker.measured(maker.make({.points = 100, .rotation = true}).exact, 0.3));
  CHECK(run_stuv(line + " --force").exit_code == 3);
  const Json turned = read_json(folder / "out/two_view.json");
  CHECK(turned["status"] == "rotation");
  CHECK(turned["F"].is_null());

  write_text(list, "1 2 3 4\n# a comment\n5 6 7\n");
  run = run_stuv(line + " --force");
  CHECK(run.exit_code == 1);
  CHECK(line_count(run.err) == 1);
  CHECK_THAT(run.err, Contains("m.txt") && Contains("line 3"));
  CHECK(run_stuv("two-view " + a + " missing.png -o " + out + " --force").exit_code == 1);
  CHECK(run_stuv("two-view " + a + " " + b + " -o " + out + " --force --threshold -1").exit_code == 2);
  CHECK(run_stuv("calibrate " + out + " -o x --no-board --distance A,B").exit_code != 0);
}

TEST_CASE("the box of the shared data: two planes, 20 seeds") {
  STUV_NEED_SHARED_DATA(data);
  const Matches matches = read_matches(data / "two-view/box_matches.txt");
  const Matches truth = read_matches(data / "two-view/box_truth.txt");
  for (std::uint64_t seed = 0; seed < 20; ++seed) {
    TwoViewOptions options;
    options.seed = seed;
    const TwoViewEstimate e = estimate_two_view(matches, options);
    INFO("seed " << seed);
    CHECK((e.status == TwoViewStatus::ok || e.status == TwoViewStatus::planar));
    if (e.status == TwoViewStatus::ok) CHECK(median_line_distance(e.ml.F, truth) < 3);
  }
}
