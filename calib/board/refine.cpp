#include "calib/board/refine.h"

#include <algorithm>
#include <cmath>
#include <vector>

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

double weight_of(const Eigen::Vector2d& d, double radius_px) {
  return std::exp(-2 * d.squaredNorm() / (radius_px * radius_px));
}

template <class Visit>
void for_each_pixel(const CornerImage& image, const Window& w, const Eigen::Vector2d& middle, Visit visit) {
  for (int y = w.top; y < w.top + w.size; ++y) {
    const float* gx = image.gradient_x.ptr<float>(y);
    const float* gy = image.gradient_y.ptr<float>(y);
    for (int x = w.left; x < w.left + w.size; ++x)
      visit(x - w.left, y - w.top, Eigen::Vector2d(gx[x], gy[x]), Eigen::Vector2d(x, y) - middle);
  }
}

void add_up(const CornerImage& image, const Eigen::Vector2d& middle, double radius_px, Window& w) {
  for_each_pixel(image, w, middle, [&](int, int, const Eigen::Vector2d& g, const Eigen::Vector2d& d) {
    const double weight = weight_of(d, radius_px);
    w.M += weight * g * g.transpose();
    w.b += weight * g * g.dot(d);
  });
}

/// Both directions of edges are there: else a single edge would let the point slide along it.
bool crosses(const Eigen::Matrix2d& M) {
  constexpr double kLeastRatio = 0.02;
  const Eigen::Vector2d values =
      Eigen::SelfAdjointEigenSolver<Eigen::Matrix2d>(M, Eigen::EigenvaluesOnly).eigenvalues();
  return values[0] > kLeastRatio * values[1] && values[1] > 0;
}

Eigen::Matrix2d covariance_of(const CornerImage& image, const Eigen::Vector2d& middle, double radius_px,
                              double noise, const Window& w) {
  const int side = w.size + 2;
  std::vector<Eigen::Vector2d> c(static_cast<std::size_t>(side) * static_cast<std::size_t>(side),
                                 Eigen::Vector2d::Zero());
  const auto at = [&](int x, int y) -> Eigen::Vector2d& {
    return c[static_cast<std::size_t>(y + 1) * static_cast<std::size_t>(side) +
             static_cast<std::size_t>(x + 1)];
  };
  Eigen::Matrix2d second = Eigen::Matrix2d::Zero();
  for_each_pixel(image, w, middle, [&](int x, int y, const Eigen::Vector2d& g, const Eigen::Vector2d& d) {
    const double weight = weight_of(d, radius_px);
    const Eigen::Matrix2d A = 0.5 * weight * (g * d.transpose() + g.dot(d) * Eigen::Matrix2d::Identity());
    at(x + 1, y) += A.col(0);
    at(x - 1, y) -= A.col(0);
    at(x, y + 1) += A.col(1);
    at(x, y - 1) -= A.col(1);
    second += 0.25 * weight * weight * (d * d.transpose() + d.squaredNorm() * Eigen::Matrix2d::Identity());
  });
  Eigen::Matrix2d first = Eigen::Matrix2d::Zero();
  for (const Eigen::Vector2d& v : c) first += v * v.transpose();
  const Eigen::Matrix2d inverse = w.M.inverse();
  const double variance = noise * noise;
  return inverse * (variance * first + variance * variance * second) * inverse;
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

std::optional<Eigen::Matrix2d> corner_covariance(const CornerImage& image, const Eigen::Vector2d& at,
                                                 double radius_px, double noise) {
  std::optional<Window> w = window_at(image, at, radius_px);
  if (!w) return std::nullopt;
  add_up(image, at, radius_px, *w);
  if (!crosses(w->M)) return std::nullopt;
  return covariance_of(image, at, radius_px, noise, *w);
}

double picture_noise(const CornerImage& image, const cv::Rect& area) {
  const cv::Rect inner = area & cv::Rect(1, 1, image.luma.cols - 2, image.luma.rows - 2);
  std::vector<float> values;
  for (int y = inner.y; y < inner.y + inner.height; ++y) {
    const float *a = image.luma.ptr<float>(y - 1), *b = image.luma.ptr<float>(y),
                *c = image.luma.ptr<float>(y + 1);
    for (int x = inner.x; x < inner.x + inner.width; ++x)
      values.push_back(std::abs(a[x - 1] - 2 * a[x] + a[x + 1] - 2 * (b[x - 1] - 2 * b[x] + b[x + 1]) +
                                c[x - 1] - 2 * c[x] + c[x + 1]));
  }
  const double rounding = 1 / std::sqrt(12.0);
  if (values.empty()) return rounding;
  const auto middle = values.begin() + static_cast<long>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  constexpr double kDeviationPerMedian = 1.4826, kFilterNorm = 6;
  return std::hypot(rounding, kDeviationPerMedian * *middle / kFilterNorm);
}

}  // namespace stuv
