#include "calib/board/symmetric_corner.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numbers>
#include <opencv2/imgproc.hpp>

#include "calib/board/pattern.h"

namespace stuv {
namespace {

constexpr double kSmoothPx = 1;

/// Value and gradient of a picture between its pixels.
struct Sample {
  double value = 0;
  Eigen::Vector2d gradient = Eigen::Vector2d::Zero();
};

/// Cubic convolution (Keys, 1981, a = -1/2) of the four pixels around, t in 0..1 behind the second, and its
/// derivative.
struct CubicWeights {
  std::array<double, 4> value, slope;
  explicit CubicWeights(double t) {
    const double t2 = t * t, t3 = t2 * t;
    value = {-0.5 * t3 + t2 - 0.5 * t, 1.5 * t3 - 2.5 * t2 + 1, -1.5 * t3 + 2 * t2 + 0.5 * t,
             0.5 * t3 - 0.5 * t2};
    slope = {-1.5 * t2 + 2 * t - 0.5, 4.5 * t2 - 5 * t, -4.5 * t2 + 4 * t + 0.5, 1.5 * t2 - t};
  }
};

/// False if one of the 16 pixels lies outside.
bool sample(const cv::Mat& picture, const Eigen::Vector2d& p, Sample& s) {
  const double left = std::floor(p.x()), top = std::floor(p.y());
  if (!(left >= 1 && top >= 1 && left + 2 < picture.cols && top + 2 < picture.rows)) return false;
  const CubicWeights x(p.x() - left), y(p.y() - top);
  s = {};
  for (int j = 0; j < 4; ++j) {
    const float* row = picture.ptr<float>(static_cast<int>(top) - 1 + j) + static_cast<int>(left) - 1;
    double value = 0, slope = 0;
    for (int i = 0; i < 4; ++i) {
      value += x.value[i] * row[i];
      slope += x.slope[i] * row[i];
    }
    s.value += y.value[j] * value;
    s.gradient += Eigen::Vector2d(y.value[j] * slope, y.slope[j] * value);
  }
  return true;
}

/// Half of the window: of each pair d, -d one. About one sample a pixel.
struct Window {
  int columns = 0, rows = 0;
  std::vector<Eigen::Vector2d> d;  // row by row
  std::vector<double> weight;
  Eigen::Vector2d step_px = {1, 1};  // between columns, between rows, measured across the others

  explicit Window(const LocalLattice& lattice) {
    constexpr int kLeast = 4, kMost = 32;
    const auto samples = [&](int axis) {
      return std::clamp(static_cast<int>(std::ceil(lattice.A.col(axis).norm())), kLeast, kMost);
    };
    const int nx = samples(0), ny = samples(1);
    // Flat in the middle, so that all of the edges counts; no step at the border, where samples come and go.
    const auto taper = [](double x) { return std::min(1.0, 3 * (1 - std::abs(x))); };
    columns = 2 * nx;
    rows = ny;
    for (int j = 0; j < ny; ++j)
      for (int i = -nx; i < nx; ++i) {
        d.emplace_back((i + 0.5) / nx, (j + 0.5) / ny);
        weight.push_back(taper(d.back().x()) * taper(d.back().y()));
      }
    const double area_px = std::abs(lattice.A.determinant());
    step_px = {area_px / lattice.A.col(1).norm() / nx, area_px / lattice.A.col(0).norm() / ny};
  }
};

using Matrix4 = Eigen::Matrix4d;
using Vector4 = Eigen::Vector4d;

/// Normal equations of (shift of q, plane of shading), and the terms w r J of b: each one's square, and those
/// of their sums along columns and rows.
struct Equations {
  Matrix4 H = Matrix4::Zero(), of_samples = Matrix4::Zero(), of_columns = Matrix4::Zero(),
          of_rows = Matrix4::Zero();
  Vector4 b = Vector4::Zero();
};

/// The pair at d: its residual and derivatives; false if it leaves the picture.
bool pair_at(const cv::Mat& smooth, const LocalLattice& lattice, const Eigen::Vector2d& q,
             const Eigen::Vector2d& d, double& residual, Vector4& J) {
  const Eigen::Vector2d middle = q + lattice.B * Eigen::Vector3d(d.x() * d.x(), d.x() * d.y(), d.y() * d.y()),
                        half = lattice.A * d;
  Sample here, there;
  if (!sample(smooth, middle + half, here) || !sample(smooth, middle - half, there)) return false;
  residual = here.value - there.value;
  J << here.gradient - there.gradient, -d;
  return true;
}

Equations equations_at(const cv::Mat& smooth, const LocalLattice& lattice, const Window& window,
                       const Eigen::Vector2d& q, const Eigen::Vector2d& shading) {
  Equations e;
  std::vector<Vector4> columns(static_cast<std::size_t>(window.columns), Vector4::Zero());
  for (int row = 0; row < window.rows; ++row) {
    Vector4 row_sum = Vector4::Zero();
    for (int column = 0; column < window.columns; ++column) {
      const auto k = static_cast<std::size_t>(row * window.columns + column);
      double residual = 0;
      Vector4 J;
      if (!pair_at(smooth, lattice, q, window.d[k], residual, J)) continue;
      residual -= shading.dot(window.d[k]);
      e.H += window.weight[k] * J * J.transpose();
      const Vector4 term = window.weight[k] * residual * J;
      e.b -= term;
      e.of_samples += term * term.transpose();
      row_sum += term;
      columns[static_cast<std::size_t>(column)] += term;
    }
    e.of_rows += row_sum * row_sum.transpose();
  }
  for (const Vector4& sum : columns) e.of_columns += sum * sum.transpose();
  return e;
}

/// Covariance of the shift; see the header.
Eigen::Matrix2d covariance_of(const Equations& e, const Window& window) {
  // Smoothed white noise is as correlated along a line as if its samples stood that many pixels apart.
  const double alike_px = 2 * std::sqrt(std::numbers::pi) * kSmoothPx;
  const double columns = alike_px / window.step_px.x(), rows = alike_px / window.step_px.y();
  const Matrix4 inverse = e.H.inverse();
  const auto shift = [&](const Matrix4& terms) -> Eigen::Matrix2d {
    return (inverse * terms * inverse).topLeftCorner<2, 2>();
  };
  const Eigen::Matrix2d one_by_one = shift(columns * rows * e.of_samples);
  const Eigen::Matrix2d by_lines = shift(columns * e.of_columns + rows * e.of_rows) - one_by_one;
  return by_lines.trace() > one_by_one.trace() ? by_lines : one_by_one;
}

/// Both directions of edges are there: else q could slide along one.
bool crosses(const Matrix4& H) {
  constexpr double kLeastRatio = 0.02;
  // A little on the diagonal: an empty window has no shading either.
  const Eigen::Matrix2d plane = H.bottomRightCorner<2, 2>() + 1e-9 * Eigen::Matrix2d::Identity();
  const Eigen::Matrix2d of_shift =
      H.topLeftCorner<2, 2>() - H.topRightCorner<2, 2>() * plane.inverse() * H.bottomLeftCorner<2, 2>();
  const Eigen::Vector2d values =
      Eigen::SelfAdjointEigenSolver<Eigen::Matrix2d>(of_shift, Eigen::EigenvaluesOnly).eigenvalues();
  return values[1] > 1e-6 && values[0] > kLeastRatio * values[1];
}

/// Lattice points near point i that were seen: offsets in metres, and pixels from q.
struct Neighbours {
  std::vector<Eigen::Vector2d> d, pixels;
};

Neighbours neighbours_of(std::size_t i, const std::vector<Eigen::Vector2d>& corners,
                         const std::vector<Eigen::Vector3d>& points, double reach_m) {
  Neighbours n;
  for (std::size_t k = 0; k < corners.size(); ++k) {
    const Eigen::Vector2d off = (points[k] - points[i]).head<2>();
    if (k == i || !corners[k].allFinite() || off.cwiseAbs().maxCoeff() > reach_m) continue;
    n.d.push_back(off);
    n.pixels.push_back(corners[k] - corners[i]);
  }
  return n;
}

/// By least squares over the neighbours; without the bend where they do not determine it.
std::optional<LocalLattice> lattice_from(const Neighbours& n) {
  const auto count = static_cast<Eigen::Index>(n.d.size());
  Eigen::MatrixXd M(count, 5), P(count, 2);
  for (Eigen::Index k = 0; k < count; ++k) {
    const Eigen::Vector2d d = n.d[static_cast<std::size_t>(k)];
    const double w = 1 / d.squaredNorm();  // what a cubic leaves out grows faster than that
    M.row(k) << w * d.x(), w * d.y(), w * d.x() * d.x(), w * d.x() * d.y(), w * d.y() * d.y();
    P.row(k) = w * n.pixels[static_cast<std::size_t>(k)].transpose();
  }
  constexpr double kLeastPivot = 0.02;
  for (const int columns : {5, 2}) {
    if (count < columns) continue;
    Eigen::MatrixXd part = M.leftCols(columns);
    const Eigen::VectorXd scale = part.colwise().norm();
    if (!(scale.minCoeff() > 0)) continue;
    part = part * scale.cwiseInverse().asDiagonal();
    Eigen::ColPivHouseholderQR<Eigen::MatrixXd> qr(part);
    qr.setThreshold(kLeastPivot);
    if (qr.rank() < columns) continue;
    const Eigen::MatrixXd x = scale.cwiseInverse().asDiagonal() * qr.solve(P);
    LocalLattice lattice;
    lattice.A = x.topRows(2).transpose();
    lattice.B.setZero();
    if (columns == 5) lattice.B = x.bottomRows(3).transpose();
    return lattice;
  }
  return std::nullopt;
}

/// How far a corner's neighbours may be along either axis [m]: two or three of them to each side.
double reach_m(const Board& board) {
  if (board.kind != Board::Kind::aprilgrid) return 2.5 * board.square_m;
  return 1.1 * (board.tag_steps + board.gap_steps) * board.square_m;
}

/// Half the window's side: larger ones see more of the lens than of the corner.
double half_window_m(const LocalLattice& a_metre, double most_m) {
  constexpr double kMostPx = 24;
  const double px_a_m = std::max(a_metre.A.col(0).norm(), a_metre.A.col(1).norm());
  return std::min(most_m, kMostPx / std::max(px_a_m, 1e-9));
}

LocalLattice in_units(LocalLattice lattice, double unit) {
  lattice.A *= unit;
  lattice.B *= unit * unit;
  return lattice;
}

}  // namespace

cv::Mat smooth_for_symmetry(const cv::Mat& luma) {
  cv::Mat smooth;
  cv::GaussianBlur(luma, smooth, {}, kSmoothPx, kSmoothPx, cv::BORDER_REPLICATE);
  return smooth;
}

std::optional<SymmetricCorner> refine_by_symmetry(const cv::Mat& smooth, const LocalLattice& lattice,
                                                  const Eigen::Vector2d& start, double most_shift_px) {
  constexpr int kMostRounds = 20;
  constexpr double kStillPx = 1e-3;
  const Window window(lattice);
  Eigen::Vector2d q = start, shading = Eigen::Vector2d::Zero();
  for (int round = 0; round < kMostRounds; ++round) {
    const Equations e = equations_at(smooth, lattice, window, q, shading);
    if (!crosses(e.H)) return std::nullopt;
    const Vector4 step = e.H.ldlt().solve(e.b);
    q += step.head<2>();
    shading += step.tail<2>();
    if (!((q - start).norm() <= most_shift_px)) return std::nullopt;
    if (step.head<2>().norm() > kStillPx) continue;
    return SymmetricCorner{q, covariance_of(e, window)};
  }
  return std::nullopt;
}

std::vector<double> refine_all_by_symmetry(const cv::Mat& luma, const Board& board,
                                           std::vector<Eigen::Vector2d>& corners_px) {
  const cv::Mat smooth = smooth_for_symmetry(luma);
  const std::vector<Eigen::Vector3d> points = board_points(board);
  // Of what is clear of other edges: nearly all where that is little, so that there is something to compare.
  const double share = board.kind == Board::Kind::chessboard ? 0.65 : 0.9;
  const double most_m = share * corner_clearance_m(board), reach = reach_m(board);
  std::vector<double> sigma(corners_px.size());
  // Twice: the first round's corners give better lattices.
  for (int round = 0; round < 2; ++round) {
    const std::vector<Eigen::Vector2d> before = corners_px;
    for (std::size_t i = 0; i < before.size(); ++i) {
      sigma[i] = before[i].allFinite() ? kUnrefinedPx : std::numeric_limits<double>::quiet_NaN();
      if (!before[i].allFinite()) continue;
      const auto metres = lattice_from(neighbours_of(i, before, points, reach));
      if (!metres) continue;
      const LocalLattice lattice = in_units(*metres, half_window_m(*metres, most_m));
      const double height =
          std::abs(lattice.A.determinant()) / std::max(lattice.A.col(0).norm(), lattice.A.col(1).norm());
      const auto corner = refine_by_symmetry(smooth, lattice, before[i], std::max(1.5, 0.3 * height));
      if (!corner) continue;
      corners_px[i] = corner->at_px;
      sigma[i] = std::sqrt(0.5 * corner->covariance.trace());
    }
  }
  return sigma;
}

}  // namespace stuv
