#include "calib/board/board.h"

#include <fmt/format.h>

#include <charconv>
#include <cmath>
#include <string_view>

#include "core/error.h"

namespace stuv {
namespace {

[[noreturn]] void refuse(const std::string& spec, const std::string& why) {
  throw Error("board '" + spec + "'", why,
              "write it like chessboard:28x17:20mm (inner corners, square size)");
}

/// Takes a number off the front of `text`; false if there is none.
template <class T>
bool take_number(std::string_view& text, T& value) {
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (error != std::errc()) return false;
  text.remove_prefix(static_cast<std::size_t>(end - text.data()));
  return true;
}

bool take(std::string_view& text, std::string_view what) {
  if (!text.starts_with(what)) return false;
  text.remove_prefix(what.size());
  return true;
}

double metres_per(std::string_view unit) {
  if (unit == "mm") return 1e-3;
  if (unit == "cm") return 1e-2;
  return unit == "m" ? 1.0 : 0.0;
}

}  // namespace

Board parse_board(const std::string& spec) {
  Board board;
  std::string_view text = spec;
  double size = 0;
  if (!take(text, "chessboard:")) refuse(spec, "is of no known kind");
  if (!take_number(text, board.columns) || !take(text, "x") || !take_number(text, board.rows) ||
      !take(text, ":") || !take_number(text, size))
    refuse(spec, "cannot be read");
  const double unit = metres_per(text);
  if (unit == 0) refuse(spec, "has a square size without mm, cm or m");
  board.square_m = size * unit;
  if (!(board.square_m > 0) || !std::isfinite(board.square_m)) refuse(spec, "has a square size of nothing");
  if (board.columns < 3 || board.rows < 3) refuse(spec, "has fewer than 3 inner corners along a side");
  if (board.columns > 1000 || board.rows > 1000)
    refuse(spec, "has more than 1000 inner corners along a side");
  if (board.columns == board.rows) refuse(spec, "is square: turned by 90 degrees it looks the same");
  return board;
}

std::string board_spec(const Board& board) {
  return fmt::format("chessboard:{}x{}:{:.10g}mm", board.columns, board.rows, board.square_m * 1e3);
}

std::vector<Eigen::Vector3d> board_points(const Board& board) {
  std::vector<Eigen::Vector3d> points;
  points.reserve(static_cast<std::size_t>(board.corners()));
  for (int y = 0; y < board.rows; ++y)
    for (int x = 0; x < board.columns; ++x) points.emplace_back(x * board.square_m, y * board.square_m, 0);
  return points;
}

}  // namespace stuv
