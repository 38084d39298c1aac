#include "calib/board/refine.h"

#include <cmath>

namespace stuv {
namespace {

/// A window of pixels around a point, with the sums of its normal equations.
struct Window {
  int left = 0, top = 0, size = 0;
  Eigen::Matrix2d M = Eigen::Matrix2d::Zero();
  Eigen::Vector2d b = Eigen::Vector2d::Zero();  // of q - middle
};

std::optional<Window> window_at(const CornerImage& image, const Eigen::Vector2d& middle, double radius_px) {
  const int reach = static_cast<int>(std::ceil(radius_px));
  Window w{static_cast<int>(std::lround(middle.x())) - reach,
           static_cast<int>(std::lround(middle.y())) - reach,
           2 * reach + 1,
           {},
           {}};
  w.M.setZero();
  w.b.setZero();
  // One pixel to spare for the gradients.
  if (w.left < 1 || w.top < 1 || w.left + w.size >= image.luma.cols || w.top + w.size >= image.luma.rows)
    return std::nullopt;
  return w;
}

void add_up(const CornerImage& image, const Eigen::Vector2d& middle, double radius_px, Window& w) {
  for (int y = w.top; y < w.top + w.size; ++y) {
    const float* gx = image.gradient_x.ptr<float>(y);
    const float* gy = image.gradient_y.ptr<float>(y);
    for (int x = w.left; x < w.left + w.size; ++x) {
      const Eigen::Vector2d g(gx[x], gy[x]), d = Eigen::Vector2d(x, y) - middle;
      const double weight = std::exp(-2 * d.squaredNorm() / (radius_px * radius_px));
      w.M += weight * g * g.transpose();
      w.b += weight * g * g.dot(d);
    }
  }
}

/// Both directions of edges are there: else a single edge would let the point slide along it.
bool crosses(const Eigen::Matrix2d& M) {
  constexpr double kLeastRatio = 0.02;
  const Eigen::Vector2d values =
      Eigen::SelfAdjointEigenSolver<Eigen::Matrix2d>(M, Eigen::EigenvaluesOnly).eigenvalues();
  return values[0] > kLeastRatio * values[1] && values[1] > 0;
}

}  // namespace

std::optional<Eigen::Vector2d> refine_corner(const CornerImage& image, const Eigen::Vector2d& start,
                                             double radius_px, double most_shift_px) {
  constexpr int kMostRounds = 20;
  constexpr double kStillPx = 1e-3;
  Eigen::Vector2d q = start;
  for (int round = 0; round < kMostRounds; ++round) {
    std::optional<Window> w = window_at(image, q, radius_px);
    if (!w) return std::nullopt;
    add_up(image, q, radius_px, *w);
    if (!crosses(w->M)) return std::nullopt;
    const Eigen::Vector2d step = w->M.inverse() * w->b;
    q += step;
    if (!((q - start).norm() <= most_shift_px)) return std::nullopt;
    if (step.norm() <= kStillPx || round + 1 == kMostRounds) return q;
  }
  return std::nullopt;
}

}  // namespace stuv
