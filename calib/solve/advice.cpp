#include "calib/solve/advice.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "calib/solve/camera_sight.h"
#include "core/parallel.h"

namespace stuv {
namespace {

/// At most this many cameras, evenly spread, stand for all: the worth of a board is much the same.
constexpr std::size_t kMostCameras = 12;
constexpr double kTiltRad = 35 * M_PI / 180;

struct Candidate {
  Pose rig_from_board;
  Eigen::Vector2d place;  ///< -1, 0, 1: left and up of the middle's picture
  bool near = false;
  int tilt = 0;      ///< 0 facing, +-1 about s, +-2 about t
  double worth = 0;  ///< part of the variance that is left; less is better
};

/// States of the cameras that stand for all, and points whose pictures are judged.
struct Model {
  std::vector<int> cameras;
  Eigen::MatrixXd S;         ///< of their states and the boards' mean motion, unit noise
  Eigen::MatrixXd pictures;  ///< rows: d picture / d states
  Pose ref_from_rig;
  std::vector<Eigen::Vector3d> board;  ///< some of its corners
};

Model model_of(const Calibration& c) {
  Model m;
  std::vector<int> determined;
  for (std::size_t i = 0; i < c.rig.cameras.size(); ++i)
    if (c.rig.cameras[i].determined) determined.push_back(static_cast<int>(i));
  const std::size_t n = std::min(kMostCameras, determined.size());
  for (std::size_t i = 0; i < n; ++i) m.cameras.push_back(determined[i * determined.size() / n]);
  const Eigen::Index k = c.solution.camera_states, end = c.solution.camera_covariance.cols() - 6;
  const auto states = static_cast<Eigen::Index>(n) * k + 6;
  std::vector<Eigen::Index> index;
  for (const int camera : m.cameras)
    for (Eigen::Index j = 0; j < k; ++j) index.push_back(k * camera + j);
  for (Eigen::Index j = 0; j < 6; ++j) index.push_back(end + j);
  m.S.resize(states, states);
  for (Eigen::Index a = 0; a < states; ++a)
    for (Eigen::Index b = 0; b < states; ++b)
      m.S(a, b) = c.solution.camera_covariance(index[static_cast<std::size_t>(a)],
                                               index[static_cast<std::size_t>(b)]);
  m.ref_from_rig = c.layout.rig_from_ref.inverse();
  const std::vector<Eigen::Vector3d> all = board_points(c.observations.board);
  const Board& board = c.observations.board;
  for (int r = 0; r < 3; ++r)
    for (int q = 0; q < 4; ++q)
      m.board.push_back(all[static_cast<std::size_t>(r * (board.rows - 1) / 2 * board.columns +
                                                     q * (board.columns - 1) / 3)]);
  m.pictures = Eigen::MatrixXd::Zero(static_cast<Eigen::Index>(n) * 18, states);
  for (std::size_t i = 0; i < n; ++i) {
    const Camera& camera = c.solution.cameras[m.cameras[i]];
    const Pose ref_from_cam = camera.cam_from_rig.inverse();
    const double inverse_m = 1 / c.map_distances_m[1];
    Eigen::Index row = static_cast<Eigen::Index>(i) * 18;
    for (const Eigen::Vector3d& d : unproject(camera, picture_grid(camera, 3, 3))) {
      const FarPoint point{ref_from_cam.R * d + inverse_m * ref_from_cam.t, inverse_m};
      const auto sight = camera_sight(camera, lens_model_of(camera), point);
      if (sight) {
        m.pictures.block(row, static_cast<Eigen::Index>(i) * k, 2, k) = sight->by_states;
        m.pictures.block(row, states - 6, 2, 6) << -sight->by_direction * cross_matrix(point.direction),
            inverse_m * sight->by_direction;
      }
      row += 2;
    }
  }
  return m;
}

std::vector<Candidate> candidates_of(const Calibration& c) {
  const RigCamera* middle = nullptr;
  for (const RigCamera& rc : c.rig.cameras)
    if (rc.determined && (middle == nullptr || rc.camera.cam_from_rig.centre().norm() <
                                                   middle->camera.cam_from_rig.centre().norm()))
      middle = &rc;
  const Camera& camera = middle->camera;
  const Board& board = c.observations.board;
  const Eigen::Vector3d centre = 0.5 * board.square_m * Eigen::Vector3d(board.columns - 1, board.rows - 1, 0);
  const Pose rig_from_cam = camera.cam_from_rig.inverse();
  std::vector<Candidate> result;
  for (const bool near : {true, false})
    for (int y = -1; y <= 1; ++y)
      for (int x = -1; x <= 1; ++x)
        for (int tilt = -2; tilt <= 2; ++tilt) {
          const Eigen::Vector2d q((0.5 + 0.28 * x) * camera.width, (0.5 + 0.28 * y) * camera.height);
          const Eigen::Vector3d d = rig_from_cam.R * unproject(camera, {q})[0];
          const double z = near ? c.rig.nearest_seen_m : c.rig.farthest_seen_m;
          if (!(d.z() > 0.1)) continue;
          const Eigen::Vector3d at = rig_from_cam.t + d * ((z - rig_from_cam.t.z()) / d.z());
          Candidate candidate;
          const double angle = tilt == 0 ? 0 : tilt < 0 ? -kTiltRad : kTiltRad;
          candidate.rig_from_board.R = rotation_from_vector(
              angle * (std::abs(tilt) == 1 ? Eigen::Vector3d::UnitX() : Eigen::Vector3d::UnitY()));
          candidate.rig_from_board.t = at - candidate.rig_from_board.R * centre;
          candidate.place = {x, y};
          candidate.near = near;
          candidate.tilt = tilt;
          result.push_back(candidate);
        }
  return result;
}

/// Rows of the candidate's corners in the cameras that see it whole, its own pose projected out.
Eigen::MatrixXd rows_of(const Calibration& c, const Model& m, const Pose& ref_from_board) {
  const Eigen::Index k = c.solution.camera_states, states = m.S.cols();
  Eigen::MatrixXd J(0, states), G(0, 6);
  for (std::size_t i = 0; i < m.cameras.size(); ++i) {
    const Camera& camera = c.solution.cameras[m.cameras[i]];
    const mrcal_lensmodel_t lens = lens_model_of(camera);
    const auto n = static_cast<Eigen::Index>(2 * m.board.size());
    Eigen::MatrixXd rows = Eigen::MatrixXd::Zero(n, states), board(n, 6);
    Eigen::Index row = 0;
    for (const Eigen::Vector3d& p : m.board) {
      const Eigen::Vector3d x = ref_from_board * p;
      const auto sight = camera_sight(camera, lens, {x, 1});
      if (!sight || !sight->in_picture) break;
      rows.block(row, static_cast<Eigen::Index>(i) * k, 2, k) = sight->by_states;
      board.middleRows<2>(row) << -sight->by_direction * cross_matrix(x), sight->by_direction;
      row += 2;
    }
    if (row < n) continue;
    J.conservativeResize(J.rows() + n, Eigen::NoChange);
    G.conservativeResize(G.rows() + n, Eigen::NoChange);
    J.bottomRows(n) = rows;
    G.bottomRows(n) = board;
  }
  if (J.rows() == 0) return J;
  const Eigen::MatrixXd Q =
      Eigen::HouseholderQR<Eigen::MatrixXd>(G).householderQ() * Eigen::MatrixXd::Identity(G.rows(), 6);
  // A board has more corners than stand for it.
  const double more = std::sqrt(c.observations.board.corners() / static_cast<double>(m.board.size()));
  return more * (J - Q * (Q.transpose() * J));
}

void weigh(const Calibration& c, const Model& m, Candidate& candidate) {
  const Eigen::MatrixXd J = rows_of(c, m, m.ref_from_rig * candidate.rig_from_board);
  candidate.worth = 1;
  if (J.rows() == 0) return;
  const Eigen::MatrixXd SJt = m.S * J.transpose();
  const Eigen::MatrixXd K = J * SJt + Eigen::MatrixXd::Identity(J.rows(), J.rows());
  const Eigen::MatrixXd PSJt = m.pictures * SJt;
  const double before = (m.pictures * m.S).cwiseProduct(m.pictures).sum();
  const double gain = PSJt.cwiseProduct(K.ldlt().solve(PSJt.transpose()).transpose()).sum();
  if (before > 0 && std::isfinite(gain)) candidate.worth = std::max(0.0, 1 - gain / before);
}

std::string where(const Eigen::Vector2d& place) {
  const char* row = place.y() < 0 ? "upper " : place.y() > 0 ? "lower " : "";
  const char* col = place.x() < 0 ? "left" : place.x() > 0 ? "right" : "";
  if (place.isZero()) return "middle";
  if (*col == 0) return place.y() < 0 ? "upper part" : "lower part";
  return fmt::format("{}{}", row, col);
}

std::string text_of(const Calibration& c, const Candidate& candidate) {
  const char* tilts[] = {"turned by 35 degrees, its right side away from the cameras",
                         "tilted by 35 degrees, its lower side towards the cameras", "facing the cameras",
                         "tilted by 35 degrees, its upper side towards the cameras",
                         "turned by 35 degrees, its left side away from the cameras"};
  return fmt::format(
      "hold the board {:.2f} m from the cameras in the {} of the middle camera's picture, {}: "
      "that alone would lower the projections' uncertainty by {:.0f} %",
      candidate.near ? c.rig.nearest_seen_m : c.rig.farthest_seen_m, where(candidate.place),
      tilts[candidate.tilt + 2], 100 * (1 - std::sqrt(candidate.worth)));
}

void advise_boards(const Calibration& c, std::vector<std::string>& advice) {
  constexpr double kWorthPx = 0.05;
  double worst = 0;
  for (const CameraSummary& s : c.cameras)
    if (s.maps.size() > 1) worst = std::max(worst, s.maps[1].worst_px);
  if (c.map_distances_m.empty() || !(worst > kWorthPx)) return;
  std::vector<Candidate> candidates = candidates_of(c);
  const Model model = model_of(c);
  parallel_for(static_cast<int>(candidates.size()), [&](int i) { weigh(c, model, candidates[i]); });
  const auto best = std::min_element(candidates.begin(), candidates.end(),
                                     [](const auto& a, const auto& b) { return a.worth < b.worth; });
  if (best != candidates.end() && best->worth < 0.9) advice.push_back(text_of(c, *best));
}

void advise_cameras(const Calibration& c, std::vector<std::string>& advice) {
  constexpr double kFewTiltRad = 20 * M_PI / 180;
  std::vector<std::string> single, parallel;
  for (std::size_t i = 0; i < c.cameras.size(); ++i) {
    const std::string& name = c.observations.camera_names[i];
    if (c.cameras[i].boards < 2)
      single.push_back(name);
    else if (c.cameras[i].seen.tilt_rad < kFewTiltRad)
      parallel.push_back(name);
  }
  if (!single.empty())
    advice.push_back(fmt::format("show more boards, tilted, to {}, each together with a neighbour",
                                 fmt::join(single, ", ")));
  if (!parallel.empty())
    advice.push_back(
        fmt::format("tilt the board by 30 degrees and more about both axes: those that {} saw are "
                    "nearly parallel",
                    fmt::join(parallel, ", ")));
  std::vector<std::pair<double, std::size_t>> empty;
  for (std::size_t i = 0; i < c.cameras.size(); ++i)
    if (c.cameras[i].seen.has_empty && c.solution.solved[i] && c.cameras[i].boards > 1)
      empty.emplace_back(c.cameras[i].seen.cells, i);
  std::sort(empty.begin(), empty.end());
  for (std::size_t k = 0; k < std::min<std::size_t>(3, empty.size()); ++k) {
    const Eigen::Vector2d place = c.cameras[empty[k].second].seen.empty - Eigen::Vector2d(0.5, 0.5);
    advice.push_back(fmt::format("no board was in the {} of camera {}'s picture",
                                 where((place * 3).array().round().matrix()),
                                 c.observations.camera_names[empty[k].second]));
  }
}

}  // namespace

std::vector<std::string> advice_for(const Calibration& c) {
  std::vector<std::string> advice;
  advise_boards(c, advice);
  advise_cameras(c, advice);
  return advice;
}

}  // namespace stuv
