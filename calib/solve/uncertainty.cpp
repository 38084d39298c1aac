#include "calib/solve/uncertainty.h"

#include <cmath>
#include <limits>

#include "calib/solve/camera_sight.h"
#include "core/parallel.h"

namespace stuv {
namespace {

/// Centres whose extent across their line is less than this part of that along it are on a line: what they
/// would say about the turn around it is less than what the cameras' directions do.
constexpr double kLineRatio = 0.03;

/// Kernel of G by its singular vectors.
Eigen::MatrixXd kernel_of(const Eigen::MatrixXd& G) {
  Eigen::JacobiSVD<Eigen::MatrixXd> svd(G, Eigen::ComputeFullV | Eigen::ComputeThinU);
  svd.setThreshold(kLineRatio);
  return svd.matrixV().rightCols(G.cols() - svd.rank());
}

Eigen::MatrixXd pseudo_inverse(const Eigen::MatrixXd& G) {
  Eigen::CompleteOrthogonalDecomposition<Eigen::MatrixXd> decomposition(G.rows(), G.cols());
  decomposition.setThreshold(kLineRatio);
  return decomposition.compute(G).pseudoInverse();
}

/// d (turns, centres) / d (omega, tau / extent) of the cameras moving together.
struct Together {
  Eigen::MatrixXd turns, centres;  ///< 3 n x 6
};

Together together(const std::vector<Eigen::Vector3d>& centres) {
  const auto n = static_cast<Eigen::Index>(centres.size());
  Eigen::Vector3d mean = Eigen::Vector3d::Zero();
  for (const Eigen::Vector3d& c : centres) mean += c / static_cast<double>(n);
  double extent = 0;
  for (const Eigen::Vector3d& c : centres) extent = std::max(extent, (c - mean).norm());
  if (!(extent > 0)) extent = 1;
  Together t{Eigen::MatrixXd::Zero(3 * n, 6), Eigen::MatrixXd::Zero(3 * n, 6)};
  for (Eigen::Index i = 0; i < n; ++i) {
    t.turns.block<3, 3>(3 * i, 0).setIdentity();
    // Over the extent, so that the rank tells a line from a plane.
    t.centres.block<3, 3>(3 * i, 0) = -cross_matrix((centres[i] - mean) / extent);
    t.centres.block<3, 3>(3 * i, 3).setIdentity();
  }
  t.centres *= extent;
  return t;
}

double spacing_scale(const std::vector<PlacedCamera>& placed) {
  double sum = 0;
  int count = 0;
  for (const PlacedCamera& a : placed)
    for (const PlacedCamera& b : placed)
      if (a.determined && b.determined && &a != &b) {
        sum += (a.cam_from_ref.centre() - b.cam_from_ref.centre()).norm();
        ++count;
      }
  return count > 0 ? sum / count : 1;
}

using LatticeVector = Eigen::Matrix<double, 8, 1>;

LatticeVector lattice_vector(const Layout& layout) {
  LatticeVector v;
  v << layout.s_step_m, layout.t_step_m, layout.origin_m, layout.s_step_m.norm(), layout.t_step_m.norm();
  return v;
}

/// Turned by dtheta about its centre, then moved by dc, both in the reference frame.
Pose moved(const Pose& cam_from_ref, const Eigen::Vector3d& dtheta, const Eigen::Vector3d& dc) {
  Pose pose;
  pose.R = cam_from_ref.R * rotation_from_vector(dtheta).transpose();
  pose.t = -(pose.R * (cam_from_ref.centre() + dc));
  return pose;
}

}  // namespace

Eigen::MatrixXd block_of(const Eigen::MatrixXd& covariance, const std::vector<int>& which, int block) {
  const auto n = static_cast<Eigen::Index>(which.size());
  Eigen::MatrixXd result(block * n, block * n);
  for (Eigen::Index i = 0; i < n; ++i)
    for (Eigen::Index j = 0; j < n; ++j)
      result.block(block * i, block * j, block, block) =
          covariance.block(block * which[i], block * which[j], block, block);
  return result;
}

Eigen::MatrixXd rigidly_aligned_poses(const Eigen::MatrixXd& covariance,
                                      const std::vector<Eigen::Vector3d>& centres) {
  const auto n = static_cast<Eigen::Index>(centres.size());
  const Together t = together(centres);
  // Rows of turns and of centres in x = (dtheta_1, dc_1, ..).
  Eigen::MatrixXd pick_turns = Eigen::MatrixXd::Zero(3 * n, 6 * n), pick_centres = pick_turns;
  for (Eigen::Index i = 0; i < n; ++i) {
    pick_turns.block<3, 3>(3 * i, 6 * i).setIdentity();
    pick_centres.block<3, 3>(3 * i, 6 * i + 3).setIdentity();
  }
  // g = K x: least |centres|; then, along their kernel N, least |turns|.
  Eigen::MatrixXd K = -pseudo_inverse(t.centres) * pick_centres;
  const Eigen::MatrixXd N = kernel_of(t.centres);
  if (N.cols() > 0) K -= N * pseudo_inverse(t.turns * N) * (pick_turns + t.turns * K);
  const Eigen::MatrixXd T = Eigen::MatrixXd::Identity(6 * n, 6 * n) +
                            (pick_turns.transpose() * t.turns + pick_centres.transpose() * t.centres) * K;
  return T * covariance * T.transpose();
}

LatticeSigma lattice_sigma(const JointSolution& solution, const std::vector<PlacedCamera>& placed, int rows,
                           int cols) {
  std::vector<int> which;
  for (std::size_t i = 0; i < placed.size(); ++i)
    if (placed[i].determined) which.push_back(static_cast<int>(i));
  if (which.size() < 2 || solution.pose_covariance.size() == 0) return {};
  const int columns = 6 * static_cast<int>(which.size());
  const double step_rad = 1e-5, step_m = 1e-5 * spacing_scale(placed);
  Eigen::MatrixXd J = Eigen::MatrixXd::Zero(8, columns);
  parallel_for(columns, [&](int k) {
    const bool turn = k % 6 < 3;
    if (turn && rows > 1 && cols > 1) return;  // directions matter to a single row or column only
    const double step = turn ? step_rad : step_m;
    LatticeVector at[2];
    for (const int side : {0, 1}) {
      std::vector<PlacedCamera> probe = placed;
      Pose& pose = probe[which[k / 6]].cam_from_ref;
      const Eigen::Vector3d d = (side == 0 ? -step : step) * Eigen::Vector3d::Unit(k % 3);
      pose = turn ? moved(pose, d, Eigen::Vector3d::Zero()) : moved(pose, Eigen::Vector3d::Zero(), d);
      at[side] = lattice_vector(fit_layout(probe, rows, cols));
    }
    J.col(k) = (at[1] - at[0]) / (2 * step);
  });
  const Eigen::MatrixXd covariance = J * block_of(solution.pose_covariance, which, 6) * J.transpose();
  const LatticeVector sigma = solution.sigma_px * covariance.diagonal().cwiseMax(0).cwiseSqrt();
  return {sigma.segment<2>(0), sigma.segment<2>(2), sigma.segment<2>(4), sigma[6], sigma[7]};
}

ProjectionMap projection_map(const JointSolution& solution, int camera, double distance_m, int nx, int ny) {
  constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
  ProjectionMap map{distance_m, nx, ny, {}, kNaN, kNaN, kNaN};
  const Camera& seen_by = solution.cameras[camera];
  const Pose ref_from_cam = seen_by.cam_from_rig.inverse();
  const mrcal_lensmodel_t lens = lens_model_of(seen_by);
  const Eigen::Index k = solution.camera_states, end = solution.camera_covariance.cols() - 6;
  Eigen::MatrixXd S(k + 6, k + 6);
  S << solution.camera_covariance.block(k * camera, k * camera, k, k),
      solution.camera_covariance.block(k * camera, end, k, 6),
      solution.camera_covariance.block(end, k * camera, 6, k),
      solution.camera_covariance.block<6, 6>(end, end);
  const double inverse_m = 1 / distance_m;
  double sum_sq = 0, worst = 0;
  int count = 0;
  for (const Eigen::Vector3d& d : unproject(seen_by, picture_grid(seen_by, nx, ny))) {
    map.sigma_px.push_back(kNaN);
    if (!d.allFinite()) continue;
    const FarPoint point{ref_from_cam.R * d + inverse_m * ref_from_cam.t, inverse_m};
    const auto sight = camera_sight(seen_by, lens, point);
    if (!sight) continue;
    Eigen::MatrixXd J(2, k + 6);
    J << sight->by_states, -sight->by_direction * cross_matrix(point.direction),
        inverse_m * sight->by_direction;
    const Eigen::Matrix2d C = J * S * J.transpose();
    const double largest = 0.5 * C.trace() + std::hypot(0.5 * (C(0, 0) - C(1, 1)), C(0, 1));
    const double sigma = solution.sigma_px * std::sqrt(largest);
    if (!std::isfinite(sigma)) continue;
    map.sigma_px.back() = sigma;
    sum_sq += sigma * sigma;
    worst = std::max(worst, sigma);
    ++count;
  }
  if (count == 0) return map;
  map.rms_px = std::sqrt(sum_sq / count);
  map.worst_px = worst;
  map.centre_px = map.sigma_px[static_cast<std::size_t>((ny / 2) * nx + nx / 2)];
  return map;
}

}  // namespace stuv
