#include "calib/board/detect_chessboard.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <opencv2/calib3d.hpp>

#include "calib/board/corner_grid.h"

namespace stuv {
namespace {

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();

CornerGrid grid_of(const std::vector<cv::Point2f>& corners, int columns) {
  CornerGrid grid;
  for (std::size_t k = 0; k < corners.size(); ++k) {
    const int at = static_cast<int>(k);
    grid[{at % columns, at / columns}] = {corners[k].x, corners[k].y};
  }
  return grid;
}

/// The largest grid of corners of at least part of the board; empty if there is none. More than half of the
/// board is looked for first: what starts from fewer corners may take every second column for the grid.
CornerGrid find_grid(const CornerImage& image, const Board& board) {
  const cv::Size small(std::min(5, board.columns), std::min(4, board.rows));
  const cv::Size large(std::max(small.width, board.columns / 2 + 1),
                       std::max(small.height, board.rows / 2 + 1));
  for (const cv::Size& least : {large, small}) {
    std::vector<cv::Point2f> corners;
    cv::Mat meta;  // one entry a corner: its shape is the grid's
    const bool found = cv::findChessboardCornersSB(
        image.grey, least, corners, cv::CALIB_CB_EXHAUSTIVE | cv::CALIB_CB_ACCURACY | cv::CALIB_CB_LARGER,
        meta);
    if (found && !meta.empty() && corners.size() == meta.total()) return grid_of(corners, meta.cols);
  }
  return {};
}

/// The whole board row by row, or nothing. The exhaustive search is several times slower, and misses boards
/// that the plain one finds.
std::vector<Eigen::Vector2d> find_whole(const CornerImage& image, const Board& board) {
  for (const int search : {0, static_cast<int>(cv::CALIB_CB_EXHAUSTIVE)}) {
    std::vector<cv::Point2f> corners;
    const bool found = cv::findChessboardCornersSB(image.grey, {board.columns, board.rows}, corners,
                                                   search | cv::CALIB_CB_ACCURACY);
    if (!found || corners.size() != static_cast<std::size_t>(board.corners())) continue;
    std::vector<Eigen::Vector2d> whole;
    for (const cv::Point2f& c : corners) whole.emplace_back(c.x, c.y);
    return whole;
  }
  return {};
}

/// First and last place along both axes.
struct Extent {
  std::array<int, 2> first = {std::numeric_limits<int>::max(), std::numeric_limits<int>::max()};
  std::array<int, 2> last = {std::numeric_limits<int>::min(), std::numeric_limits<int>::min()};

  explicit Extent(const CornerGrid& grid) {
    for (const auto& [place, at] : grid)
      for (int axis = 0; axis < 2; ++axis) {
        const int p = axis == 0 ? place.first : place.second;
        first[axis] = std::min(first[axis], p);
        last[axis] = std::max(last[axis], p);
      }
  }
  int count(int axis) const { return last[axis] - first[axis] + 1; }
};

/// Left by one end of the grid.
enum class End { border, margin, unknown };

/// What lies beyond the grid along `axis`, at its last (toward = 1) or first (-1) corners: the picture's
/// border, the white margin around the board's squares, or something else.
End end_of(const CornerImage& image, const SquareColours& colours, const CornerGrid& grid,
           const Extent& extent, int axis, int toward) {
  const int edge = toward > 0 ? extent.last[axis] : extent.first[axis];
  int outside = 0, inside = 0, white = 0;
  for (const auto& [place, at] : grid) {
    if ((axis == 0 ? place.first : place.second) != edge) continue;
    Eigen::Vector2d step[2];
    if (!steps_at(grid, place.first, place.second, step[0], step[1])) continue;
    // The squares end one step out; half of a usual margin further there is paper.
    const Eigen::Vector2d out = toward * step[axis];
    // What growing a corner looks at: its window, and its squares a third of a step away.
    const double spare =
        std::max(window_radius(step[0], step[1]) + 1, (step[0].norm() + step[1].norm()) / 3 + 2);
    const Eigen::AlignedBox2d picture(
        Eigen::Vector2d::Constant(spare),
        Eigen::Vector2d(image.luma.cols - 1 - spare, image.luma.rows - 1 - spare));
    const Eigen::Vector2d paper = at + 1.2 * out;
    if (!picture.contains(at + out)) {
      ++outside;
      continue;
    }
    ++inside;
    const int x = static_cast<int>(std::lround(paper.x())), y = static_cast<int>(std::lround(paper.y()));
    if (x < 0 || y < 0 || x >= image.luma.cols || y >= image.luma.rows) continue;
    if (image.luma.at<float>(y, x) > colours.bright - 0.35 * colours.contrast) ++white;
  }
  if (inside == 0 && outside > 0) return End::border;
  return inside >= 3 && inside >= outside && white >= 0.8 * inside ? End::margin : End::unknown;
}

/// A way to lay the grid on the board: which grid axis runs along its columns, and the board's column and row
/// of the grid's first places.
struct Placement {
  int x_axis = 0;
  std::array<int, 2> offset = {0, 0};
};

/// Offset of the grid within `size` corners along one axis; -1 if it is not certain.
int offset_along(int count, int size, End before, End after) {
  if (count == size) return 0;
  if (count > size) return -1;
  if (before == End::margin && after == End::border) return 0;
  if (before == End::border && after == End::margin) return size - count;
  return -1;
}

std::vector<Placement> placements(const CornerImage& image, const SquareColours& colours,
                                  const CornerGrid& grid, const Board& board) {
  const Extent extent(grid);
  std::array<std::array<End, 2>, 2> ends;
  for (int axis = 0; axis < 2; ++axis)
    for (int end = 0; end < 2; ++end)
      ends[axis][end] = end_of(image, colours, grid, extent, axis, 2 * end - 1);
  std::vector<Placement> found;
  for (int x_axis = 0; x_axis < 2; ++x_axis) {
    const int y_axis = 1 - x_axis;
    const int x = offset_along(extent.count(x_axis), board.columns, ends[x_axis][0], ends[x_axis][1]);
    const int y = offset_along(extent.count(y_axis), board.rows, ends[y_axis][0], ends[y_axis][1]);
    if (x < 0 || y < 0) continue;
    found.push_back({x_axis, {x, y}});
  }
  return found;
}

std::vector<Eigen::Vector2d> lay_out(const CornerGrid& grid, const Placement& placement, const Board& board) {
  const Extent extent(grid);
  std::vector<Eigen::Vector2d> corners(static_cast<std::size_t>(board.corners()), {kNaN, kNaN});
  for (const auto& [place, at] : grid) {
    const int p[2] = {place.first - extent.first[0], place.second - extent.first[1]};
    const int x = p[placement.x_axis] + placement.offset[0],
              y = p[1 - placement.x_axis] + placement.offset[1];
    corners[static_cast<std::size_t>(y * board.columns + x)] = at;
  }
  return corners;
}

/// Visits the board's inner squares all of whose corners were seen: f(x, y, its four corners).
template <class F>
void for_each_square(const std::vector<Eigen::Vector2d>& corners, const Board& board, F f) {
  for (int y = 0; y + 1 < board.rows; ++y)
    for (int x = 0; x + 1 < board.columns; ++x) {
      const Eigen::Vector2d* c = &corners[static_cast<std::size_t>(y * board.columns + x)];
      const Eigen::Vector2d *right = c + 1, *below = c + board.columns, *opposite = below + 1;
      if (c->allFinite() && right->allFinite() && below->allFinite() && opposite->allFinite())
        f(x, y, *c, *right, *below, *opposite);
    }
}

/// A mirrored order (x to the right, y up) cannot come from a board seen from its front.
bool is_mirrored(const std::vector<Eigen::Vector2d>& corners, const Board& board) {
  double area = 0;
  for_each_square(corners, board,
                  [&](int, int, const auto& c, const auto& right, const auto& below, const auto&) {
                    area += (right - c).x() * (below - c).y() - (right - c).y() * (below - c).x();
                  });
  return area < 0;
}

/// Mean brightness of the inner squares whose row + column is even, minus that of the others.
double even_minus_odd(const cv::Mat& luma, const std::vector<Eigen::Vector2d>& corners, const Board& board) {
  double sum[2] = {0, 0};
  int count[2] = {0, 0};
  for_each_square(
      corners, board,
      [&](int x, int y, const auto& c, const auto& right, const auto& below, const auto& opposite) {
        const Eigen::Vector2d middle = 0.25 * (c + right + below + opposite);
        sum[(x + y) % 2] += luma.at<float>(static_cast<int>(std::lround(middle.y())),
                                           static_cast<int>(std::lround(middle.x())));
        ++count[(x + y) % 2];
      });
  return sum[0] / std::max(1, count[0]) - sum[1] / std::max(1, count[1]);
}

/// The placement is one of a rectangle; its rows may yet run the wrong way.
void put_in_order(const CornerImage& image, const Board& board, std::vector<Eigen::Vector2d>& corners) {
  if (is_mirrored(corners, board))
    for (int y = 0; y < board.rows; ++y)
      std::reverse(corners.begin() + y * board.columns, corners.begin() + (y + 1) * board.columns);
  if (!board.is_ambiguous() && even_minus_odd(image.luma, corners, board) > 0)
    std::reverse(corners.begin(), corners.end());
}

/// The grid grown to all corners that can be seen, and laid on the board; empty if that cannot be done for
/// certain.
std::vector<Eigen::Vector2d> lay_part(const CornerImage& image, CornerGrid grid, const Board& board) {
  if (grid.empty()) return {};
  fill_skipped(image, grid);
  const SquareColours colours = square_colours(image, grid);
  grow_grid(image, colours, std::max(board.columns, board.rows), grid);
  const std::vector<Placement> ways = placements(image, colours, grid, board);
  return ways.size() == 1 ? lay_out(grid, ways.front(), board) : std::vector<Eigen::Vector2d>{};
}

}  // namespace

std::vector<Eigen::Vector2d> detect_chessboard(const CornerImage& image, const Board& board) {
  std::vector<Eigen::Vector2d> corners = find_whole(image, board);
  if (corners.empty()) corners = lay_part(image, find_grid(image, board), board);
  if (!corners.empty()) put_in_order(image, board, corners);
  return corners;
}

}  // namespace stuv
