#include "calib/board/pattern.h"

#include <algorithm>

#include "calib/board/markers.h"

namespace stuv {
namespace {

using Box = Eigen::AlignedBox2d;

Box box(double x, double y, double size) {
  return {Eigen::Vector2d(x, y), Eigen::Vector2d(x + size, y + size)};
}

/// Squares are counted from the top left one, whose lower right corner is the origin.
bool is_dark_square(const Board& board, int x, int y) {
  const int squares_down = board.rows + 1;
  const bool white_first = board.legacy && squares_down % 2 == 0;
  return ((x + y) % 2 == 0) != white_first;
}

template <class F>
void for_each_square(const Board& board, bool dark, F f) {
  for (int y = 0; y <= board.rows; ++y)
    for (int x = 0; x <= board.columns; ++x)
      if (is_dark_square(board, x, y) == dark) f((x - 1) * board.square_m, (y - 1) * board.square_m);
}

/// The black cells of a marker: its border and the code's zeros, cells of a row that touch in one.
void add_marker(const MarkerBits& bits, int border, bool half_turn, const Box& area, std::vector<Box>& dark) {
  const int cells = bits.size + 2 * border;
  const double cell = area.sizes().x() / cells;
  const auto is_white = [&](int x, int y) {
    const int bx = x - border, by = y - border;
    if (bx < 0 || by < 0 || bx >= bits.size || by >= bits.size) return false;
    const int at = by * bits.size + bx;
    return static_cast<bool>(bits.white[half_turn ? bits.size * bits.size - 1 - at : at]);
  };
  for (int y = 0; y < cells; ++y)
    for (int x = 0, begin = 0; x < cells; begin = ++x) {
      while (x < cells && !is_white(x, y)) ++x;
      if (x > begin)
        dark.emplace_back(area.min() + cell * Eigen::Vector2d(begin, y),
                          area.min() + cell * Eigen::Vector2d(x, y + 1));
    }
}

std::vector<Box> charuco_boxes(const Board& board) {
  std::vector<Box> boxes;
  const double inset = 0.5 * (board.square_m - board.marker_m);
  for_each_square(board, false,
                  [&](double x, double y) { boxes.push_back(box(x + inset, y + inset, board.marker_m)); });
  return boxes;
}

std::vector<Box> tag_boxes(const Board& board) {
  std::vector<Box> boxes;
  const double pitch = (board.tag_steps + board.gap_steps) * board.square_m;
  for (int from_bottom = 0; from_bottom < board.tag_rows; ++from_bottom)
    for (int x = 0; x < board.tag_columns; ++x)
      boxes.push_back(box(x * pitch, (board.tag_rows - 1 - from_bottom) * pitch, board.tag_m()));
  return boxes;
}

/// Kalibr's squares where the gaps cross, around the outer tags too.
void add_gap_squares(const Board& board, std::vector<Box>& dark) {
  const double pitch = (board.tag_steps + board.gap_steps) * board.square_m,
               gap = board.gap_steps * board.square_m;
  for (int y = 0; y <= board.tag_rows; ++y)
    for (int x = 0; x <= board.tag_columns; ++x) dark.push_back(box(x * pitch - gap, y * pitch - gap, gap));
}

}  // namespace

std::vector<Box> marker_boxes(const Board& board) {
  if (board.kind == Board::Kind::charuco) return charuco_boxes(board);
  if (board.kind == Board::Kind::aprilgrid) return tag_boxes(board);
  return {};
}

std::vector<Box> dark_areas(const Board& board) {
  const bool tags = board.kind == Board::Kind::aprilgrid;
  std::vector<Box> dark;
  if (tags)
    add_gap_squares(board, dark);
  else
    for_each_square(board, true, [&](double x, double y) { dark.push_back(box(x, y, board.square_m)); });
  const std::vector<Box> markers = marker_boxes(board);
  for (std::size_t id = 0; id < markers.size(); ++id)
    // OpenCV has the tags' codes upside down.
    add_marker(marker_bits(tags ? kAprilGridDictionary : board.dictionary, static_cast<int>(id)),
               tags ? kAprilGridBorder : 1, tags, markers[id], dark);
  return dark;
}

bool dark_towards_origin_and_away(const Board& board, int point) {
  const int x = point % board.columns, y = point / board.columns;
  if (board.kind != Board::Kind::aprilgrid) return is_dark_square(board, x, y);
  const int pitch = board.tag_steps + board.gap_steps;
  return (x % pitch == 0) == (y % pitch == 0);
}

double corner_clearance_m(const Board& board) {
  switch (board.kind) {
    case Board::Kind::charuco:
      return 0.5 * (board.square_m - board.marker_m);
    case Board::Kind::aprilgrid: {
      const double cell = board.tag_m() / (6 + 2 * kAprilGridBorder);
      return std::min(board.gap_steps * board.square_m, kAprilGridBorder * cell);
    }
    case Board::Kind::chessboard:
      break;
  }
  return board.square_m;
}

}  // namespace stuv
