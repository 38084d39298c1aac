#include "calib/rectify/neighbour_matches.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <opencv2/imgproc.hpp>
#include <optional>

#include "core/median.h"

namespace stuv {
namespace {

constexpr int kPatch = 5, kBeside_px = 2;  ///< half of the correlated window; search across the line
constexpr int kWindow = 10;                ///< half of the window of least-squares matching
constexpr double kLeastCorrelation = 0.8, kLeastLead = 0.04;

cv::Mat view_of(const Raster<std::uint8_t>& raster) {
  return {raster.height, raster.width, CV_8U, const_cast<std::uint8_t*>(raster.data.data())};
}

/// Largest parallax where the scene does not say how near it is: a quarter of the picture.
double nearest_inverse_depth(const LightField& lf, const View& a, const View& b) {
  if (lf.has_range()) return lf.inverse_depth(lf.d_max);
  return 0.25 * lf.width / (lf.focal_px * std::max(1e-9, std::hypot(b.s - a.s, b.t - a.t)));
}

/// Pixel in b of the point on a's pixel ray at inverse depth from the plane.
Eigen::Vector2d transfer(const LightField& lf, const View& a, const View& b, const Eigen::Vector2d& q,
                         double inverse_z) {
  // Everything divided by Z: X / Z = s / Z + x (1 - w / Z).
  const Eigen::Vector2d x((q.x() - a.cx_px) / lf.focal_px, (q.y() - a.cy_px) / lf.focal_px);
  const Eigen::Vector2d from(a.s, a.t), to(b.s, b.t);
  const Eigen::Vector2d moved = ((from - to) * inverse_z + x * (1 - a.w * inverse_z)) / (1 - b.w * inverse_z);
  return {b.cx_px + lf.focal_px * moved.x(), b.cy_px + lf.focal_px * moved.y()};
}

struct Window {
  int x = 0, y = 0;
};

bool fits(const GreyView& v, int x, int y, int half) {
  return x >= half && y >= half && x < v.grey.width - half && y < v.grey.height - half;
}

bool there(const GreyView& v, int x, int y, int half) {
  if (!fits(v, x, y, half)) return false;
  if (v.mask.empty()) return true;
  for (int j : {-half, 0, half})
    for (int i : {-half, 0, half})
      if (v.mask.at(x + i, y + j) == 0) return false;
  return true;
}

/// Normalised cross-correlation of two windows; -1 where one is flat.
double correlation(const GreyView& a, Window p, const GreyView& b, Window q) {
  constexpr int n = (2 * kPatch + 1) * (2 * kPatch + 1);
  int sa = 0, sb = 0, saa = 0, sbb = 0, sab = 0;
  for (int j = -kPatch; j <= kPatch; ++j) {
    const std::uint8_t *ra = a.grey.row(p.y + j) + p.x, *rb = b.grey.row(q.y + j) + q.x;
    for (int i = -kPatch; i <= kPatch; ++i) {
      const int va = ra[i], vb = rb[i];
      sa += va, sb += vb, saa += va * va, sbb += vb * vb, sab += va * vb;
    }
  }
  const double va = double(saa) * n - double(sa) * sa, vb = double(sbb) * n - double(sb) * sb;
  if (va <= 0 || vb <= 0) return -1;
  return (double(sab) * n - double(sa) * sb) / std::sqrt(va * vb);
}

/// The most alike place in b, unless a second one (more than 3 px from it) is nearly as alike.
std::optional<Window> search(const LightField& lf, const View& a, const View& b, const GreyView& grey_a,
                             const GreyView& grey_b, Window p) {
  const auto [far, near] = epipolar_segment(lf, a, b, Eigen::Vector2d(p.x, p.y));
  const Eigen::Vector2d way = near - far;
  const int steps = std::max(1, static_cast<int>(std::ceil(way.norm())));
  const Eigen::Vector2d beside =
      way.norm() > 0 ? Eigen::Vector2d(-way.y(), way.x()).normalized() : Eigen::Vector2d(0, 1);
  // A little beyond both ends, as neither they nor the rig are exact.
  constexpr int kBeyond = 3;
  std::vector<std::pair<double, Window>> tried;
  for (int k = -kBeyond; k <= steps + kBeyond; ++k)
    for (int e = -kBeside_px; e <= kBeside_px; e += kBeside_px) {
      const Eigen::Vector2d q = far + way * (k / double(steps)) + beside * e;
      const Window w{static_cast<int>(std::lround(q.x())), static_cast<int>(std::lround(q.y()))};
      if (there(grey_b, w.x, w.y, kPatch)) tried.emplace_back(correlation(grey_a, p, grey_b, w), w);
    }
  if (tried.empty()) return std::nullopt;
  const auto best = *std::max_element(tried.begin(), tried.end(),
                                      [](const auto& l, const auto& r) { return l.first < r.first; });
  if (best.first < kLeastCorrelation) return std::nullopt;
  for (const auto& [score, w] : tried)
    if (score > best.first - kLeastLead && std::hypot(w.x - best.second.x, w.y - best.second.y) > 3)
      return std::nullopt;
  return best.second;
}

float bilinear(const cv::Mat& m, double x, double y) {
  const int x0 = static_cast<int>(x), y0 = static_cast<int>(y);
  const auto fx = static_cast<float>(x - x0), fy = static_cast<float>(y - y0);
  const float *r0 = m.ptr<float>(y0) + x0, *r1 = m.ptr<float>(y0 + 1) + x0;
  return (1 - fy) * ((1 - fx) * r0[0] + fx * r0[1]) + fy * ((1 - fx) * r1[0] + fx * r1[1]);
}

struct Refined {
  Eigen::Vector2d in_b;
  Eigen::Matrix2d covariance;
};

/// a(p + x) = h0 + h1 b(q + A x): the eight unknowns are q, A, h0, h1; Gauss-Newton from A = I.
std::optional<Refined> least_squares_match(const cv::Mat& a, const cv::Mat& b, Window p, Window start) {
  constexpr int kMostSteps = 15;
  constexpr double kMostShift_px = 4;
  Eigen::Vector2d q(start.x, start.y);
  Eigen::Matrix2d A = Eigen::Matrix2d::Identity();
  double h0 = 0, h1 = 1;
  using Vector8 = Eigen::Matrix<double, 8, 1>;
  using Matrix8 = Eigen::Matrix<double, 8, 8>;
  for (int step = 0; step < kMostSteps; ++step) {
    Matrix8 N = Matrix8::Zero();
    Vector8 rhs = Vector8::Zero();
    double error = 0, weights = 0;
    for (int j = -kWindow; j <= kWindow; ++j)
      for (int i = -kWindow; i <= kWindow; ++i) {
        const Eigen::Vector2d at = q + A * Eigen::Vector2d(i, j);
        if (at.x() < 1 || at.y() < 1 || at.x() >= b.cols - 3 || at.y() >= b.rows - 3) return std::nullopt;
        const double value = bilinear(b, at.x(), at.y());
        const double gx = 0.5 * (bilinear(b, at.x() + 1, at.y()) - bilinear(b, at.x() - 1, at.y()));
        const double gy = 0.5 * (bilinear(b, at.x(), at.y() + 1) - bilinear(b, at.x(), at.y() - 1));
        const double r = a.at<float>(p.y + j, p.x + i) - h0 - h1 * value;
        const double w = std::exp(-(i * i + j * j) / (2 * 36.0));
        Vector8 J;
        J << h1 * gx, h1 * gy, h1 * gx * i, h1 * gx * j, h1 * gy * i, h1 * gy * j, 1, value;
        N.noalias() += w * J * J.transpose();
        rhs += w * r * J;
        error += w * r * r;
        weights += w;
      }
    const Eigen::LDLT<Matrix8> ldlt(N);
    const Vector8 d = ldlt.solve(rhs);
    if (!d.allFinite()) return std::nullopt;
    q += d.head<2>();
    A(0, 0) += d[2], A(0, 1) += d[3], A(1, 0) += d[4], A(1, 1) += d[5];
    h0 += d[6], h1 += d[7];
    if ((q - Eigen::Vector2d(start.x, start.y)).norm() > kMostShift_px || h1 < 0.3 || h1 > 3 ||
        (A - Eigen::Matrix2d::Identity()).norm() > 0.7)
      return std::nullopt;
    if (d.head<2>().norm() > 0.003) continue;
    // Smoothed pixels are not independent: about 4 pi sigma^2 of them make one.
    constexpr double kIndependent = 4 * 3.14159 * 1.0;
    const Matrix8 cov = ldlt.solve(Matrix8::Identity()) * (error / weights) * kIndependent;
    return Refined{q, cov.topLeftCorner<2, 2>()};
  }
  return std::nullopt;
}

std::vector<cv::Point2f> corners_of(const GreyView& view, int most) {
  std::vector<cv::Point2f> corners;
  cv::Mat mask;
  if (!view.mask.empty()) cv::erode(view_of(view.mask), mask, cv::Mat::ones(15, 15, CV_8U));
  const double apart = std::max(8.0, 0.4 * std::sqrt(double(view.grey.width) * view.grey.height / most));
  cv::goodFeaturesToTrack(view_of(view.grey), corners, most, 0.005, apart, mask, 5);
  return corners;
}

cv::Mat smoothed(const GreyView& view) {
  cv::Mat out;
  view_of(view.grey).convertTo(out, CV_32F);
  cv::GaussianBlur(out, out, {}, 1.0);
  return out;
}

}  // namespace

GreyView grey_view(const Image& rectified) {
  const ImageF pixels = to_float(rectified);
  GreyView view{Raster<std::uint8_t>(rectified.width, rectified.height, 1), rectified.mask};
  const std::size_t n = view.grey.data.size();
  std::vector<float> grey(n);
  for (std::size_t i = 0; i < n; ++i) {
    for (int c = 0; c < pixels.channels; ++c)
      grey[i] += pixels.data[i * pixels.channels + c] / static_cast<float>(pixels.channels);
  }
  float top = 1;
  if (rectified.type != PixelType::u8) {
    const float bright = value_of_rank(grey, 0.99);
    top = bright > 0 ? bright : 1;
  }
  for (std::size_t i = 0; i < n; ++i)
    view.grey.data[i] = static_cast<std::uint8_t>(std::lrint(255 * std::clamp(grey[i] / top, 0.0F, 1.0F)));
  return view;
}

std::vector<std::pair<int, int>> neighbours(const LightField& lf, int reach) {
  std::map<std::pair<int, int>, int> at;
  for (const int i : lf.views_with(ViewRole::input)) at[{lf.views[i].row, lf.views[i].col}] = i;
  std::vector<std::pair<int, int>> pairs;
  const auto look = [&](int view, int rows, int cols) {
    const View& from = lf.views[view];
    int found = 0;
    for (int k = 1; from.row + k * rows < lf.rows && from.col + k * cols < lf.cols && found < reach; ++k)
      if (const auto next = at.find({from.row + k * rows, from.col + k * cols}); next != at.end()) {
        pairs.emplace_back(view, next->second);
        ++found;
      }
  };
  for (const auto& [place, view] : at) {
    look(view, 0, 1);
    look(view, 1, 0);
  }
  return pairs;
}

std::pair<Eigen::Vector2d, Eigen::Vector2d> epipolar_segment(const LightField& lf, const View& a,
                                                             const View& b, const Eigen::Vector2d& in_a) {
  return {transfer(lf, a, b, in_a, 0), transfer(lf, a, b, in_a, nearest_inverse_depth(lf, a, b))};
}

std::vector<ViewMatch> match_views(const LightField& lf, int a, int b, const GreyView& grey_a,
                                   const GreyView& grey_b, int most_features) {
  constexpr double kMostSigma_px = 0.1;
  const View &va = lf.views[a], &vb = lf.views[b];
  const cv::Mat smooth_a = smoothed(grey_a), smooth_b = smoothed(grey_b);
  std::vector<ViewMatch> matches;
  int feature = -1;
  for (const cv::Point2f& corner : corners_of(grey_a, most_features)) {
    ++feature;
    const Window p{static_cast<int>(std::lround(corner.x)), static_cast<int>(std::lround(corner.y))};
    if (!there(grey_a, p.x, p.y, kWindow)) continue;
    const auto start = search(lf, va, vb, grey_a, grey_b, p);
    if (!start || !there(grey_b, start->x, start->y, kWindow)) continue;
    const auto found = least_squares_match(smooth_a, smooth_b, p, *start);
    if (!found) continue;
    const auto [far, near] = epipolar_segment(lf, va, vb, Eigen::Vector2d(p.x, p.y));
    const Eigen::Vector2d way = near - far;
    if (!(way.norm() > 0)) continue;
    const Eigen::Vector2d across = Eigen::Vector2d(-way.y(), way.x()).normalized();
    if (!(across.dot(found->covariance * across) < kMostSigma_px * kMostSigma_px)) continue;
    matches.push_back({a, b, feature, Eigen::Vector2d(p.x, p.y), found->in_b});
  }
  return matches;
}

}  // namespace stuv
