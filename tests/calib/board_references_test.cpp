// Real boards that come with somebody else's calibration: is ours at least as good on the same corners, and
// do the two agree? What the numbers say is in docs/calibration-references.md.
#include <fstream>
#include <map>
#include <sstream>

#include "calib/board/find_corners.h"
#include "calib/solve/calibrate.h"
#include "core/image_io.h"
#include "core/parallel.h"
#include "tests/support/support.h"

using namespace stuv;
using Catch::Contains;
namespace fs = std::filesystem;

namespace {

/// Sum of squares over x and y of the observations' residuals and their number, with cameras held and the
/// board's pose fitted (Gauss and Newton, derivatives by differences). Corners that `used` leaves out take no
/// part.
struct Fit {
  double sum_sq = 0;
  int count = 0;
};

Eigen::VectorXd residuals(const std::vector<const BoardObservation*>& views,
                          const std::vector<Camera>& cameras, const std::vector<Eigen::Vector3d>& model,
                          const Pose& pose, const std::vector<const std::vector<bool>*>& used) {
  std::vector<double> r;
  for (std::size_t v = 0; v < views.size(); ++v) {
    std::vector<Eigen::Vector3d> points;
    for (std::size_t i = 0; i < model.size(); ++i)
      if ((*used[v])[i]) points.push_back(cameras[views[v]->camera].cam_from_rig * (pose * model[i]));
    const std::vector<Eigen::Vector2d> q = project(cameras[views[v]->camera], points);
    std::size_t k = 0;
    for (std::size_t i = 0; i < model.size(); ++i)
      if ((*used[v])[i]) {
        const Eigen::Vector2d d = q[k++] - views[v]->corners_px[i];
        r.insert(r.end(), {d.x(), d.y()});
      }
  }
  return Eigen::Map<Eigen::VectorXd>(r.data(), static_cast<Eigen::Index>(r.size()));
}

Pose moved(const Pose& pose, const Eigen::Matrix<double, 6, 1>& by) {
  return {pose.R * rotation_from_vector(by.head<3>()), pose.t + by.tail<3>()};
}

Fit fit_pose(const std::vector<const BoardObservation*>& views, const std::vector<Camera>& cameras,
             const std::vector<Eigen::Vector3d>& model, Pose pose,
             const std::vector<const std::vector<bool>*>& used) {
  Eigen::VectorXd r = residuals(views, cameras, model, pose, used);
  for (int round = 0; round < 30; ++round) {
    Eigen::MatrixXd J(r.size(), 6);
    for (int k = 0; k < 6; ++k) {
      constexpr double kStep = 1e-6;
      Eigen::Matrix<double, 6, 1> by = Eigen::Matrix<double, 6, 1>::Zero();
      by[k] = kStep;
      J.col(k) = (residuals(views, cameras, model, moved(pose, by), used) - r) / kStep;
    }
    const Eigen::Matrix<double, 6, 1> step = J.colPivHouseholderQr().solve(-r);
    const Pose next = moved(pose, step);
    const Eigen::VectorXd r_next = residuals(views, cameras, model, next, used);
    if (!(r_next.squaredNorm() < r.squaredNorm())) break;
    const bool still = r_next.squaredNorm() > (1 - 1e-10) * r.squaredNorm();
    pose = next;
    r = r_next;
    if (still) break;
  }
  return {r.squaredNorm(), static_cast<int>(r.size())};
}

/// rms over x and y of other cameras (their poses in any frame) on the corners that were inliers of ours.
/// Each board's pose is fitted to them, from ours.
double rms_with(const Calibration& ours, const std::vector<Camera>& others) {
  const std::vector<Eigen::Vector3d> model = board_points(ours.observations.board);
  std::map<int, std::vector<const BoardObservation*>> by_set;
  std::map<int, std::vector<const std::vector<bool>*>> used_of;
  std::vector<std::vector<bool>> used(ours.observations.boards.size());
  for (std::size_t i = 0; i < used.size(); ++i) {
    for (const Eigen::Vector2d& r : ours.solution.residuals_px[i]) used[i].push_back(r.allFinite());
    by_set[ours.observations.boards[i].set].push_back(&ours.observations.boards[i]);
    used_of[ours.observations.boards[i].set].push_back(&used[i]);
  }
  Fit total;
  for (const auto& [set, views] : by_set) {
    // The board where the first camera that sees it has it in ours.
    const int camera = views.front()->camera;
    const Pose start = others[camera].cam_from_rig.inverse() * ours.solution.cameras[camera].cam_from_rig *
                       ours.solution.ref_from_board[set];
    const Fit fit = fit_pose(views, others, model, start, used_of[set]);
    total.sum_sq += fit.sum_sq;
    total.count += fit.count;
  }
  return std::sqrt(total.sum_sq / total.count);
}

/// Centres of b aligned on those of a by a rigid motion: differences in a's frame.
std::vector<Eigen::Vector3d> centre_differences(const std::vector<Camera>& a, const std::vector<Camera>& b) {
  const auto n = static_cast<Eigen::Index>(a.size());
  Eigen::Matrix3Xd ca(3, n), cb(3, n);
  for (Eigen::Index i = 0; i < n; ++i) {
    ca.col(i) = a[i].cam_from_rig.centre();
    cb.col(i) = b[i].cam_from_rig.centre();
  }
  const Eigen::Matrix4d T = Eigen::umeyama(cb, ca, false);
  std::vector<Eigen::Vector3d> d;
  for (Eigen::Index i = 0; i < n; ++i)
    d.push_back(T.topLeftCorner<3, 3>() * cb.col(i) + T.topRightCorner<3, 1>() - ca.col(i));
  return d;
}

std::vector<Camera> rig_cameras(const Calibration& c) {
  std::vector<Camera> cameras;
  for (const RigCamera& rc : c.rig.cameras) cameras.push_back(rc.camera);
  return cameras;
}

Recording row_of(const std::vector<std::string>& names) {
  Recording recording;
  recording.rows = 1;
  recording.cols = static_cast<int>(names.size());
  for (std::size_t i = 0; i < names.size(); ++i)
    recording.cameras.push_back({names[i], 0, static_cast<int>(i)});
  return recording;
}

// --- caliscope-4cam
// ---------------------------------------------------------------------------------------------

/// matrix, distortions (k1 k2 p1 p2 k3), translation and rotation of camera_array.toml; written by hand as
/// the file has one value a line.
std::vector<Camera> caliscope_reference(const fs::path& toml) {
  std::vector<Camera> cameras;
  std::ifstream in(toml);
  for (std::string line; std::getline(in, line);) {
    const std::size_t equals = line.find('=');
    const std::string key = line.substr(0, equals == std::string::npos ? 0 : line.find_first_of(" ="));
    std::string text = equals == std::string::npos ? "" : line.substr(equals + 1);
    for (char& c : text)
      if (c == '[' || c == ']' || c == ',') c = ' ';
    std::istringstream values(text);
    std::vector<double> v;
    for (double x = 0; values >> x;) v.push_back(x);
    if (line.starts_with("[cameras."))
      cameras.push_back({"cam_" + std::to_string(cameras.size()), "LENSMODEL_OPENCV5", {}, 1280, 720, {}});
    if (cameras.empty()) continue;
    Camera& camera = cameras.back();
    if (key == "matrix") camera.intrinsics = {v[0], v[4], v[2], v[5]};
    if (key == "distortions") camera.intrinsics.insert(camera.intrinsics.end(), v.begin(), v.end());
    if (key == "translation") camera.cam_from_rig.t = Eigen::Vector3d(v[0], v[1], v[2]);
    if (key == "rotation")
      camera.cam_from_rig.R = Eigen::Map<Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(v.data());
  }
  return cameras;
}

/// xy_CHARUCO.csv: sync_index, cam_id, object_id, keypoint_id, x, y, ...
Observations caliscope_corners(const fs::path& csv, const Board& board) {
  Observations in;
  in.board = board;
  for (int c = 0; c < 4; ++c) in.camera_names.push_back("cam_" + std::to_string(c));
  in.size_px.assign(4, {1280, 720});
  std::map<std::pair<int, int>, std::vector<Eigen::Vector2d>> views;  // by set and camera
  std::map<int, int> set_of;
  std::ifstream file(csv);
  std::string line;
  std::getline(file, line);
  while (std::getline(file, line)) {
    int sync = 0, camera = 0, object = 0, point = 0;
    double x = 0, y = 0;
    REQUIRE(std::sscanf(line.c_str(), "%d,%d,%d,%d,%lf,%lf", &sync, &camera, &object, &point, &x, &y) == 6);
    if (set_of.emplace(sync, static_cast<int>(set_of.size())).second)
      in.set_names.push_back(std::to_string(sync));
    auto& corners = views[{set_of[sync], camera}];
    corners.resize(static_cast<std::size_t>(board.corners()), {std::nan(""), std::nan("")});
    corners.at(static_cast<std::size_t>(point)) = {x, y};
  }
  for (auto& [key, corners] : views) {
    const auto seen =
        std::count_if(corners.begin(), corners.end(), [](const auto& q) { return q.allFinite(); });
    if (seen >= 6) in.boards.push_back({key.second, key.first, corners, {}});
  }
  return in;
}

}  // namespace

TEST_CASE(
    "caliscope-4cam: on its own corners our solve fits better than the reference that comes with them") {
  STUV_NEED_SHARED_DATA(data);
  const fs::path folder = data / "caliscope-4cam" / "post_optimization";
  const Board board = parse_board("charuco:4x5:54mm:40.5mm:DICT_4X4_1000:inverted");
  const Observations in =
      caliscope_corners(folder / "calibration" / "extrinsic" / "CHARUCO" / "xy_CHARUCO.csv", board);
  CHECK(in.boards.size() > 150);
  const std::vector<Camera> reference = caliscope_reference(folder / "camera_array.toml");
  REQUIRE(reference.size() == 4);
  CalibrationOptions options;
  options.most_folds = 0;
  const Calibration ours = calibrate(in, row_of(in.camera_names), options);
  REQUIRE(ours.solution.converged);
  const double theirs = rms_with(ours, reference);
  std::printf("caliscope, its corners: ours %.3f px rms, reference %.3f, %d corners, %d outliers\n",
              ours.solution.rms_unweighted_px, theirs, ours.solution.inliers, ours.solution.outliers);
  CHECK(ours.solution.rms_unweighted_px <= theirs);
  const auto d = centre_differences(rig_cameras(ours), reference);
  for (std::size_t i = 0; i < d.size(); ++i)
    std::printf("  %s: centres differ by %.1f %.1f %.1f mm, sigma %.1f %.1f %.1f mm; f %.1f against %.1f\n",
                in.camera_names[i].c_str(), 1e3 * d[i].x(), 1e3 * d[i].y(), 1e3 * d[i].z(),
                1e3 * ours.rig.cameras[i].position_sigma_m.x(),
                1e3 * ours.rig.cameras[i].position_sigma_m.y(),
                1e3 * ours.rig.cameras[i].position_sigma_m.z(), ours.rig.cameras[i].camera.intrinsics[0],
                reference[i].intrinsics[0]);
}

TEST_CASE("caliscope-4cam: from four videos to a rig that fits better than the reference") {
  STUV_NEED_SHARED_DATA(data);
  const fs::path folder = data / "caliscope-4cam" / "post_optimization";
  const test::TempFolder temp;
  const std::string rec = (temp / "rec").string(), rig = (temp / "rig").string();
  const std::string videos = (folder / "calibration" / "extrinsic" / "cam_{camera}.mp4").string();
  const auto captured = test::run_stuv("capture --files '" + videos + "' --grid 1x4 --every 3 -o " + rec);
  INFO(captured.err);
  REQUIRE(captured.exit_code == 0);
  const Recording recording = open_recording(rec);
  CHECK(recording.sets.size() == 19);
  CHECK(recording.cameras.size() == 4);
  CHECK(recording.sets[1].frames[0].sequence == 3);

  const auto run = test::run_stuv("calibrate " + rec + " -o " + rig +
                                  " --board charuco:4x5:54mm:40.5mm:DICT_4X4_1000:inverted --overlay " +
                                  (temp / "seen").string());
  INFO(run.out << run.err);
  CHECK((run.exit_code == 0 || run.exit_code == 3));
  CHECK(fs::exists(temp / "seen" / "000000_0.png"));

  const Board board = parse_board("charuco:4x5:54mm:40.5mm:DICT_4X4_1000:inverted");
  const FoundCorners found = find_corners(recording, board);
  CHECK(found.remembered == 76);
  CHECK(found.boards >= 55);
  Observations in;
  in.board = board;
  in.size_px = found.size_px;
  for (const RecordedCamera& camera : recording.cameras) in.camera_names.push_back(camera.name);
  for (std::size_t s = 0; s < recording.sets.size(); ++s) {
    in.set_names.push_back(recording.sets[s].name);
    for (int c = 0; c < 4; ++c)
      if (!found.views[s][c].empty())
        in.boards.push_back({c, static_cast<int>(s), found.views[s][c].corners_px, {}});
  }
  CalibrationOptions options;
  options.most_folds = 0;
  const Calibration ours = calibrate(in, recording, options);
  REQUIRE(ours.solution.converged);
  const double theirs = rms_with(ours, caliscope_reference(folder / "camera_array.toml"));
  std::printf("caliscope, corners of stuv: ours %.3f px rms, reference %.3f, %d corners, %d outliers\n",
              ours.solution.rms_unweighted_px, theirs, ours.solution.inliers, ours.solution.outliers);
  CHECK(ours.solution.rms_unweighted_px <= theirs);
  // The reference's lenses are of recordings of their own. Boards alone agree with them; the joint solve does
  // not where frames of the videos are too far apart, and that is said.
  const std::vector<Camera> reference = caliscope_reference(folder / "camera_array.toml");
  REQUIRE(ours.own_lenses.size() == 4);
  for (std::size_t c = 0; c < 4; ++c) {
    const double f = reference[c].intrinsics[0];
    const OwnLens& own = ours.own_lenses[c];
    std::printf("camera %zu: reference %.1f px, by its own boards %.1f (sigma %.1f), jointly %.1f: %s\n", c,
                f, own.focal_px[0], own.focal_sigma_px[0], ours.solution.cameras[c].intrinsics[0],
                ours.cameras[c].undetermined.c_str());
    CHECK(std::abs(own.focal_px[0] - f) < 3 * own.focal_sigma_px[0]);
    if (ours.cameras[c].undetermined.empty())
      CHECK(std::abs(ours.solution.cameras[c].intrinsics[0] - f) < 3 * own.focal_sigma_px[0]);
  }
}

namespace {

// --- opencv-stereo
// ----------------------------------------------------------------------------------------------

Observations opencv_corners(const fs::path& folder, const std::vector<std::string>& sides) {
  Observations in;
  in.board = parse_board("chessboard:9x6:25mm");
  in.camera_names = sides;
  in.size_px.assign(sides.size(), {640, 480});
  for (int n = 1; n <= 14; ++n)
    if (n != 10) in.set_names.push_back(std::string(n < 10 ? "0" : "") + std::to_string(n));
  const int count = static_cast<int>(in.set_names.size() * sides.size());
  std::vector<BoardView> views(static_cast<std::size_t>(count));
  parallel_for(count, [&](int i) {
    const std::size_t set = static_cast<std::size_t>(i) / sides.size(),
                      side = static_cast<std::size_t>(i) % sides.size();
    views[i] = detect_board(read_image(folder / (sides[side] + in.set_names[set] + ".jpg")), in.board);
  });
  for (int i = 0; i < count; ++i)
    if (!views[i].empty())
      in.boards.push_back(
          {i % static_cast<int>(sides.size()), i / static_cast<int>(sides.size()), views[i].corners_px, {}});
  return in;
}

}  // namespace

TEST_CASE(
    "opencv-stereo: every board is found, and both calibrations that come with it fit worse than ours") {
  STUV_NEED_SHARED_DATA(data);
  const Observations in = opencv_corners(data / "opencv-stereo", {"left", "right"});
  CHECK(in.boards.size() == 26);
  CalibrationOptions options;
  options.most_folds = 0;
  const Calibration ours = calibrate(in, row_of(in.camera_names), options);
  REQUIRE(ours.solution.converged);
  std::printf("opencv-stereo: %zu of 26 boards, rms %.3f px, %d outliers, f %.2f %.2f px, baseline %.2f mm\n",
              in.boards.size(), ours.solution.rms_unweighted_px, ours.solution.outliers,
              ours.rig.cameras[0].camera.intrinsics[0], ours.rig.cameras[1].camera.intrinsics[0],
              1e3 * (ours.rig.cameras[0].camera.cam_from_rig.centre() -
                     ours.rig.cameras[1].camera.cam_from_rig.centre())
                        .norm());

  // The left camera alone, as left_intrinsics.yml was made.
  Observations left = in;
  left.camera_names = {"left"};
  left.size_px.resize(1);
  std::erase_if(left.boards, [](const BoardObservation& b) { return b.camera != 0; });
  options.solve.lens = Lens::opencv8;
  const Calibration mono = calibrate(left, row_of({"left"}), options);
  REQUIRE(mono.solution.converged);
  const Camera left_reference = {
      "left",
      "LENSMODEL_OPENCV5",
      {535.91573396163199, 535.91573396163199, 342.28315473308373, 235.57082909788173, -0.26637260909660682,
       -0.038588898922304653, 0.0017831947042852964, -0.00028122100441115472, 0.23839153080878486},
      640,
      480,
      {}};
  const Camera stereo_reference = {"left",
                                   "LENSMODEL_OPENCV5",
                                   {534.80326845051309, 534.80326845051309, 335.68643204394891,
                                    240.66183054066337, 0.29589439552724328, -1.0354662043042675, 0, 0, 0},
                                   640,
                                   480,
                                   {}};
  const double first = rms_with(mono, {left_reference}), second = rms_with(mono, {stereo_reference});
  std::printf("  left alone: ours %.3f px rms (f %.2f), left_intrinsics.yml %.3f, intrinsics.yml %.3f\n",
              mono.solution.rms_unweighted_px, mono.solution.cameras[0].intrinsics[0], first, second);
  CHECK(mono.solution.rms_unweighted_px <= first);
  CHECK(mono.solution.rms_unweighted_px <= second);
  CHECK(std::abs(mono.solution.cameras[0].intrinsics[0] - left_reference.intrinsics[0]) < 5);
}

TEST_CASE("mrcal-models: on the corners of 186 boards our solve is as good as mrcal's own") {
  STUV_NEED_SHARED_DATA(data);
  const fs::path models = data / "mrcal-models" / "figueroa-overpass-looking-S";
  const test::TempFolder temp;
  // The corners that the model embeds, with their weights, and the reference's residuals of those it used.
  const std::string script =
      "import mrcal, numpy as np, sys\n"
      "m = mrcal.cameramodel(sys.argv[1]); o = m.optimization_inputs()\n"
      "q = o['observations_board']\n"
      "x = mrcal.optimizer_callback(**o)[1][:q.shape[0]*200].reshape(-1, 2)\n"
      "w = q.reshape(-1, 3)[:, 2]; x = x[w > 0] / w[w > 0, None]\n"
      "print(q.shape[0], np.sqrt((x*x).mean()), (w > 0).sum())\n"
      "np.savetxt(sys.stdout, q.reshape(-1, 3), fmt='%.9g')\n";
  std::ofstream(temp / "dump.py") << script;
  const std::string line = "/usr/bin/python3 " + (temp / "dump.py").string() + " " +
                           (models / "opencv8-0.cameramodel").string() + " > " + (temp / "corners").string() +
                           " 2>&1";
  REQUIRE(std::system(line.c_str()) == 0);
  std::ifstream file(temp / "corners");
  int boards = 0, reference_corners = 0;
  double reference_rms = 0;
  file >> boards >> reference_rms >> reference_corners;
  REQUIRE(boards == 186);

  Observations in;
  in.board.columns = in.board.rows = 10;
  in.board.square_m = 0.077;
  in.camera_names = {"cam"};
  in.size_px = {{6016, 4016}};
  for (int s = 0; s < boards; ++s) {
    in.set_names.push_back(std::to_string(s));
    BoardObservation b{0, s, {}, {}};
    for (int i = 0; i < 100; ++i) {
      double x = 0, y = 0, w = 0;
      REQUIRE(file >> x >> y >> w);
      b.corners_px.emplace_back(x, y);
      b.weights.push_back(std::max(0.0, w));
    }
    in.boards.push_back(std::move(b));
  }
  CalibrationOptions options;
  options.most_folds = 0;
  options.solve.lens = Lens::opencv8;
  const Calibration ours = calibrate(in, row_of({"cam"}), options);
  REQUIRE(ours.solution.converged);
  const Camera reference = read_cameramodel(models / "opencv8-0.cameramodel");
  const double theirs = rms_with(ours, {reference});
  std::printf(
      "mrcal-models: ours %.4f px rms of %d corners; mrcal's cameras on the same %.4f; mrcal's own %.4f of "
      "%d\n",
      ours.solution.rms_unweighted_px, ours.solution.inliers, theirs, reference_rms, reference_corners);
  CHECK(ours.solution.rms_unweighted_px <= 1.005 * theirs);
  CHECK(ours.solution.outliers < 0.05 * ours.solution.inliers);
  const auto& f = ours.solution.cameras[0].intrinsics;
  for (int k = 0; k < 2; ++k) {
    const double sigma = ours.solution.sigma_px * ours.solution.focal_sigma[0][k];
    std::printf("  f %.2f against %.2f px, sigma %.2f\n", f[k], reference.intrinsics[k], sigma);
  }
}
