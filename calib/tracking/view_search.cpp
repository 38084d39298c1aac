#include "calib/tracking/view_search.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <opencv2/imgproc.hpp>

namespace stuv::tracking {
namespace {

constexpr double kTemplate_px = 28;
constexpr int kPeaksPerTemplate = 3, kLeastPixels = 60;
constexpr std::array<double, 5> kScales = {0.7, 0.84, 1.0, 1.19, 1.41};
constexpr std::array<double, 3> kTurns = {-0.35, 0.0, 0.35};

cv::Mat mat_of(const Grey& grey) {
  return {grey.height, grey.width, CV_8U, const_cast<std::uint8_t*>(grey.data.data())};
}

/// The object alone as a taught view shows it.
struct ViewPicture {
  cv::Mat grey, mask;      ///< of the object's box
  Eigen::Vector2d middle;  ///< of the box [px of the picture]
  double shrink = 1;       ///< pixels of the picture to one of the template at scale 1
};

ViewPicture picture_of(const TexturedView& view) {
  ViewPicture out;
  const DepthPatch& patch = view.depth;
  if (patch.depth.empty()) return out;
  const cv::Rect box(patch.x0, patch.y0, patch.depth.width, patch.depth.height);
  out.grey = mat_of(view.picture)(box);
  out.mask = cv::Mat(box.size(), CV_8U, cv::Scalar(0));
  for (int y = 0; y < box.height; ++y)
    for (int x = 0; x < box.width; ++x)
      if (std::isfinite(patch.depth.at(x, y))) out.mask.at<std::uint8_t>(y, x) = 255;
  out.middle = {box.x + 0.5 * (box.width - 1), box.y + 0.5 * (box.height - 1)};
  out.shrink = std::max(1.0, std::max(box.width, box.height) / kTemplate_px);
  return out;
}

struct Template {
  cv::Mat grey, mask;
  double scale = 1, turn = 0;
};

/// The view turned and scaled about its middle, in the middle of a square template.
Template template_of(const ViewPicture& view, double scale, double turn) {
  const double by = scale / view.shrink;
  const double width =
      by * (view.grey.cols * std::abs(std::cos(turn)) + view.grey.rows * std::abs(std::sin(turn)));
  const double height =
      by * (view.grey.rows * std::abs(std::cos(turn)) + view.grey.cols * std::abs(std::sin(turn)));
  const cv::Size size(std::max(3, static_cast<int>(std::ceil(width))),
                      std::max(3, static_cast<int>(std::ceil(height))));
  // x right, y down: a positive turn is clockwise, as a turn about the camera's z axis is.
  const double c = by * std::cos(turn), s = by * std::sin(turn);
  const double mx = 0.5 * (view.grey.cols - 1), my = 0.5 * (view.grey.rows - 1);
  const cv::Matx23d to(c, -s, 0.5 * (size.width - 1) - c * mx + s * my, s, c,
                       0.5 * (size.height - 1) - s * mx - c * my);
  Template out{{}, {}, scale, turn};
  cv::Mat soft;
  const double blur = 0.5 / by;
  if (blur > 0.6)
    cv::GaussianBlur(view.grey, soft, {}, blur);
  else
    soft = view.grey;
  cv::warpAffine(soft, out.grey, to, size, cv::INTER_LINEAR, cv::BORDER_REPLICATE);
  cv::warpAffine(view.mask, out.mask, to, size, cv::INTER_NEAREST, cv::BORDER_CONSTANT, cv::Scalar(0));
  return out;
}

struct Peak {
  Eigen::Vector2d at;  ///< of the template's middle [px of the small frame]
  double correlation = 0;
};

std::vector<Peak> peaks_of(const cv::Mat& frame, const Template& t, double least) {
  std::vector<Peak> peaks;
  if (t.grey.cols > frame.cols || t.grey.rows > frame.rows || cv::countNonZero(t.mask) < kLeastPixels)
    return peaks;
  cv::Mat score, mask;
  t.mask.convertTo(mask, CV_8U);
  cv::matchTemplate(frame, t.grey, score, cv::TM_CCOEFF_NORMED, mask);
  // Flat places have no correlation: whatever comes out of 0 / 0 there.
  score.setTo(-1, score != score);
  score.setTo(-1, score > 1.001);
  for (int k = 0; k < kPeaksPerTemplate; ++k) {
    double best = 0;
    cv::Point at;
    cv::minMaxLoc(score, nullptr, &best, nullptr, &at);
    if (best < least) break;
    peaks.push_back({{at.x + 0.5 * (t.grey.cols - 1), at.y + 0.5 * (t.grey.rows - 1)}, best});
    cv::circle(score, at, 4, cv::Scalar(-1), cv::FILLED);
  }
  return peaks;
}

Eigen::Vector3d ray_at(const ImageF& rays, const Eigen::Vector2d& q) {
  const int x = std::clamp(static_cast<int>(std::lround(q.x())), 0, rays.width - 1);
  const int y = std::clamp(static_cast<int>(std::lround(q.y())), 0, rays.height - 1);
  return {rays.at(x, y, 0), rays.at(x, y, 1), 1};
}

/// The pose that looks like `view`, its middle seen at `at` instead, turned and scaled.
Pose pose_at(const Pose& view, const Eigen::Vector3d& from, const Eigen::Vector3d& to, double scale,
             double turn) {
  // The origin moves as the rays do, nearer by the scale.
  const Eigen::Matrix3d D = Eigen::Quaterniond::FromTwoVectors(from, to).toRotationMatrix() *
                            Eigen::AngleAxisd(turn, from.normalized()).toRotationMatrix();
  return {D * view.R, D * view.t / scale};
}

}  // namespace

std::vector<ViewMatch> search_views(const std::vector<TexturedView>& views, const Grey& frame,
                                    const ImageF& rays, int most, double least) {
  std::vector<ViewMatch> found;
  for (const TexturedView& view : views) {
    const ViewPicture picture = picture_of(view);
    if (picture.grey.empty()) continue;
    cv::Mat small;
    cv::resize(mat_of(frame), small, {}, 1 / picture.shrink, 1 / picture.shrink, cv::INTER_AREA);
    const double fx = double(frame.width) / small.cols, fy = double(frame.height) / small.rows;
    for (const double scale : kScales)
      for (const double turn : kTurns)
        for (const Peak& p : peaks_of(small, template_of(picture, scale, turn), least)) {
          const Eigen::Vector2d q((p.at.x() + 0.5) * fx - 0.5, (p.at.y() + 0.5) * fy - 0.5);
          found.push_back(
              {pose_at(view.cam_from_object, ray_at(rays, picture.middle), ray_at(rays, q), scale, turn),
               p.correlation});
        }
  }
  std::sort(found.begin(), found.end(),
            [](const auto& a, const auto& b) { return a.correlation > b.correlation; });
  std::vector<ViewMatch> best;
  for (const ViewMatch& m : found) {
    if (static_cast<int>(best.size()) == most) break;
    const bool is_known = std::any_of(best.begin(), best.end(), [&](const ViewMatch& other) {
      const double z = m.cam_from_object.t.norm();
      return (m.cam_from_object.t - other.cam_from_object.t).norm() < 0.1 * z &&
             (m.cam_from_object.R - other.cam_from_object.R).norm() < 0.3;
    });
    if (!is_known) best.push_back(m);
  }
  return best;
}

}  // namespace stuv::tracking
