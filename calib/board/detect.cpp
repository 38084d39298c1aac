#include "calib/board/detect.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <opencv2/imgproc.hpp>

#include "calib/board/corner_grid.h"
#include "calib/board/detect_chessboard.h"
#include "calib/board/detect_markers.h"
#include "calib/board/pattern.h"
#include "calib/board/refine.h"

namespace stuv {
namespace {

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();

/// Luma in 0..255, stretched where the picture is dark: detectors' thresholds are in grey levels.
cv::Mat luma_of(const Image& picture) {
  const ImageF pixels = to_float(picture);
  cv::Mat luma(picture.height, picture.width, CV_32F);
  for (int y = 0; y < picture.height; ++y) {
    auto* out = luma.ptr<float>(y);
    for (int x = 0; x < picture.width; ++x) {
      const float* p = &pixels.at(x, y);
      const float value = pixels.channels == 3 ? 0.299F * p[0] + 0.587F * p[1] + 0.114F * p[2] : p[0];
      out[x] = 255 * std::clamp(value, 0.0F, 1.0F);
    }
  }
  std::vector<float> sample;
  for (int y = 0; y < luma.rows; y += 4)
    for (int x = 0; x < luma.cols; x += 4) sample.push_back(luma.at<float>(y, x));
  const auto bright = sample.begin() + static_cast<long>(0.98 * static_cast<double>(sample.size()));
  std::nth_element(sample.begin(), bright, sample.end());
  constexpr float kDark = 100, kStretched = 200, kLeast = 2;
  if (*bright < kDark) luma = cv::min(luma * (kStretched / std::max(*bright, kLeast)), 255);
  return luma;
}

CornerImage corner_image(const Image& picture, const Board& board) {
  CornerImage image;
  image.luma = luma_of(picture);
  if (board.inverted) image.luma = 255 - image.luma;
  image.luma.convertTo(image.grey, CV_8U);
  const cv::Mat difference = (cv::Mat_<float>(1, 3) << -0.5F, 0, 0.5F);
  cv::filter2D(image.luma, image.gradient_x, CV_32F, difference);
  cv::filter2D(image.luma, image.gradient_y, CV_32F, difference.t());
  return image;
}

bool inside(const Eigen::Vector2d& q, const CornerImage& image) {
  return q.x() >= 0 && q.y() >= 0 && q.x() <= image.luma.cols - 1 && q.y() <= image.luma.rows - 1;
}

/// Enough corners for a pose, in two directions of the lattice.
bool usable(const std::vector<Eigen::Vector2d>& corners, const Board& board) {
  constexpr int kLeastCorners = 6;
  int count = 0;
  Eigen::AlignedBox2i extent;
  for (int i = 0; i < static_cast<int>(corners.size()); ++i) {
    if (!corners[i].allFinite()) continue;
    extent.extend(Eigen::Vector2i(i % board.columns, i / board.columns));
    ++count;
  }
  return count >= kLeastCorners && extent.sizes().minCoeff() >= 1;
}

/// Radius of refine_corner's window at a corner of the view, from the corners near it.
double radius_at(const std::vector<Eigen::Vector2d>& corners, const Board& board, int point) {
  // Pixels per metre along both directions of the lattice, by the nearest corners in the same row and column.
  const auto step = [&](int dx, int dy) -> Eigen::Vector2d {
    for (int k = 1; k < std::max(board.columns, board.rows); ++k)
      for (const int side : {k, -k}) {
        const int x = point % board.columns + side * dx, y = point / board.columns + side * dy;
        if (x < 0 || y < 0 || x >= board.columns || y >= board.rows) continue;
        const Eigen::Vector2d& other = corners[static_cast<std::size_t>(y * board.columns + x)];
        if (other.allFinite())
          return (other - corners[static_cast<std::size_t>(point)]) / (side * board.square_m);
      }
    return Eigen::Vector2d::Zero();
  };
  const double clear_m = corner_clearance_m(board);
  const Eigen::Vector2d a = clear_m * step(1, 0), b = clear_m * step(0, 1);
  if (a.isZero() || b.isZero()) return 3;
  return window_radius(a, b, board.kind == Board::Kind::chessboard ? kSquareShare : kClearanceShare);
}

cv::Rect around(const std::vector<Eigen::Vector2d>& corners) {
  Eigen::AlignedBox2d box;
  for (const Eigen::Vector2d& q : corners)
    if (q.allFinite()) box.extend(q);
  const Eigen::Vector2d size = box.sizes();
  return {static_cast<int>(box.min().x()), static_cast<int>(box.min().y()), static_cast<int>(size.x()) + 1,
          static_cast<int>(size.y()) + 1};
}

/// `grown`: of each corner, or empty.
std::vector<double> deviations(const CornerImage& image, const std::vector<Eigen::Vector2d>& corners,
                               const std::vector<bool>& grown, const Board& board) {
  const double noise = picture_noise(image, around(corners));
  std::vector<double> sigma(corners.size(), kNaN);
  for (std::size_t i = 0; i < corners.size(); ++i) {
    if (!corners[i].allFinite()) continue;
    double radius = radius_at(corners, board, static_cast<int>(i));
    auto covariance = corner_covariance(image, corners[i], radius, noise);
    // At the picture's border only a smaller window has room.
    for (; !covariance && radius > 1; radius /= 1.5)
      covariance = corner_covariance(image, corners[i], radius, noise);
    constexpr double kUnknownPx = 0.5;
    const double random = covariance ? std::sqrt(0.5 * covariance->trace()) : kUnknownPx;
    sigma[i] = std::hypot(!grown.empty() && grown[i] ? kGrownFloorPx : kCornerFloorPx, random);
  }
  return sigma;
}

}  // namespace

int BoardView::seen() const {
  return static_cast<int>(std::count_if(corners_px.begin(), corners_px.end(),
                                        [](const Eigen::Vector2d& q) { return q.allFinite(); }));
}

BoardView detect_board(const Image& picture, const Board& board) {
  const CornerImage image = corner_image(picture, board);
  BoardView view;
  std::vector<bool> grown;
  if (board.kind == Board::Kind::chessboard) {
    Chessboard found = detect_chessboard(image, board);
    view.corners_px = std::move(found.corners_px);
    grown = std::move(found.grown);
  } else {
    view.corners_px = detect_markers(image, board);
  }
  for (Eigen::Vector2d& q : view.corners_px)
    if (!inside(q, image)) q.setConstant(kNaN);
  if (!usable(view.corners_px, board)) return {};
  view.sigma_px = deviations(image, view.corners_px, grown, board);
  return view;
}

}  // namespace stuv
