#include "calib/solve/solve_difference.h"

#include <cmath>
#include <limits>

#include "calib/solve/camera_sight.h"
#include "calib/solve/uncertainty.h"

namespace stuv {
namespace {

/// One quantity that is compared: of each camera its difference, and the metric G that its square is taken
/// by.
struct Compared {
  std::vector<int> cameras;
  std::vector<Eigen::VectorXd> d;
  std::vector<Eigen::MatrixXd> G;
};

/// Covariance of the difference between one block of camera a's states and one of camera b's.
class DifferenceCovariance {
 public:
  DifferenceCovariance(const Eigen::MatrixXd& a, double noise_a, const Eigen::MatrixXd& b, double noise_b,
                       SolvePair pair, double common_noise)
      : a_(a),
        b_(b),
        of_a_(std::pow(pair == SolvePair::nested ? common_noise : noise_a, 2)),
        of_b_(pair == SolvePair::nested ? -std::pow(common_noise, 2) : std::pow(noise_b, 2)) {}

  Eigen::MatrixXd block(Eigen::Index row, Eigen::Index col, Eigen::Index size) const {
    return of_a_ * a_.block(row, col, size, size) + of_b_ * b_.block(row, col, size, size);
  }

 private:
  const Eigen::MatrixXd &a_, &b_;
  double of_a_, of_b_;
};

template <class Block>
SolveDifference::Ratio ratio_of(const Compared& what, const Block& covariance) {
  const std::size_t n = what.cameras.size();
  if (n == 0) return {};
  std::vector<double> expected(n);
  double square = 0, variance = 0;
  for (std::size_t i = 0; i < n; ++i) {
    expected[i] = (what.G[i] * covariance(what.cameras[i], what.cameras[i])).trace();
    square += what.d[i].dot(what.G[i] * what.d[i]) / expected[i];
  }
  for (std::size_t i = 0; i < n; ++i)
    for (std::size_t j = 0; j < n; ++j) {
      const Eigen::MatrixXd S = covariance(what.cameras[i], what.cameras[j]);
      variance += 2 * (what.G[i] * S * what.G[j] * S.transpose()).trace() / (expected[i] * expected[j]);
    }
  const auto count = static_cast<double>(n);
  return {square / count, 2 * count * count / variance};
}

/// d picture / d lens over the picture, what a pose can make up for taken out, over sqrt(points); no rows
/// where the lens sees too little.
Eigen::MatrixXd lens_pictures(const Camera& camera, double distance_m) {
  const Pose ref_from_cam = camera.cam_from_rig.inverse();
  const mrcal_lensmodel_t lens = lens_model_of(camera);
  const auto n_lens = static_cast<Eigen::Index>(camera.intrinsics.size());
  const std::vector<Eigen::Vector2d> grid = picture_grid(camera, 12, 8);
  Eigen::MatrixXd J(2 * grid.size(), n_lens + 6);
  Eigen::Index rows = 0;
  for (const Eigen::Vector3d& d : unproject(camera, grid)) {
    if (!d.allFinite()) continue;
    const auto sight = camera_sight(camera, lens, {ref_from_cam * Eigen::Vector3d(distance_m * d), 1});
    if (!sight) continue;
    J.middleRows<2>(rows) = sight->by_states;
    rows += 2;
  }
  if (rows < 20) return {};
  J.conservativeResize(rows, Eigen::NoChange);
  const Eigen::MatrixXd Q = Eigen::HouseholderQR<Eigen::MatrixXd>(J.rightCols<6>()).householderQ() *
                            Eigen::MatrixXd::Identity(rows, 6);
  const Eigen::MatrixXd PJ = J.leftCols(n_lens) - Q * (Q.transpose() * J.leftCols(n_lens));
  return PJ / std::sqrt(0.5 * static_cast<double>(rows));
}

Eigen::VectorXd lens_vector(const Camera& camera) {
  return Eigen::Map<const Eigen::VectorXd>(camera.intrinsics.data(),
                                           static_cast<Eigen::Index>(camera.intrinsics.size()));
}

constexpr double kMostPx = 1;        ///< of a solve that knows a lens
constexpr double kLeastNews = 0.05;  ///< of a nested solve's variance, that the missing data take away

/// Fills in the cameras' lens_px; returns whom both solves know.
std::vector<int> compare_lenses(const JointSolution& whole, const JointSolution& a, const JointSolution& b,
                                SolvePair pair, double distance_m, SolveDifference& out) {
  const DifferenceCovariance covariance(a.camera_covariance, a.noise_px, b.camera_covariance, b.noise_px,
                                        pair, whole.noise_px);
  const Eigen::Index k = whole.camera_states;
  Compared compared;
  std::vector<int> known;
  Eigen::Index n_lens = 0;
  for (SolveDifference::Camera& camera : out.cameras) {
    const int c = camera.camera;
    const Eigen::MatrixXd PJ = lens_pictures(whole.cameras[c], distance_m);
    if (PJ.rows() == 0) continue;
    n_lens = PJ.cols();
    const Eigen::MatrixXd G = PJ.transpose() * PJ;
    const Eigen::VectorXd d = lens_vector(a.cameras[c]) - lens_vector(b.cameras[c]);
    const double predicted = (G * covariance.block(k * c, k * c, n_lens)).trace();
    const double of_a =
        std::pow(a.noise_px, 2) * (G * a.camera_covariance.block(k * c, k * c, n_lens, n_lens)).trace();
    camera.lens_px = std::sqrt(d.dot(G * d));
    camera.lens_predicted_px = std::sqrt(std::max(0.0, predicted));
    const double certain = pair == SolvePair::nested ? of_a : predicted;
    if (!(certain < kMostPx * kMostPx)) continue;
    known.push_back(c);
    if (!(predicted > 0) || (pair == SolvePair::nested && predicted < kLeastNews * of_a)) continue;
    compared.cameras.push_back(c);
    compared.d.push_back(d);
    compared.G.push_back(G);
  }
  out.lens = ratio_of(compared, [&](int c, int other) { return covariance.block(k * c, k * other, n_lens); });
  return known;
}

int first_solved(const JointSolution& s) {
  for (std::size_t c = 0; c < s.solved.size(); ++c)
    if (s.solved[c]) return static_cast<int>(c);
  return -1;
}

void compare_centres(const JointSolution& whole, const JointSolution& a, const JointSolution& b,
                     SolvePair pair, const std::vector<int>& known, SolveDifference& out) {
  const auto n = static_cast<Eigen::Index>(out.cameras.size());
  // Covariances of two frames cannot be subtracted.
  if (pair == SolvePair::nested && first_solved(a) != first_solved(b)) return;
  Eigen::Matrix3Xd from(3, n), to(3, n);
  std::vector<int> which;
  std::vector<Eigen::Vector3d> centres;
  for (Eigen::Index i = 0; i < n; ++i) {
    which.push_back(out.cameras[i].camera);
    from.col(i) = a.cameras[which.back()].cam_from_rig.centre();
    to.col(i) = b.cameras[which.back()].cam_from_rig.centre();
    centres.push_back(to.col(i));
  }
  const Eigen::Matrix4d T = Eigen::umeyama(from, to, false);
  // Aligned variances do not depend on the frame, but for the small turn between the two.
  const Eigen::MatrixXd of_a = rigidly_aligned_poses(block_of(a.pose_covariance, which, 6), centres),
                        of_b = rigidly_aligned_poses(block_of(b.pose_covariance, which, 6), centres);
  const DifferenceCovariance covariance(of_a, a.noise_px, of_b, b.noise_px, pair, whole.noise_px);
  Compared compared;
  for (Eigen::Index i = 0; i < n; ++i) {
    const Eigen::Vector3d d = T.topLeftCorner<3, 3>() * from.col(i) + T.topRightCorner<3, 1>() - to.col(i);
    const double predicted = covariance.block(6 * i + 3, 6 * i + 3, 3).trace();
    out.cameras[i].centre_m = d.norm();
    out.cameras[i].centre_predicted_m = std::sqrt(std::max(0.0, predicted));
    if (std::find(known.begin(), known.end(), which[i]) == known.end() || !(predicted > 0)) continue;
    if (pair == SolvePair::nested &&
        predicted < kLeastNews * std::pow(whole.noise_px, 2) * of_a.block<3, 3>(6 * i + 3, 6 * i + 3).trace())
      continue;
    compared.cameras.push_back(static_cast<int>(i));
    compared.d.emplace_back(d);
    compared.G.emplace_back(Eigen::Matrix3d::Identity());
  }
  out.centre = ratio_of(compared, [&](int i, int j) {
    return covariance.block(6 * Eigen::Index(i) + 3, 6 * Eigen::Index(j) + 3, 3);
  });
}

}  // namespace

SolveDifference solve_difference(const JointSolution& whole, const JointSolution& a, const JointSolution& b,
                                 SolvePair pair, double distance_m) {
  SolveDifference out;
  if (a.camera_covariance.size() == 0 || b.camera_covariance.size() == 0) return out;
  for (std::size_t c = 0; c < whole.solved.size(); ++c)
    if (a.solved[c] && b.solved[c]) out.cameras.push_back({static_cast<int>(c)});
  const std::vector<int> known = compare_lenses(whole, a, b, pair, distance_m, out);
  if (out.cameras.size() > 1) compare_centres(whole, a, b, pair, known, out);
  return out;
}

SigmaScale sigma_scale(const std::vector<SolveDifference>& differences) {
  constexpr double kClear = 3, kShared = 0.5;
  // The rendered 5x5 rig of tests/app/chain_test.cpp fits its sigmas without a scale, and does not with one
  // below this.
  constexpr double kLarge = 2;
  double square = 0, freedom = 0;
  for (const SolveDifference& d : differences)
    for (const SolveDifference::Ratio& r : {d.lens, d.centre}) {
      if (!(r.freedom > 0) || !std::isfinite(r.square)) continue;
      square += r.freedom * r.square;
      freedom += r.freedom;
    }
  SigmaScale result;
  result.ratio = std::sqrt(square / freedom);  // NaN for 0 / 0
  result.freedom = kShared * freedom;
  const double excess = result.ratio * result.ratio - 1;
  if (result.ratio > kLarge && excess > kClear * std::sqrt(2 / result.freedom)) result.scale = result.ratio;
  return result;
}

}  // namespace stuv
