#include "calib/board/detect.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <opencv2/imgproc.hpp>

#include "calib/board/detect_chessboard.h"
#include "calib/board/detect_markers.h"
#include "calib/board/refine.h"
#include "calib/board/symmetric_corner.h"
#include "core/median.h"

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
  const float bright = value_of_rank(std::move(sample), 0.98);
  constexpr float kDark = 100, kStretched = 200, kLeast = 2;
  if (bright < kDark) luma = cv::min(luma * (kStretched / std::max(bright, kLeast)), 255);
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

}  // namespace

int BoardView::seen() const {
  return static_cast<int>(std::count_if(corners_px.begin(), corners_px.end(),
                                        [](const Eigen::Vector2d& q) { return q.allFinite(); }));
}

BoardView detect_board(const Image& picture, const Board& board) {
  const CornerImage image = corner_image(picture, board);
  BoardView view;
  view.corners_px =
      board.kind == Board::Kind::chessboard ? detect_chessboard(image, board) : detect_markers(image, board);
  if (!usable(view.corners_px, board)) return {};
  view.sigma_px = refine_all_by_symmetry(image.luma, board, view.corners_px);
  for (std::size_t i = 0; i < view.corners_px.size(); ++i) {
    if (!inside(view.corners_px[i], image)) view.corners_px[i].setConstant(kNaN);
    view.sigma_px[i] = view.corners_px[i].allFinite() ? std::hypot(kCornerFloorPx, view.sigma_px[i]) : kNaN;
  }
  if (!usable(view.corners_px, board)) return {};
  return view;
}

}  // namespace stuv
