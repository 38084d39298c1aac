#include "calib/two_view/draw.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <opencv2/imgproc.hpp>

namespace stuv {
namespace {

/// RGB in OpenCV's hands; what is missing is black.
cv::Mat canvas(const Image& picture) {
  const ImageF pixels = to_float(picture);
  cv::Mat out(picture.height, picture.width, CV_8UC3);
  for (int y = 0; y < picture.height; ++y)
    for (int x = 0; x < picture.width; ++x)
      for (int c = 0; c < 3; ++c)
        out.at<cv::Vec3b>(y, x)[c] =
            cv::saturate_cast<std::uint8_t>(255 * pixels.at(x, y, pixels.channels == 3 ? c : 0));
  return out;
}

Image image_of(const cv::Mat& rgb) {
  Image out;
  out.width = rgb.cols;
  out.height = rgb.rows;
  out.channels = 3;
  out.bytes.resize(static_cast<std::size_t>(3) * rgb.cols * rgb.rows);
  for (int y = 0; y < rgb.rows; ++y)
    std::memcpy(out.bytes.data() + static_cast<std::size_t>(3) * rgb.cols * y, rgb.ptr(y),
                static_cast<std::size_t>(3) * rgb.cols);
  return out;
}

cv::Mat beside(const cv::Mat& a, const cv::Mat& b) {
  cv::Mat out(std::max(a.rows, b.rows), a.cols + b.cols, CV_8UC3, cv::Scalar::all(0));
  a.copyTo(out(cv::Rect(0, 0, a.cols, a.rows)));
  b.copyTo(out(cv::Rect(a.cols, 0, b.cols, b.rows)));
  return out;
}

cv::Point pixel(const Eigen::Vector2d& p, int shift_x = 0) {
  return {static_cast<int>(std::lround(p.x())) + shift_x, static_cast<int>(std::lround(p.y()))};
}

cv::Scalar colour_of(int i, int n) {
  cv::Mat hsv(1, 1, CV_8UC3, cv::Scalar(180.0 * i / std::max(1, n), 220, 255)), rgb;
  cv::cvtColor(hsv, rgb, cv::COLOR_HSV2RGB);
  const auto c = rgb.at<cv::Vec3b>(0, 0);
  return {double(c[0]), double(c[1]), double(c[2])};
}

/// The part of the line l . x = 0 inside the picture.
void draw_line(cv::Mat& picture, const Eigen::Vector3d& l, const cv::Scalar& colour, int thickness) {
  const double n = l.head<2>().norm();
  if (!(n > 0)) return;
  const Eigen::Vector2d middle(0.5 * picture.cols, 0.5 * picture.rows);
  const Eigen::Vector2d foot = middle - (l.head<2>().dot(middle) + l.z()) / (n * n) * l.head<2>();
  const double reach = picture.cols + picture.rows;
  if ((foot - middle).norm() > reach) return;
  const Eigen::Vector2d along = Eigen::Vector2d(-l.y(), l.x()) / n * reach;
  cv::line(picture, pixel(foot - along), pixel(foot + along), colour, thickness, cv::LINE_AA);
}

/// Both branches of the envelope x^T C* x = 0, C* the dual of the conic that line_envelope gives, column by
/// column along the line.
void draw_envelope(cv::Mat& picture, const Eigen::Matrix3d& F, const Eigen::Matrix<double, 9, 9>& covariance,
                   const Eigen::Vector2d& a, const cv::Scalar& colour) {
  const Eigen::Vector3d l = F * a.homogeneous();
  const double n = l.head<2>().norm();
  const Eigen::Vector2d normal = l.head<2>() / n, along(-normal.y(), normal.x());
  const Eigen::Vector2d middle(0.5 * picture.cols, 0.5 * picture.rows);
  const Eigen::Vector2d foot = middle - (normal.dot(middle) + l.z() / n) * normal;
  for (const double side : {-2.0, 2.0}) {
    std::vector<cv::Point> branch;
    const int reach = picture.cols + picture.rows;
    for (int s = -reach; s <= reach; s += 10) {
      const Eigen::Vector2d p = foot + s * along;
      const double sigma = line_sigma(F, covariance, a, p);
      if (sigma < reach) branch.push_back(pixel(p + side * sigma * normal));
    }
    cv::polylines(picture, branch, false, colour, 1, cv::LINE_AA);
  }
}

}  // namespace

Image draw_matches(const Image& a, const Image& b, const Matches& matches, const std::vector<bool>& inlier) {
  cv::Mat out = beside(canvas(a), canvas(b));
  for (const bool good : {false, true}) {
    cv::Mat layer = out.clone();
    for (std::size_t i = 0; i < matches.size(); ++i) {
      if (inlier[i] != good || !matches[i].a.allFinite() || !matches[i].b.allFinite()) continue;
      const cv::Scalar colour = good ? cv::Scalar(40, 230, 60) : cv::Scalar(230, 60, 40);
      cv::line(layer, pixel(matches[i].a), pixel(matches[i].b, a.width), colour, 1, cv::LINE_AA);
      cv::circle(layer, pixel(matches[i].a), 3, colour, 1, cv::LINE_AA);
      cv::circle(layer, pixel(matches[i].b, a.width), 3, colour, 1, cv::LINE_AA);
    }
    cv::addWeighted(layer, good ? 0.7 : 0.35, out, good ? 0.3 : 0.65, 0, out);
  }
  return image_of(out);
}

Image draw_epipolar_lines(const Image& a, const Image& b, const Matches& matches, const TwoViewEstimate& e) {
  constexpr std::size_t kLines = 20;
  cv::Mat left = canvas(a), right = canvas(b);
  std::vector<int> shown;
  for (std::size_t i = 0; i < matches.size(); ++i)
    if (e.inlier[i]) shown.push_back(static_cast<int>(i));
  std::sort(shown.begin(), shown.end(), [&](int i, int j) { return matches[i].a.y() < matches[j].a.y(); });
  const std::size_t n = std::min(kLines, shown.size());
  const Eigen::Matrix<double, 9, 9> covariance = std::pow(e.ml.noise_px, 2) * e.ml.covariance;
  for (std::size_t k = 0; k < n; ++k) {
    const Match& m = matches[shown[k * shown.size() / n]];
    const cv::Scalar colour = colour_of(static_cast<int>(k), static_cast<int>(n));
    draw_envelope(right, e.ml.F, covariance, m.a, cv::Scalar(255, 255, 255));
    draw_line(left, e.ml.F.transpose() * m.b.homogeneous(), colour, 1);
    draw_line(right, e.ml.F * m.a.homogeneous(), colour, 1);
    cv::circle(left, pixel(m.a), 4, colour, 2, cv::LINE_AA);
    cv::circle(right, pixel(m.b), 4, colour, 2, cv::LINE_AA);
  }
  return image_of(beside(left, right));
}

Image side_by_side(const Image& a, const Image& b, bool rulers) {
  cv::Mat out = beside(canvas(a), canvas(b));
  for (int y = 20; rulers && y < out.rows; y += 40)
    cv::line(out, {0, y}, {out.cols, y}, cv::Scalar(255, 220, 0), 1);
  return image_of(out);
}

Image draw_disparity(const ImageF& disparity) {
  std::vector<float> known;
  for (const float d : disparity.data)
    if (std::isfinite(d)) known.push_back(d);
  if (known.empty()) known.push_back(0);
  std::sort(known.begin(), known.end());
  const float low = known[known.size() / 50], high = known[known.size() - 1 - known.size() / 50];
  const float scale = 255 / std::max(1e-3F, high - low);
  cv::Mat grey(disparity.height, disparity.width, CV_8U), bgr, rgb;
  for (int y = 0; y < grey.rows; ++y)
    for (int x = 0; x < grey.cols; ++x) {
      const float d = disparity.at(x, y);
      grey.at<std::uint8_t>(y, x) = std::isfinite(d) ? cv::saturate_cast<std::uint8_t>(scale * (d - low)) : 0;
    }
  cv::applyColorMap(grey, bgr, cv::COLORMAP_TURBO);
  cv::cvtColor(bgr, rgb, cv::COLOR_BGR2RGB);
  for (int y = 0; y < grey.rows; ++y)
    for (int x = 0; x < grey.cols; ++x)
      if (!std::isfinite(disparity.at(x, y))) rgb.at<cv::Vec3b>(y, x) = {0, 0, 0};
  return image_of(rgb);
}

}  // namespace stuv
