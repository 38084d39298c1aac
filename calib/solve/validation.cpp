#include "calib/solve/validation.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <mutex>

#include "calib/solve/camera_sight.h"
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
  double noise_sq = 0, states_sq = 0;  ///< the corners' and the covariance's part
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
  const double variance = fold.noise_px * fold.noise_px;
  return {variance * rows, variance * trace, rows};
}

struct Fold {
  HeldOutError error;
  Predicted predicted;
  SolveDifference difference;
  std::vector<double> focal_sigma;  ///< relative, of each camera
};

std::vector<double> focal_sigmas(const JointSolution& s) {
  std::vector<double> sigma(s.solved.size(), std::numeric_limits<double>::infinity());
  if (s.focal_sigma.empty()) return sigma;
  for (std::size_t c = 0; c < sigma.size(); ++c)
    if (s.solved[c] && s.converged)
      sigma[c] = s.noise_px * s.focal_sigma[c].maxCoeff() / std::abs(s.cameras[c].intrinsics[0]);
  return sigma;
}

Fold run_fold(const Observations& in, const JointSolution& whole, int set, double distance_m,
              const SolveOptions& options) {
  std::vector<bool> with(in.set_names.size(), true);
  with[set] = false;
  const JointSolution fold = solve_again(in, whole, with, options);
  Fold result;
  result.focal_sigma = focal_sigmas(fold);
  if (!std::count(fold.solved.begin(), fold.solved.end(), true)) return result;
  result.error = held_out_error(in, fold, set, whole);
  result.difference = solve_difference(whole, fold, whole, SolvePair::nested, distance_m);
  if (result.error.count > 0 && fold.camera_covariance.size() > 0)
    result.predicted = predicted_error(in, fold, whole, result.error.ref_from_board, set);
  return result;
}

CrossValidation sum_of(const std::vector<Fold>& folds, double sigma_scale) {
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
    predicted += (f.predicted.noise_sq + sigma_scale * sigma_scale * f.predicted.states_sq) * f.error.count /
                 f.predicted.rows;
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

std::optional<HalfData> half_data(const SolveDifference& d) {
  if (d.cameras.size() < 2) return std::nullopt;
  const auto ratio = [](const SolveDifference::Ratio& r) {
    return r.freedom > 0 ? std::sqrt(r.square) : kNaN;
  };
  return HalfData{d.cameras, ratio(d.lens), ratio(d.centre)};
}

}  // namespace

Validation validate_solution(const Observations& in, const JointSolution& solution,
                             const SolveOptions& options, int most_folds, const Reporter& reporter) {
  Validation result;
  const std::vector<int> sets = sets_of(in, solution);
  if (sets.size() < 2 || !solution.converged || most_folds <= 0) return result;
  const int n_folds = std::min(most_folds, static_cast<int>(sets.size()));
  const int jobs = n_folds + 2;
  const double distance_m = mean_distance(in, solution);
  std::vector<Fold> folds(n_folds);
  JointSolution halves[2];
  std::mutex mutex;
  int done = 0;
  parallel_for(jobs, [&](int job) {
    if (job >= 2) {
      const int f = job - 2;
      const int set = sets[static_cast<std::size_t>(f) * sets.size() / n_folds];
      folds[f] = run_fold(in, solution, set, distance_m, options);
    } else {
      std::vector<bool> with(in.set_names.size(), false);
      for (std::size_t i = static_cast<std::size_t>(job); i < sets.size(); i += 2) with[sets[i]] = true;
      halves[job] = solve_again(in, solution, with, options);
    }
    const std::lock_guard<std::mutex> lock(mutex);
    reporter.at("cross-validating", ++done, jobs);
  });
  std::vector<SolveDifference> differences = {
      solve_difference(solution, halves[0], halves[1], SolvePair::separate, distance_m)};
  result.halves = half_data(differences.front());
  result.focal_sigma_without = focal_sigmas(halves[0]);
  const auto note = [&](const std::vector<double>& sigma) {
    for (std::size_t c = 0; c < sigma.size(); ++c)
      result.focal_sigma_without[c] = std::min(result.focal_sigma_without[c], sigma[c]);
  };
  note(focal_sigmas(halves[1]));
  for (Fold& f : folds) {
    note(f.focal_sigma);
    differences.push_back(std::move(f.difference));
  }
  result.sigma = sigma_scale(differences);
  const CrossValidation left_out = sum_of(folds, result.sigma.scale);
  if (left_out.residuals > 0) result.left_out = left_out;
  return result;
}

}  // namespace stuv
