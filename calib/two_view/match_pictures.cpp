#include "calib/two_view/match_pictures.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <opencv2/features2d.hpp>
#include <opencv2/imgproc.hpp>

#include "core/parallel.h"

namespace stuv {
namespace {

cv::Mat grey8(const Image& picture) {
  ImageF pixels = grey(picture);
  cv::Mat out;
  cv::Mat(pixels.height, pixels.width, CV_32F, pixels.data.data()).convertTo(out, CV_8U, 255);
  return out;
}

/// The nearest and second nearest of the candidates.
struct Nearest {
  int index = -1;
  float best = std::numeric_limits<float>::infinity(), second = best;
  void take(int i, float distance2) {
    if (distance2 < best) {
      second = best;
      best = distance2;
      index = i;
    } else if (distance2 < second) {
      second = distance2;
    }
  }
  bool clear(double ratio) const { return index >= 0 && best < ratio * ratio * second; }
};

float distance2(const float* a, const float* b, int n) {
  float sum = 0;
  for (int i = 0; i < n; ++i) sum += (a[i] - b[i]) * (a[i] - b[i]);
  return sum;
}

/// For each of a, among those of b.
std::vector<Nearest> nearest(const Features& a, const Features& b) {
  const int n = a.descriptors.height, m = b.descriptors.height, k = a.descriptors.width;
  std::vector<Nearest> result(n);
  // Unit vectors: |a - b|^2 = 2 - 2 a.b, a matrix product block by block.
  using Rows = Eigen::Map<const Eigen::Matrix<float, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>>;
  const Rows A(a.descriptors.data.data(), n, k), B(b.descriptors.data.data(), m, k);
  constexpr int kBlock = 256;
  parallel_for((n + kBlock - 1) / kBlock, [&](int block) {
    const int begin = block * kBlock, rows = std::min(kBlock, n - begin);
    const Eigen::Matrix<float, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor> dots =
        A.middleRows(begin, rows) * B.transpose();
    for (int i = 0; i < rows; ++i)
      for (int j = 0; j < m; ++j) result[begin + i].take(j, std::max(0.0F, 2 - 2 * dots(i, j)));
  });
  return result;
}

/// For each of a, among those of b near its epipolar line.
std::vector<Nearest> nearest_in_band(const Features& a, const Features& b, const Eigen::Matrix3d& F,
                                     double band_px) {
  std::vector<Nearest> result(a.points_px.size());
  parallel_for(static_cast<int>(a.points_px.size()), [&](int i) {
    Eigen::Vector3d l = F * a.points_px[i].homogeneous();
    l /= l.head<2>().norm();
    for (std::size_t j = 0; j < b.points_px.size(); ++j)
      if (std::abs(l.head<2>().dot(b.points_px[j]) + l.z()) < band_px)
        result[i].take(
            static_cast<int>(j),
            distance2(a.descriptors.row(i), b.descriptors.row(static_cast<int>(j)), a.descriptors.width));
  });
  return result;
}

using Pairs = std::vector<std::pair<int, int>>;

Pairs mutual(const std::vector<Nearest>& forth, const std::vector<Nearest>& back, double ratio) {
  Pairs pairs;
  for (int i = 0; i < static_cast<int>(forth.size()); ++i)
    if (forth[i].clear(ratio) && back[forth[i].index].index == i) pairs.emplace_back(i, forth[i].index);
  return pairs;
}

Matches places_of(const Pairs& pairs, const Features& a, const Features& b) {
  Matches matches;
  for (const auto& [i, j] : pairs) matches.push_back({a.points_px[i], b.points_px[j]});
  return matches;
}

constexpr int kRadius = 7;
using Window = Eigen::Matrix<float, (2 * kRadius + 1) * (2 * kRadius + 1), 1>;

/// Window of mean 0 and norm 1; false where it leaves the picture or has no texture.
bool window_at(const cv::Mat& grey, int x, int y, Window& w) {
  if (x < kRadius || y < kRadius || x + kRadius >= grey.cols || y + kRadius >= grey.rows) return false;
  int k = 0;
  for (int dy = -kRadius; dy <= kRadius; ++dy)
    for (int dx = -kRadius; dx <= kRadius; ++dx) w[k++] = grey.at<std::uint8_t>(y + dy, x + dx);
  w.array() -= w.mean();
  const float norm = w.norm();
  if (!(norm > 1e-3F)) return false;
  w /= norm;
  return true;
}

struct Corners {
  std::vector<cv::Point2f> points;
  std::vector<Window> windows;
};

Corners corners_of(const cv::Mat& grey) {
  std::vector<cv::Point2f> found;
  cv::goodFeaturesToTrack(grey, found, 3000, 0.005, 5);
  Corners c;
  Window w;
  for (const cv::Point2f& p : found)
    if (window_at(grey, cvRound(p.x), cvRound(p.y), w)) {
      c.points.push_back(p);
      c.windows.push_back(w);
    }
  return c;
}

/// Index of the best of b within reach, -1 below `least`.
std::vector<int> best_corner(const Corners& a, const Corners& b, double reach, double least) {
  std::vector<int> best(a.points.size(), -1);
  parallel_for(static_cast<int>(a.points.size()), [&](int i) {
    auto highest = static_cast<float>(least);
    for (std::size_t j = 0; j < b.points.size(); ++j) {
      if (cv::norm(a.points[i] - b.points[j]) > reach) continue;
      const float ncc = a.windows[i].dot(b.windows[j]);
      if (ncc > highest) highest = ncc, best[i] = static_cast<int>(j);
    }
  });
  return best;
}

/// Top of the parabola through the correlations at -1, 0, 1.
double parabola_top(double minus, double zero, double plus) {
  const double curvature = minus - 2 * zero + plus;
  return curvature < 0 ? std::clamp(0.5 * (minus - plus) / curvature, -0.5, 0.5) : 0;
}

Eigen::Vector2d subpixel(const cv::Mat& grey, const Window& sought, int x, int y) {
  const auto ncc = [&](int dx, int dy) {
    Window w;
    return window_at(grey, x + dx, y + dy, w) ? double(sought.dot(w)) : 0.0;
  };
  const double here = ncc(0, 0);
  return {x + parabola_top(ncc(-1, 0), here, ncc(1, 0)), y + parabola_top(ncc(0, -1), here, ncc(0, 1))};
}

}  // namespace

ImageF grey(const Image& picture) {
  ImageF pixels = to_float(picture);
  if (pixels.channels == 1) return pixels;
  ImageF out(picture.width, picture.height, 1);
  for (std::size_t i = 0; i < out.data.size(); ++i) {
    const float* p = pixels.data.data() + 3 * i;
    out.data[i] = 0.299F * p[0] + 0.587F * p[1] + 0.114F * p[2];
  }
  return out;
}

Features detect_features(const Image& picture, int most) {
  std::vector<cv::KeyPoint> keypoints;
  cv::Mat descriptors;
  cv::SIFT::create(most)->detectAndCompute(grey8(picture), cv::noArray(), keypoints, descriptors);
  Features f;
  f.descriptors = Raster<float>(128, static_cast<int>(keypoints.size()), 1);
  for (int i = 0; i < static_cast<int>(keypoints.size()); ++i) {
    // OpenCV 4.6 doubles the picture by resize(), which moves x to 2 x + 0.5, and forgets the half.
    f.points_px.emplace_back(keypoints[i].pt.x - 0.25, keypoints[i].pt.y - 0.25);
    const float* from = descriptors.ptr<float>(i);
    float sum = 1e-9F;
    for (int k = 0; k < 128; ++k) sum += from[k];
    for (int k = 0; k < 128; ++k) f.descriptors.row(i)[k] = std::sqrt(from[k] / sum);
  }
  return f;
}

Pairs match_feature_indices(const Features& a, const Features& b, double ratio) {
  return mutual(nearest(a, b), nearest(b, a), ratio);
}

Matches match_features(const Features& a, const Features& b, double ratio) {
  return places_of(match_feature_indices(a, b, ratio), a, b);
}

Matches guided_matches(const Features& a, const Features& b, const Eigen::Matrix3d& F, double band_px,
                       double ratio) {
  return places_of(
      mutual(nearest_in_band(a, b, F, band_px), nearest_in_band(b, a, F.transpose(), band_px), ratio), a, b);
}

namespace {

/// A detector gives one place several features, one an orientation. Their matches are one match: unlike those
/// of a list that says a match twice, they are no second opinion, and are not counted as one.
Matches each_once(const Matches& matches) {
  Matches once;
  for (const int i : distinct_matches(matches)) once.push_back(matches[i]);
  return once;
}

}  // namespace

MatchedPair match_and_estimate(const Features& a, const Features& b, const TwoViewOptions& options) {
  constexpr int kMostRounds = 5;
  MatchedPair found;
  found.matches = each_once(match_features(a, b));
  found.estimate = estimate_two_view(found.matches, options);
  for (int round = 0; round < kMostRounds && found.estimate.status == TwoViewStatus::ok; ++round) {
    const double band_px = std::max(1.5, 3 * found.estimate.ml.noise_px);
    MatchedPair next;
    next.matches = each_once(guided_matches(a, b, found.estimate.ml.F, band_px));
    next.estimate = estimate_two_view(next.matches, options);
    if (next.estimate.status != TwoViewStatus::ok || next.estimate.inliers <= found.estimate.inliers) break;
    found = std::move(next);
  }
  return found;
}

Matches match_corners(const Image& a, const Image& b, double most_motion_px, double least_ncc) {
  const cv::Mat grey_a = grey8(a), grey_b = grey8(b);
  const Corners ca = corners_of(grey_a), cb = corners_of(grey_b);
  const std::vector<int> forth = best_corner(ca, cb, most_motion_px, least_ncc);
  const std::vector<int> back = best_corner(cb, ca, most_motion_px, least_ncc);
  Matches matches;
  for (std::size_t i = 0; i < forth.size(); ++i) {
    if (forth[i] < 0 || back[forth[i]] != static_cast<int>(i)) continue;
    const cv::Point2f &p = ca.points[i], &q = cb.points[forth[i]];
    matches.push_back({Eigen::Vector2d(cvRound(p.x), cvRound(p.y)),
                       subpixel(grey_b, ca.windows[i], cvRound(q.x), cvRound(q.y))});
  }
  return matches;
}

}  // namespace stuv
