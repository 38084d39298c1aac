#include "calib/board/detect_markers.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <opencv2/aruco.hpp>
#include <opencv2/imgproc.hpp>

#include "calib/board/corner_grid.h"
#include "calib/board/markers.h"
#include "calib/board/pattern.h"

namespace stuv {
namespace {

using Box = Eigen::AlignedBox2d;

/// A marker as the detector found it; its corners run clockwise from one that depends on how it is turned.
struct Found {
  int id = 0;
  std::vector<cv::Point2f> corners;
};

cv::Ptr<cv::aruco::DetectorParameters> detector_parameters(const Board& board, const cv::Mat& grey) {
  auto parameters = cv::aruco::DetectorParameters::create();
  parameters->cornerRefinementMethod = cv::aruco::CORNER_REFINE_NONE;
  // Windows from fine to a twentieth of the picture, for small and large cells.
  parameters->adaptiveThreshWinSizeMin = 5;
  parameters->adaptiveThreshWinSizeMax = std::max(25, std::max(grey.cols, grey.rows) / 20) | 1;
  parameters->adaptiveThreshWinSizeStep = std::max(10, (parameters->adaptiveThreshWinSizeMax - 5) / 3);
  parameters->minMarkerPerimeterRate = 40.0 / std::max(grey.cols, grey.rows);
  if (board.kind == Board::Kind::aprilgrid) {
    // Tags touch the small squares at their corners: contours run on into these, lines fitted to edges do
    // not.
    parameters->cornerRefinementMethod = cv::aruco::CORNER_REFINE_APRILTAG;
    parameters->markerBorderBits = kAprilGridBorder;
  }
  return parameters;
}

std::vector<Found> find_markers(const cv::Mat& grey, const Board& board, int markers) {
  const bool tags = board.kind == Board::Kind::aprilgrid;
  const int index = dictionary_index(tags ? kAprilGridDictionary : board.dictionary);
  std::vector<std::vector<cv::Point2f>> corners;
  std::vector<int> ids;
  cv::aruco::detectMarkers(grey, cv::aruco::getPredefinedDictionary(index), corners, ids,
                           detector_parameters(board, grey));
  std::vector<Found> found;
  for (std::size_t i = 0; i < ids.size(); ++i)
    // A number seen twice is a mistake or another board: neither is used.
    if (ids[i] < markers && std::count(ids.begin(), ids.end(), ids[i]) == 1)
      found.push_back({ids[i], corners[i]});
  std::sort(found.begin(), found.end(), [](const Found& a, const Found& b) { return a.id < b.id; });
  return found;
}

/// pixel_from_board around one marker, whose corners are counted from its `turn`-th.
Eigen::Matrix3d homography(const Found& marker, const Box& box, int turn) {
  const Eigen::Vector2d a = box.min(), b = box.max();
  const std::array<cv::Point2f, 4> upright = {
      cv::Point2f(float(a.x()), float(a.y())), cv::Point2f(float(b.x()), float(a.y())),
      cv::Point2f(float(b.x()), float(b.y())), cv::Point2f(float(a.x()), float(b.y()))};
  std::array<cv::Point2f, 4> seen;
  for (int k = 0; k < 4; ++k) seen[k] = marker.corners[static_cast<std::size_t>((k + turn) % 4)];
  const cv::Mat H = cv::getPerspectiveTransform(upright.data(), seen.data());
  Eigen::Matrix3d result;
  for (int r = 0; r < 3; ++r)
    for (int c = 0; c < 3; ++c) result(r, c) = H.at<double>(r, c);
  return result;
}

Eigen::Vector2d middle_of(const Found& marker) {
  Eigen::Vector2d sum = Eigen::Vector2d::Zero();
  for (const cv::Point2f& c : marker.corners) sum += 0.25 * Eigen::Vector2d(c.x, c.y);
  return sum;
}

/// How the markers are turned in their squares: the way in which each predicts the nearest other one best. A
/// marker alone is as we print it.
int common_turn(const std::vector<Found>& found, const std::vector<Box>& boxes, const Board& board) {
  if (found.size() < 2) return board.kind == Board::Kind::aprilgrid ? 2 : 0;
  std::array<double, 4> error = {};
  for (const Found& a : found) {
    const auto distance = [&](const Found& b) {
      return &a == &b ? std::numeric_limits<double>::infinity()
                      : (boxes[a.id].center() - boxes[b.id].center()).norm();
    };
    const Found& b = *std::min_element(found.begin(), found.end(), [&](const Found& p, const Found& q) {
      return distance(p) < distance(q);
    });
    const double size = (middle_of(a) - middle_of(b)).norm();
    for (int turn = 0; turn < 4; ++turn) {
      const Eigen::Vector2d predicted =
          (homography(a, boxes[a.id], turn) * boxes[b.id].center().homogeneous()).hnormalized();
      // A wild marker must not decide.
      error[turn] += std::min(1.0, (predicted - middle_of(b)).norm() / size);
    }
  }
  return static_cast<int>(std::min_element(error.begin(), error.end()) - error.begin());
}

/// Markers that the others do not predict are other things that look like one.
void drop_misplaced(const std::vector<Box>& boxes, int turn, std::vector<Found>& found) {
  if (found.size() < 3) return;
  std::vector<Found> good;
  for (const Found& a : found) {
    int votes = 0, voters = 0;
    for (const Found& b : found) {
      if (&a == &b) continue;
      const Eigen::Vector2d there =
          (homography(b, boxes[b.id], turn) * boxes[a.id].center().homogeneous()).hnormalized();
      const double distance = (middle_of(a) - middle_of(b)).norm();
      votes += (there - middle_of(a)).norm() < 0.25 * distance ? 1 : 0;
      ++voters;
    }
    if (2 * votes >= voters) good.push_back(a);
  }
  found = std::move(good);
}

struct Candidate {
  int point = 0;
  Eigen::Vector2d at_px;
  double contrast = 0;
};

/// One corner, from the homography H of the marker nearest to it.
std::optional<Candidate> refine_point(const CornerImage& image, const Board& board, int point,
                                      const Eigen::Vector2d& p, const Eigen::Matrix3d& H) {
  const double clear_m = corner_clearance_m(board);
  const auto pixel = [&](double dx, double dy) {
    return (H * (p + clear_m * Eigen::Vector2d(dx, dy)).homogeneous()).hnormalized().eval();
  };
  const Eigen::Vector2d start = pixel(0, 0), step_x = 0.5 * (pixel(1, 0) - pixel(-1, 0)),
                        step_y = 0.5 * (pixel(0, 1) - pixel(0, -1));
  // Half of the clearance for blur and for the prediction's error.
  const double height =
      std::abs(step_x.x() * step_y.y() - step_x.y() * step_y.x()) / std::max(step_x.norm(), step_y.norm());
  constexpr double kLeastPx = 2, kMostPx = 10, kShare = 0.8;
  if (!(height > 1) || !start.allFinite()) return std::nullopt;
  const double radius = std::clamp(kShare * height, kLeastPx, kMostPx);
  const auto corner = refine_corner(image, start, radius, std::max(1.5, 0.6 * height));
  if (!corner) return std::nullopt;
  const double contrast = square_contrast(image, corner->at_px, 1.5 * step_x, 1.5 * step_y,
                                          dark_towards_origin_and_away(board, point));
  if (!(contrast > 0)) return std::nullopt;
  return Candidate{point, corner->at_px, contrast};
}

/// Corners no farther from a found marker's middle than this many times its size are looked for.
constexpr double kReach = 1.6;

std::vector<Candidate> candidates(const CornerImage& image, const Board& board,
                                  const std::vector<Found>& found, const std::vector<Box>& boxes, int turn) {
  std::vector<Eigen::Matrix3d> H;
  for (const Found& marker : found) H.push_back(homography(marker, boxes[marker.id], turn));
  const std::vector<Eigen::Vector3d> points = board_points(board);
  std::vector<Candidate> result;
  for (int i = 0; i < board.corners(); ++i) {
    if (!board.has_corner(i)) continue;
    const Eigen::Vector2d p = points[static_cast<std::size_t>(i)].head<2>();
    std::size_t nearest = 0;
    double distance = std::numeric_limits<double>::infinity();
    for (std::size_t k = 0; k < found.size(); ++k) {
      const double d = (boxes[found[k].id].center() - p).norm();
      if (d < distance) distance = d, nearest = k;
    }
    if (!(distance < kReach * boxes[found[nearest].id].sizes().x())) continue;
    if (auto c = refine_point(image, board, i, p, H[nearest])) result.push_back(*c);
  }
  return result;
}

}  // namespace

std::vector<Eigen::Vector2d> detect_markers(const CornerImage& image, const Board& board) {
  const std::vector<Box> boxes = marker_boxes(board);
  std::vector<Found> found = find_markers(image.grey, board, static_cast<int>(boxes.size()));
  if (found.empty()) return {};
  const int turn = common_turn(found, boxes, board);
  drop_misplaced(boxes, turn, found);
  const std::vector<Candidate> corners = candidates(image, board, found, boxes, turn);
  if (corners.empty()) return {};
  std::vector<double> contrast;
  for (const Candidate& c : corners) contrast.push_back(c.contrast);
  std::nth_element(contrast.begin(), contrast.begin() + static_cast<long>(contrast.size() / 2),
                   contrast.end());
  const double least = contrast[contrast.size() / 2] / 3;
  constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
  std::vector<Eigen::Vector2d> result(static_cast<std::size_t>(board.corners()), {kNaN, kNaN});
  for (const Candidate& c : corners)
    if (c.contrast >= least) result[static_cast<std::size_t>(c.point)] = c.at_px;
  return result;
}

}  // namespace stuv
