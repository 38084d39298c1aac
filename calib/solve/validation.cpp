#include "calib/solve/validation.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <mutex>

#include "calib/solve/camera_sight.h"
#include "calib/solve/uncertainty.h"
#include "core/parallel.h"

namespace stuv {
namespace {

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();

std::vector<int> sets_of(const Observations& in, const JointSolution& solution) {
  std::vector<int> sets;
  for (const BoardObservation& b : in.boards)
    if (solution.solved[b.camera]) sets.push_back(b.set);
  std::sort(sets.begin(), sets.end());
  sets.erase(std::unique(sets.begin(), sets.end()), sets.end());
  return sets;
}

/// Sum over some corners of a held-out view of what e^T e, e the residual after the board's pose was fitted,
/// should be; corners' noise included.
///
///   E|P (n + J d)|^2 = s^2 (rows - 6 + trace(J S J^T) - trace(Q^T J S J^T Q)),  P = I - Q Q^T
///
/// Q spans what the board's pose can do; J: d residual / d camera states, S their covariance at unit noise.
struct Predicted {
  double sum_sq = 0;
  int rows = 0;
};

Predicted predicted_error(const Observations& in, const JointSolution& fold, const JointSolution& whole,
                          const Pose& ref_from_board, int set) {
  constexpr std::size_t kMostCorners = 24;
  const std::vector<Eigen::Vector3d> model = board_points(in.board);
  const Eigen::Index k = fold.camera_states, states = fold.camera_covariance.cols();
  std::vector<Eigen::Matrix<double, 2, 6>> by_board;
  std::vector<Eigen::Matrix<double, 2, Eigen::Dynamic>> by_states;
  std::vector<int> camera;
  double trace = 0;
  for (std::size_t i = 0; i < in.boards.size(); ++i) {
    const BoardObservation& b = in.boards[i];
    if (b.set != set || !fold.solved[b.camera]) continue;
    std::vector<std::size_t> corners;
    for (std::size_t c = 0; c < model.size(); ++c)
      if (whole.residuals_px[i][c].allFinite()) corners.push_back(c);
    const std::size_t step = 1 + corners.size() / kMostCorners;
    const mrcal_lensmodel_t lens = lens_model_of(fold.cameras[b.camera]);
    for (std::size_t c = 0; c < corners.size(); c += step) {
      const Eigen::Vector3d x = ref_from_board * model[corners[c]];
      const auto sight = camera_sight(fold.cameras[b.camera], lens, {x, 1});
      if (!sight) continue;
      const double weight = whole.camera_weight[b.camera];
      by_states.push_back(weight * sight->by_states);
      Eigen::Matrix<double, 2, 6> board;
      board << -sight->by_direction * cross_matrix(x), sight->by_direction;
      by_board.push_back(weight * board);
      camera.push_back(b.camera);
      trace += (by_states.back() * fold.camera_covariance.block(k * b.camera, k * b.camera, k, k) *
                by_states.back().transpose())
                   .trace();
    }
  }
  const auto n = static_cast<Eigen::Index>(camera.size());
  if (n < 4) return {};
  Eigen::MatrixXd G(2 * n, 6);
  for (Eigen::Index i = 0; i < n; ++i) G.middleRows<2>(2 * i) = by_board[i];
  const Eigen::RowVectorXd scale = G.colwise().norm().cwiseInverse();  // a lazy one would change with G
  G = G * scale.asDiagonal();
  const Eigen::MatrixXd Q =
      Eigen::HouseholderQR<Eigen::MatrixXd>(G).householderQ() * Eigen::MatrixXd::Identity(2 * n, 6);
  Eigen::MatrixXd QtJ = Eigen::MatrixXd::Zero(6, states);
  for (Eigen::Index i = 0; i < n; ++i)
    QtJ.middleCols(k * camera[i], k) += Q.middleRows<2>(2 * i).transpose() * by_states[i];
  trace -= (QtJ * fold.camera_covariance * QtJ.transpose()).trace();
  const int rows = static_cast<int>(2 * n - 6);
  return {fold.noise_px * fold.noise_px * (rows + trace), rows};
}

struct Fold {
  HeldOutError error;
  Predicted predicted;
};

Fold run_fold(const Observations& in, const JointSolution& whole, int set, const SolveOptions& options) {
  std::vector<bool> with(in.set_names.size(), true);
  with[set] = false;
  const JointSolution fold = solve_again(in, whole, with, options);
  Fold result;
  if (!std::count(fold.solved.begin(), fold.solved.end(), true)) return result;
  result.error = held_out_error(in, fold, set, whole);
  if (result.error.count > 0 && fold.camera_covariance.size() > 0)
    result.predicted = predicted_error(in, fold, whole, result.error.ref_from_board, set);
  return result;
}

CrossValidation sum_of(const std::vector<Fold>& folds) {
  CrossValidation cv;
  double sum_sq = 0, predicted = 0, rows = 0;
  bool known = true;
  for (const Fold& f : folds) {
    if (f.error.count == 0 || !std::isfinite(f.error.sum_sq_px2)) continue;
    ++cv.folds;
    cv.residuals += f.error.count;
    sum_sq += f.error.sum_sq_px2;
    known = known && f.predicted.rows > 0;
    if (f.predicted.rows == 0) continue;
    predicted += f.predicted.sum_sq * f.error.count / f.predicted.rows;
    rows += f.error.count;
  }
  cv.rms_px = std::sqrt(sum_sq / cv.residuals);
  cv.predicted_px = known && rows > 0 ? std::sqrt(predicted / rows) : kNaN;
  return cv;
}

double mean_distance(const Observations& in, const JointSolution& s) {
  double sum = 0;
  int count = 0;
  for (const BoardObservation& b : in.boards) {
    if (!s.solved[b.camera]) continue;
    sum += (s.cameras[b.camera].cam_from_rig * s.ref_from_board[b.set]).t.norm();
    ++count;
  }
  return count > 0 ? sum / count : 1;
}

/// Both lenses' difference over the picture, what a pose can make up for taken out; and its prediction.
void compare_lenses(const JointSolution& whole, const JointSolution& a, const JointSolution& b,
                    double distance_m, HalfData::Camera& out) {
  const Camera& camera = whole.cameras[out.camera];
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
  if (rows < 20) return;
  J.conservativeResize(rows, Eigen::NoChange);
  const Eigen::MatrixXd Q = Eigen::HouseholderQR<Eigen::MatrixXd>(J.rightCols<6>()).householderQ() *
                            Eigen::MatrixXd::Identity(rows, 6);
  const Eigen::MatrixXd PJ = J.leftCols(n_lens) - Q * (Q.transpose() * J.leftCols(n_lens));
  Eigen::VectorXd difference(n_lens);
  for (Eigen::Index i = 0; i < n_lens; ++i)
    difference[i] = a.cameras[out.camera].intrinsics[i] - b.cameras[out.camera].intrinsics[i];
  const Eigen::Index at = whole.camera_states * out.camera;
  const Eigen::MatrixXd S = std::pow(a.noise_px, 2) * a.camera_covariance.block(at, at, n_lens, n_lens) +
                            std::pow(b.noise_px, 2) * b.camera_covariance.block(at, at, n_lens, n_lens);
  const double points = 0.5 * static_cast<double>(rows);
  out.lens_px = (PJ * difference).norm() / std::sqrt(points);
  out.lens_predicted_px = std::sqrt((PJ * S * PJ.transpose()).trace() / points);
}

void compare_centres(const JointSolution& a, const JointSolution& b, HalfData& out) {
  const auto n = static_cast<Eigen::Index>(out.cameras.size());
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
  const Eigen::MatrixXd S = std::pow(a.noise_px, 2) * block_of(a.pose_covariance, which, 6) +
                            std::pow(b.noise_px, 2) * block_of(b.pose_covariance, which, 6);
  const Eigen::VectorXd variance = rigidly_aligned_poses(S, centres).diagonal();
  for (Eigen::Index i = 0; i < n; ++i) {
    out.cameras[i].centre_m =
        (T.topLeftCorner<3, 3>() * from.col(i) + T.topRightCorner<3, 1>() - to.col(i)).norm();
    out.cameras[i].centre_predicted_m = std::sqrt(std::max(0.0, variance.segment<3>(6 * i + 3).sum()));
  }
}

std::optional<HalfData> compare_halves(const Observations& in, const JointSolution& whole,
                                       const JointSolution& a, const JointSolution& b) {
  if (a.camera_covariance.size() == 0 || b.camera_covariance.size() == 0) return std::nullopt;
  HalfData out;
  for (std::size_t c = 0; c < whole.solved.size(); ++c)
    if (a.solved[c] && b.solved[c]) out.cameras.push_back({static_cast<int>(c)});
  if (out.cameras.size() < 2) return std::nullopt;
  const double distance = mean_distance(in, whole);
  for (HalfData::Camera& camera : out.cameras) compare_lenses(whole, a, b, distance, camera);
  compare_centres(a, b, out);
  // Where a half knows a lens to a pixel only, it is too far from the whole for its covariance to mean much.
  constexpr double kMostPx = 1;
  double lens = 0, centre = 0, count = 0;
  for (const HalfData::Camera& c : out.cameras) {
    if (!(c.lens_predicted_px < kMostPx)) continue;
    if (c.lens_predicted_px > 0) lens += std::pow(c.lens_px / c.lens_predicted_px, 2);
    if (c.centre_predicted_m > 0) centre += std::pow(c.centre_m / c.centre_predicted_m, 2);
    ++count;
  }
  out.lens_ratio = std::sqrt(lens / count);
  out.centre_ratio = std::sqrt(centre / count);
  return out;
}

}  // namespace

Validation validate_solution(const Observations& in, const JointSolution& solution,
                             const SolveOptions& options, int most_folds, const Reporter& reporter) {
  Validation result;
  const std::vector<int> sets = sets_of(in, solution);
  if (sets.size() < 2 || !solution.converged || most_folds <= 0) return result;
  const int n_folds = std::min(most_folds, static_cast<int>(sets.size()));
  const int jobs = n_folds + 2;
  std::vector<Fold> folds(n_folds);
  JointSolution halves[2];
  std::mutex mutex;
  int done = 0;
  parallel_for(jobs, [&](int job) {
    if (job >= 2) {
      const int f = job - 2;
      folds[f] = run_fold(in, solution, sets[static_cast<std::size_t>(f) * sets.size() / n_folds], options);
    } else {
      std::vector<bool> with(in.set_names.size(), false);
      for (std::size_t i = static_cast<std::size_t>(job); i < sets.size(); i += 2) with[sets[i]] = true;
      halves[job] = solve_again(in, solution, with, options);
    }
    const std::lock_guard<std::mutex> lock(mutex);
    reporter.at("cross-validating", ++done, jobs);
  });
  const CrossValidation left_out = sum_of(folds);
  if (left_out.residuals > 0) result.left_out = left_out;
  result.halves = compare_halves(in, solution, halves[0], halves[1]);
  return result;
}

}  // namespace stuv
