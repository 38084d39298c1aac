#include "calib/two_view/align_window.h"

#include <array>
#include <cmath>

namespace stuv {
namespace {

std::array<float, 4> keys(float t) {
  const float t2 = t * t, t3 = t2 * t;
  return {0.5F * (-t3 + 2 * t2 - t), 0.5F * (3 * t3 - 5 * t2 + 2), 0.5F * (-3 * t3 + 4 * t2 + t),
          0.5F * (t3 - t2)};
}

float sample(const ImageF& picture, double x, double y) {
  const int ix = static_cast<int>(x), iy = static_cast<int>(y);
  const auto wx = keys(static_cast<float>(x - ix)), wy = keys(static_cast<float>(y - iy));
  float sum = 0;
  for (int j = 0; j < 4; ++j) {
    const float* p = picture.row(iy + j - 1) + ix - 1;
    sum += wy[j] * (wx[0] * p[0] + wx[1] * p[1] + wx[2] * p[2] + wx[3] * p[3]);
  }
  return sum;
}

/// Whether a point may be sampled: its 4 x 4 neighbours exist.
bool inside(const ImageF& picture, const Eigen::Vector2d& p) {
  return p.x() >= 1 && p.y() >= 1 && p.x() < picture.width - 2 && p.y() < picture.height - 2;
}

bool corners_inside(const ImageF& picture, const WindowPlace& place, double r) {
  for (const double x : {-r, r})
    for (const double y : {-r, r})
      if (!inside(picture, place.centre_px + place.A * Eigen::Vector2d(x, y))) return false;
  return true;
}

}  // namespace

std::optional<Window> Window::at(const ImageF& picture, int x, int y, double noise, double most_sigma_px) {
  constexpr int kEdge = kRadius + 1;
  if (x < kEdge || y < kEdge || x + kEdge >= picture.width || y + kEdge >= picture.height)
    return std::nullopt;
  Window w;
  for (int dy = -kRadius, k = 0; dy <= kRadius; ++dy)
    for (int dx = -kRadius; dx <= kRadius; ++dx, ++k) {
      const int px = x + dx, py = y + dy;
      const float t = picture.at(px, py), tx = 0.5F * (picture.at(px + 1, py) - picture.at(px - 1, py)),
                  ty = 0.5F * (picture.at(px, py + 1) - picture.at(px, py - 1));
      const auto fx = static_cast<float>(dx), fy = static_cast<float>(dy);
      w.jacobian_.row(k) << tx, ty, tx * fx, tx * fy, ty * fx, ty * fy, t, 1;
    }
  if (!w.jacobian_.allFinite()) return std::nullopt;
  w.jacobian_.col(6).array() -= w.jacobian_.col(6).mean();
  const Eigen::Matrix<double, kPixels, kUnknowns> J = w.jacobian_.cast<double>();
  const Eigen::Matrix<double, kUnknowns, kUnknowns> normal = J.transpose() * J;
  // Scaled to a diagonal of 1, so that the test of rank does not hang on units.
  const Eigen::Matrix<double, kUnknowns, 1> d = normal.diagonal().cwiseMax(1e-30).cwiseSqrt().cwiseInverse();
  const Eigen::LDLT<Eigen::Matrix<double, kUnknowns, kUnknowns>> ldlt(d.asDiagonal() * normal *
                                                                      d.asDiagonal());
  if (!(ldlt.vectorD().minCoeff() > 1e-9)) return std::nullopt;
  w.inverse_ = d.asDiagonal() * ldlt.solve(Eigen::Matrix<double, kUnknowns, kUnknowns>::Identity()).eval() *
               d.asDiagonal();
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix2d> place(w.inverse_.topLeftCorner<2, 2>());
  w.sigma_per_noise_ = std::sqrt(place.eigenvalues()[1]);
  if (!(noise * w.sigma_per_noise_ < most_sigma_px)) return std::nullopt;
  return w;
}

std::optional<AlignedWindow> Window::find(const ImageF& picture, const WindowPlace& start,
                                          const AlignOptions& options) const {
  WindowPlace place = start;
  Column seen;
  Eigen::Matrix<double, kUnknowns, 1> x;
  bool settled = false;
  for (int step = 0; step <= options.most_steps; ++step) {
    if (!corners_inside(picture, place, kRadius)) return std::nullopt;
    for (int dy = -kRadius, k = 0; dy <= kRadius; ++dy)
      for (int dx = -kRadius; dx <= kRadius; ++dx, ++k) {
        const Eigen::Vector2d p = place.centre_px + place.A * Eigen::Vector2d(dx, dy);
        seen[k] = sample(picture, p.x(), p.y());
      }
    seen.array() -= seen.mean();  // b takes it up; sums of floats stay short
    // I(d) = g (T(d) + grad T (u + M d)) + b, linear in (g u, g M, g, b).
    x = inverse_ * (jacobian_.transpose() * seen).cast<double>();
    if (settled) break;
    const double gain = x[6];
    if (!(gain > 0.2 && gain < 5)) return std::nullopt;
    const Eigen::Vector2d u = x.head<2>() / gain;
    Eigen::Matrix2d M;
    M << x[2] / gain, x[3] / gain, x[4] / gain, x[5] / gain;
    // Far from the place the slopes are not to be trusted yet.
    if (step < 3) M.setZero();
    if (!(M.cwiseAbs().maxCoeff() < 0.5)) return std::nullopt;
    // What is seen at d belongs at d + u + M d.
    const Eigen::Matrix2d back = (Eigen::Matrix2d::Identity() + M).inverse();
    const Eigen::Vector2d shift = -place.A * back * u.cwiseMax(-2).cwiseMin(2);
    place.A *= back;
    place.centre_px += shift;
    if (!((place.centre_px - start.centre_px).norm() < options.most_shift_px)) return std::nullopt;
    settled = step > 3 && shift.norm() < 0.003;
  }
  if (!settled) return std::nullopt;
  const Column rest = seen - jacobian_ * x.cast<float>();
  const auto grey = jacobian_.col(6);
  AlignedWindow out;
  out.place = place;
  out.ncc = grey.dot(seen) / std::sqrt(double(grey.squaredNorm()) * double(seen.squaredNorm()) + 1e-30);
  out.sigma_px = std::sqrt(double(rest.squaredNorm()) / (kPixels - kUnknowns)) / x[6] * sigma_per_noise_;
  if (!(out.ncc > options.least_ncc) || !(out.sigma_px < options.most_sigma_px)) return std::nullopt;
  return out;
}

}  // namespace stuv
