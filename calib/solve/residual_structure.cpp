#include "calib/solve/residual_structure.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <opencv2/imgproc.hpp>

namespace stuv {
namespace {

/// A view's residuals, fitted by r = mean + slope_x x + slope_y y, x and y from the corners' middle over
/// their deviation.
struct ViewFit {
  int board = -1, n = 0;
  Eigen::Vector2d mean = {0, 0}, by_row = {0, 0};
  double row_half_px = 0;  ///< of `by_row`: deviations of y in half the view's height
  double within_sq = 0;    ///< sum of squares that the fit leaves, over x and y
};

ViewFit fit_view(const BoardObservation& b, const std::vector<Eigen::Vector2d>& residuals, int board) {
  ViewFit fit;
  fit.board = board;
  std::vector<Eigen::Vector2d> q, r;
  for (std::size_t k = 0; k < residuals.size(); ++k)
    if (residuals[k].allFinite()) q.push_back(b.corners_px[k]), r.push_back(residuals[k]);
  fit.n = static_cast<int>(q.size());
  if (fit.n < 8) return fit;
  Eigen::Vector2d middle = Eigen::Vector2d::Zero(), var = middle;
  for (const auto& p : q) middle += p / fit.n;
  double half = 0;
  for (const auto& p : q) {
    var += (p - middle).cwiseAbs2() / fit.n;
    half = std::max(half, std::abs(p.y() - middle.y()));
  }
  const Eigen::Vector2d scale = var.cwiseSqrt().cwiseMax(1e-9);
  Eigen::MatrixXd A(fit.n, 3), R(fit.n, 2);
  for (int i = 0; i < fit.n; ++i) {
    const Eigen::Vector2d p = (q[i] - middle).cwiseQuotient(scale);
    A.row(i) << 1, p.x(), p.y();
    R.row(i) = r[i].transpose();
  }
  const Eigen::MatrixXd X = A.colPivHouseholderQr().solve(R);
  fit.mean = R.colwise().mean().transpose();
  fit.by_row = X.row(2).transpose();
  fit.row_half_px = half / scale.y();
  fit.within_sq = (R - A * X).squaredNorm();
  return fit;
}

/// Sum over means of n |mean|^2, against what noise makes of it.
struct Excess {
  double sum = 0, expected = 0, weight = 0;
  /// `n`: corners the mean is over; `sigma`: of one coordinate.
  void add(const Eigen::Vector2d& mean, double n, double sigma) {
    sum += n * mean.squaredNorm();
    expected += 2 * sigma * sigma;
    weight += n;
  }
  double px() const { return weight > 0 ? std::sqrt(std::max(0.0, sum - expected) / weight) : 0; }
  double ratio() const { return expected > 0 ? std::sqrt(sum / expected) : 0; }
};

Excess by_position(const Observations& in, const JointSolution& s, int camera, double sigma) {
  constexpr int nx = 12, ny = 8;
  std::array<Eigen::Vector3d, nx * ny> cell;
  cell.fill(Eigen::Vector3d::Zero());
  const Eigen::Vector2d size = in.size_px[camera].cast<double>();
  for (std::size_t i = 0; i < in.boards.size(); ++i) {
    if (in.boards[i].camera != camera) continue;
    for (std::size_t k = 0; k < s.residuals_px[i].size(); ++k) {
      const Eigen::Vector2d& r = s.residuals_px[i][k];
      if (!r.allFinite()) continue;
      const Eigen::Vector2d q = (in.boards[i].corners_px[k].array() + 0.5) / size.array();
      const int x = std::clamp(static_cast<int>(q.x() * nx), 0, nx - 1);
      const int y = std::clamp(static_cast<int>(q.y() * ny), 0, ny - 1);
      cell[static_cast<std::size_t>(y * nx + x)] += Eigen::Vector3d(r.x(), r.y(), 1);
    }
  }
  Excess excess;
  for (const Eigen::Vector3d& c : cell)
    if (c.z() >= 4) excess.add(c.head<2>() / c.z(), c.z(), sigma);
  return excess;
}

double usual_noise(const std::vector<ViewFit>& views) {
  double sum = 0, freedom = 0;
  for (const ViewFit& v : views)
    if (v.n >= 8) sum += v.within_sq, freedom += 2.0 * (v.n - 3);
  return freedom > 0 ? std::sqrt(sum / freedom) : 0;
}

}  // namespace

ResidualStructure residual_structure(const Observations& in, const JointSolution& s) {
  ResidualStructure out;
  std::vector<std::vector<ViewFit>> by_camera(in.camera_names.size()), by_set(in.set_names.size());
  for (std::size_t i = 0; i < in.boards.size(); ++i) {
    const BoardObservation& b = in.boards[i];
    if (!s.solved[b.camera]) continue;
    const ViewFit fit = fit_view(b, s.residuals_px[i], static_cast<int>(i));
    if (fit.n < 8) continue;
    by_camera[b.camera].push_back(fit);
    by_set[b.set].push_back(fit);
  }
  Excess position, view, row;
  for (std::size_t c = 0; c < by_camera.size(); ++c) {
    const double sigma = usual_noise(by_camera[c]);
    const Excess here = by_position(in, s, static_cast<int>(c), sigma);
    out.cameras.push_back({here.px(), here.ratio(), sigma});
    position.sum += here.sum, position.expected += here.expected, position.weight += here.weight;
    for (const ViewFit& v : by_camera[c]) {
      view.add(v.mean, v.n, sigma);
      // The slope's deviation is that of a mean, as y is scaled to deviation 1.
      row.add(v.by_row, v.n, sigma);
    }
  }
  out.position_px = position.px(), out.position_ratio = position.ratio();
  out.view_px = view.px(), out.view_ratio = view.ratio();
  out.row_px = row.px(), out.row_ratio = row.ratio();
  for (std::size_t k = 0; k < by_set.size(); ++k) {
    if (by_set[k].empty()) continue;
    ResidualStructure::BySet set{static_cast<int>(k)};
    double sum_sq = 0, n = 0, means = 0;
    for (const ViewFit& v : by_set[k]) {
      for (const Eigen::Vector2d& r : s.residuals_px[v.board])
        if (r.allFinite()) sum_sq += r.squaredNorm(), n += 2;
      means += v.mean.squaredNorm() / 2;
    }
    set.rms_px = std::sqrt(sum_sq / n);
    set.view_px = std::sqrt(means / static_cast<double>(by_set[k].size()));
    out.sets.push_back(set);
  }
  return out;
}

Coverage coverage_of(const Observations& in, const JointSolution& s, int camera) {
  Coverage out;
  std::vector<cv::Point2f> points;
  std::vector<Eigen::Vector3d> normals;
  std::array<int, 48> cell = {};
  std::array<int, 9> ninth = {};
  const Eigen::Vector2d size = in.size_px[camera].cast<double>();
  double sum_sq = 0;
  for (std::size_t i = 0; i < in.boards.size(); ++i) {
    if (in.boards[i].camera != camera) continue;
    ++out.boards;
    if (!s.solved[camera]) continue;
    normals.push_back((s.cameras[camera].cam_from_rig * s.ref_from_board[in.boards[i].set]).R.col(2));
    for (std::size_t k = 0; k < s.residuals_px[i].size(); ++k) {
      if (s.outlier[i][k]) ++out.outliers;
      const Eigen::Vector2d& r = s.residuals_px[i][k];
      if (!r.allFinite()) continue;
      ++out.inliers;
      sum_sq += r.squaredNorm();
      const Eigen::Vector2d q = in.boards[i].corners_px[k];
      points.emplace_back(static_cast<float>(q.x()), static_cast<float>(q.y()));
      const auto place = [&](int n, int axis) {
        return std::clamp(static_cast<int>((q[axis] + 0.5) / size[axis] * n), 0, n - 1);
      };
      ++cell[static_cast<std::size_t>(place(6, 1) * 8 + place(8, 0))];
      ++ninth[static_cast<std::size_t>(place(3, 1) * 3 + place(3, 0))];
    }
  }
  out.rms_px = std::sqrt(sum_sq / (2.0 * out.inliers));
  out.cells = static_cast<double>(std::count_if(cell.begin(), cell.end(), [](int n) { return n > 0; })) / 48;
  const auto emptiest = std::min_element(ninth.begin(), ninth.end()) - ninth.begin();
  out.empty = {(static_cast<double>(emptiest % 3) + 0.5) / 3, (static_cast<double>(emptiest / 3) + 0.5) / 3};
  out.has_empty = ninth[emptiest] == 0;
  for (const auto& a : normals)
    for (const auto& b : normals) out.tilt_rad = std::max(out.tilt_rad, std::acos(std::min(1.0, a.dot(b))));
  if (points.size() > 2) {
    std::vector<cv::Point2f> hull;
    cv::convexHull(points, hull);
    out.hull = cv::contourArea(hull) / (size.x() * size.y());
  }
  return out;
}

}  // namespace stuv
