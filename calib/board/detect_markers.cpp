#include "calib/board/detect_markers.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <map>
#include <opencv2/aruco.hpp>
#include <opencv2/calib3d.hpp>
#include <opencv2/imgproc.hpp>
#include <optional>

#include "calib/board/corner_grid.h"
#include "calib/board/markers.h"
#include "calib/board/pattern.h"
#include "core/median.h"

namespace stuv {
namespace {

using Box = Eigen::AlignedBox2d;

/// Radius of refine_corner's window in parts of the clearance around a corner.
constexpr double kClearanceShare = 0.8;

/// A marker as the detector found it; its corners run clockwise from one that depends on how it is turned.
struct Found {
  int id = 0;
  std::vector<cv::Point2f> corners;
};

cv::Ptr<cv::aruco::DetectorParameters> detector_parameters(const Board& board, const cv::Mat& grey) {
  auto parameters = cv::aruco::DetectorParameters::create();
  const int side = std::max(grey.cols, grey.rows);
  parameters->cornerRefinementMethod = cv::aruco::CORNER_REFINE_NONE;
  // Windows from fine to a twentieth of the picture, for small and large cells.
  parameters->adaptiveThreshWinSizeMin = 5;
  parameters->adaptiveThreshWinSizeMax = std::max(25, side / 20) | 1;
  parameters->adaptiveThreshWinSizeStep = std::max(10, (parameters->adaptiveThreshWinSizeMax - 5) / 3);
  constexpr double kLeastPerimeterPx = 40;
  parameters->minMarkerPerimeterRate = kLeastPerimeterPx / side;
  // Twice OpenCV's, for cells that are blurred: codes are checked, so that mistakes stay rare.
  parameters->perspectiveRemovePixelPerCell = 8;
  if (board.kind == Board::Kind::aprilgrid) parameters->markerBorderBits = kAprilGridBorder;
  return parameters;
}

/// Adds the markers that are found in the picture enlarged `scale` times and are not there yet.
void add_markers(const cv::Mat& grey, const Board& board, int markers, int scale, std::vector<Found>& found) {
  cv::Mat enlarged = grey;
  if (scale > 1) cv::resize(grey, enlarged, {}, scale, scale, cv::INTER_CUBIC);
  const bool tags = board.kind == Board::Kind::aprilgrid;
  const int index = dictionary_index(tags ? kAprilGridDictionary : board.dictionary);
  std::vector<std::vector<cv::Point2f>> corners;
  std::vector<int> ids;
  cv::aruco::detectMarkers(enlarged, cv::aruco::getPredefinedDictionary(index), corners, ids,
                           detector_parameters(board, enlarged));
  // Pixel centres: the enlarged picture's first lies (scale - 1) / 2 of its pixels before the picture's.
  const auto shift = 0.5F * static_cast<float>(scale - 1), size = static_cast<float>(scale);
  for (auto& marker : corners)
    for (cv::Point2f& c : marker) c = {(c.x - shift) / size, (c.y - shift) / size};
  const std::size_t before = found.size();
  for (std::size_t i = 0; i < ids.size(); ++i) {
    // A number seen twice is a mistake or another board: neither is used.
    if (ids[i] >= markers || std::count(ids.begin(), ids.end(), ids[i]) != 1) continue;
    const auto known = [&](const Found& f) { return f.id == ids[i]; };
    if (std::none_of(found.begin(), found.begin() + static_cast<long>(before), known))
      found.push_back({ids[i], corners[i]});
  }
}

/// In the picture as it is and, if some are missing, twice as large, for small cells.
std::vector<Found> find_markers(const cv::Mat& grey, const Board& board, int markers) {
  constexpr int kMostEnlargedPx = 8000;
  std::vector<Found> found;
  add_markers(grey, board, markers, 1, found);
  if (static_cast<int>(found.size()) < markers && 2 * std::max(grey.cols, grey.rows) <= kMostEnlargedPx)
    add_markers(grey, board, markers, 2, found);
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

/// Markers that the nearest others do not predict are other things that look like one, or the board is
/// another one.
std::size_t drop_misplaced(const std::vector<Box>& boxes, int turn, std::vector<Found>& found) {
  constexpr std::size_t kVoters = 4;
  constexpr double kTolerance = 0.25;  // of the distance: boxes of another layout lie a square apart
  if (found.size() < 3) return 0;
  std::vector<Found> good;
  for (const Found& a : found) {
    std::vector<std::pair<double, const Found*>> others;
    for (const Found& b : found)
      if (&a != &b) others.emplace_back((boxes[a.id].center() - boxes[b.id].center()).norm(), &b);
    std::sort(others.begin(), others.end());
    others.resize(std::min(others.size(), kVoters));
    const auto votes = std::count_if(others.begin(), others.end(), [&](const auto& other) {
      const Found& b = *other.second;
      const Eigen::Vector2d there =
          (homography(b, boxes[b.id], turn) * boxes[a.id].center().homogeneous()).hnormalized();
      return (there - middle_of(a)).norm() < kTolerance * (middle_of(a) - middle_of(b)).norm();
    });
    if (2 * votes >= static_cast<long>(others.size())) good.push_back(a);
  }
  const std::size_t dropped = found.size() - good.size();
  found = std::move(good);
  return dropped;
}

struct Candidate {
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
  const double height =
      std::abs(step_x.x() * step_y.y() - step_x.y() * step_y.x()) / std::max(step_x.norm(), step_y.norm());
  if (!(height > 1) || !start.allFinite()) return std::nullopt;
  const double radius = window_radius(step_x, step_y, kClearanceShare);
  const auto corner = refine_corner(image, start, radius, std::max(1.5, 0.6 * height));
  if (!corner) return std::nullopt;
  const double contrast =
      square_contrast(image, *corner, 1.5 * step_x, 1.5 * step_y, dark_towards_origin_and_away(board, point));
  if (!(contrast > 0)) return std::nullopt;
  return Candidate{*corner, contrast};
}

/// Corners found so far, by their point.
using Corners = std::map<int, Candidate>;

/// Corners around the markers: no farther from one's middle than `kReach` times its size.
Corners corners_by_markers(const CornerImage& image, const Board& board, const std::vector<Found>& found,
                           const std::vector<Box>& boxes, int turn) {
  constexpr double kReach = 1.2;
  std::vector<Eigen::Matrix3d> H;
  for (const Found& marker : found) H.push_back(homography(marker, boxes[marker.id], turn));
  const std::vector<Eigen::Vector3d> points = board_points(board);
  Corners corners;
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
    if (auto c = refine_point(image, board, i, p, H[nearest])) corners[i] = *c;
  }
  return corners;
}

/// pixel_from_board by the corners nearest to `p`; nothing if there are too few within `reach_m`.
std::optional<Eigen::Matrix3d> homography_near(const Corners& corners,
                                               const std::vector<Eigen::Vector3d>& points,
                                               const Eigen::Vector2d& p, double reach_m) {
  constexpr std::size_t kMost = 9, kLeast = 6;
  std::vector<std::pair<double, int>> order;
  for (const auto& [point, corner] : corners)
    order.emplace_back((points[static_cast<std::size_t>(point)].head<2>() - p).norm(), point);
  std::sort(order.begin(), order.end());
  if (order.size() < kLeast || order.front().first > reach_m) return std::nullopt;
  order.resize(std::min(order.size(), kMost));
  std::vector<cv::Point2d> from, to;
  for (const auto& [distance, point] : order) {
    from.emplace_back(points[static_cast<std::size_t>(point)].x(),
                      points[static_cast<std::size_t>(point)].y());
    const Eigen::Vector2d& q = corners.at(point).at_px;
    to.emplace_back(q.x(), q.y());
  }
  const cv::Mat H = cv::findHomography(from, to, 0);
  if (H.empty()) return std::nullopt;
  return Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(H.ptr<double>());
}

/// Corners whose markers were not read, outwards from those that are there.
void grow(const CornerImage& image, const Board& board, Corners& corners) {
  const std::vector<Eigen::Vector3d> points = board_points(board);
  const double reach_m = 1.1 * (board.kind == Board::Kind::aprilgrid ? board.tag_m() : board.square_m);
  std::vector<double> contrasts;
  for (const auto& [point, corner] : corners) contrasts.push_back(corner.contrast);
  std::sort(contrasts.begin(), contrasts.end());
  for (bool more = true; more;) {
    Corners added;
    for (int i = 0; i < board.corners(); ++i) {
      if (!board.has_corner(i) || corners.contains(i)) continue;
      const Eigen::Vector2d p = points[static_cast<std::size_t>(i)].head<2>();
      const auto H = homography_near(corners, points, p, reach_m);
      if (!H) continue;
      const auto c = refine_point(image, board, i, p, *H);
      // What no marker vouches for must look like the others.
      if (c && c->contrast > 0.5 * contrasts[contrasts.size() / 2]) added[i] = *c;
    }
    more = !added.empty();
    corners.merge(added);
  }
}

}  // namespace

std::vector<Eigen::Vector2d> detect_markers(const CornerImage& image, const Board& board) {
  const std::vector<Box> boxes = marker_boxes(board);
  std::vector<Found> found = find_markers(image.grey, board, static_cast<int>(boxes.size()));
  if (found.empty()) return {};
  const int turn = common_turn(found, boxes, board);
  const std::size_t dropped = drop_misplaced(boxes, turn, found);
  // One may be a thing of the scene; several say that this is not the board.
  if (found.empty() || (dropped > 1 && 9 * dropped > found.size())) return {};
  Corners corners = corners_by_markers(image, board, found, boxes, turn);
  if (corners.empty()) return {};
  grow(image, board, corners);
  std::vector<double> contrasts;
  for (const auto& [point, corner] : corners) contrasts.push_back(corner.contrast);
  const double least = median(std::move(contrasts)) / 3;
  constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
  std::vector<Eigen::Vector2d> result(static_cast<std::size_t>(board.corners()), {kNaN, kNaN});
  for (const auto& [point, corner] : corners)
    if (corner.contrast >= least) result[static_cast<std::size_t>(point)] = corner.at_px;
  return result;
}

}  // namespace stuv
