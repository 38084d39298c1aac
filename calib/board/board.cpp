#include "calib/board/board.h"

#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <numeric>
#include <optional>
#include <string_view>

#include "calib/board/kalibr_target.h"
#include "calib/board/markers.h"
#include "core/error.h"

namespace stuv {
namespace {

[[noreturn]] void refuse(const std::string& spec, const std::string& why) {
  throw Error(
      "board '" + spec + "'", why,
      "write it like chessboard:28x17:20mm (inner corners), charuco:5x7:40mm:30mm:DICT_4X4_50 (squares) or "
      "aprilgrid:6x6:88mm:0.3 (tags)");
}

/// Takes a number off the front of `text`; nothing if there is none.
template <class T>
std::optional<T> take_number(std::string_view& text) {
  T value = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (error != std::errc()) return std::nullopt;
  text.remove_prefix(static_cast<std::size_t>(end - text.data()));
  return value;
}

double metres_per(std::string_view unit) {
  if (unit == "mm") return 1e-3;
  if (unit == "cm") return 1e-2;
  return unit == "m" ? 1.0 : 0.0;
}

std::vector<std::string_view> split(std::string_view text, char at) {
  std::vector<std::string_view> parts;
  for (std::size_t end = text.find(at); end != std::string_view::npos; end = text.find(at)) {
    parts.push_back(text.substr(0, end));
    text.remove_prefix(end + 1);
  }
  parts.push_back(text);
  return parts;
}

/// The fields of one specification, each read with the text that a failure is to name.
struct Reader {
  const std::string& spec;
  std::vector<std::string_view> fields;

  void counts(int& columns, int& rows, const std::string& what) const {
    std::string_view text = fields[1];
    const auto c = take_number<int>(text);
    if (!c || !text.starts_with('x')) refuse(spec, "cannot be read");
    text.remove_prefix(1);
    const auto r = take_number<int>(text);
    if (!r || !text.empty()) refuse(spec, "cannot be read");
    if (*c > 1000 || *r > 1000) refuse(spec, "has more than 1000 " + what + " along a side");
    columns = *c;
    rows = *r;
  }

  double length_m(std::size_t field, const std::string& what) const {
    std::string_view text = fields[field];
    const auto size = take_number<double>(text);
    if (!size) refuse(spec, "cannot be read");
    const double unit = metres_per(text);
    if (unit == 0) refuse(spec, "has a " + what + " without mm, cm or m");
    const double metres = *size * unit;
    if (!(metres > 0) || !std::isfinite(metres)) refuse(spec, "has a " + what + " of nothing");
    return metres;
  }

  void want(std::size_t least, std::size_t most) const {
    if (fields.size() < least || fields.size() > most) refuse(spec, "cannot be read");
  }
};

Board parse_chessboard(const Reader& in) {
  in.want(3, 3);
  Board board;
  in.counts(board.columns, board.rows, "inner corners");
  board.square_m = in.length_m(2, "square size");
  if (board.columns < 3 || board.rows < 3) refuse(in.spec, "has fewer than 3 inner corners along a side");
  if (board.columns == board.rows) refuse(in.spec, "is square: turned by 90 degrees it looks the same");
  return board;
}

Board parse_charuco(const Reader& in) {
  in.want(5, 7);
  Board board;
  board.kind = Board::Kind::charuco;
  in.counts(board.columns, board.rows, "squares");
  board.square_m = in.length_m(2, "square size");
  board.marker_m = in.length_m(3, "marker size");
  board.dictionary = in.fields[4];
  for (std::size_t i = 5; i < in.fields.size(); ++i) {
    bool& flag = in.fields[i] == "legacy" ? board.legacy : board.inverted;
    if ((in.fields[i] != "legacy" && in.fields[i] != "inverted") || flag)
      refuse(in.spec, fmt::format("ends in '{}', not in inverted or legacy", in.fields[i]));
    flag = true;
  }
  if (board.columns < 3 || board.rows < 3) refuse(in.spec, "has fewer than 3 squares along a side");
  if (!(board.marker_m < board.square_m)) refuse(in.spec, "has markers that do not fit into its squares");
  const int markers = dictionary_size(board.dictionary), needed = (board.columns * board.rows + 1) / 2;
  if (markers == 0) refuse(in.spec, "names a dictionary that OpenCV does not have");
  if (needed > markers)
    refuse(in.spec, fmt::format("needs {} markers, but its dictionary has {}", needed, markers));
  --board.columns;
  --board.rows;
  return board;
}

struct Fraction {
  int above = 0, below = 1;
};

/// The first convergent of the continued fraction of x that comes within `tolerance`.
Fraction nearest_fraction(double x, double tolerance) {
  constexpr double kMost = 1e6;
  double above[2] = {0, 1}, below[2] = {1, 0}, rest = x;
  while (true) {
    const double whole = std::floor(rest + 1e-12);
    const double a = whole * above[1] + above[0], b = whole * below[1] + below[0];
    above[0] = above[1], above[1] = a, below[0] = below[1], below[1] = b;
    if (std::abs(x - a / b) <= tolerance || b > kMost) return {static_cast<int>(a), static_cast<int>(b)};
    rest = 1 / (rest - whole);
  }
}

/// Gap over tag: a number, a fraction or a length.
double gap_ratio(const Reader& in, double tag_m) {
  std::string_view text = in.fields[3];
  const auto number = take_number<double>(text);
  if (!number) refuse(in.spec, "cannot be read");
  double ratio = *number;
  if (text.starts_with('/')) {
    text.remove_prefix(1);
    const auto below = take_number<double>(text);
    if (!below) refuse(in.spec, "cannot be read");
    ratio /= *below;
  }
  if (!text.empty()) {
    if (metres_per(text) == 0) refuse(in.spec, "has a gap that is neither a number nor a length");
    ratio *= metres_per(text) / tag_m;
  }
  if (!(ratio >= 0.01 && ratio <= 1)) refuse(in.spec, "has gaps below 0.01 or above 1 tags");
  return ratio;
}

Board parse_aprilgrid(const Reader& in) {
  in.want(4, 4);
  Board board;
  board.kind = Board::Kind::aprilgrid;
  in.counts(board.tag_columns, board.tag_rows, "tags");
  const double tag_m = in.length_m(2, "tag size");
  constexpr double kPlaceTolerance = 1e-5;  // tags: 1 um for a tag of 10 cm
  const Fraction gap = nearest_fraction(gap_ratio(in, tag_m), kPlaceTolerance);
  board.gap_steps = gap.above;
  board.tag_steps = gap.below;
  board.square_m = tag_m / board.tag_steps;
  if (board.tag_columns < 1 || board.tag_rows < 1) refuse(in.spec, "has no tags");
  const int tags = dictionary_size(kAprilGridDictionary);
  if (board.tag_columns * board.tag_rows > tags) refuse(in.spec, fmt::format("has more than {} tags", tags));
  const auto points = [&](int n) { return n * (board.tag_steps + board.gap_steps) - board.gap_steps + 1.0; };
  if (points(board.tag_columns) * points(board.tag_rows) > kMostLatticePoints)
    refuse(in.spec,
           fmt::format(
               "has gaps of {}/{} tags: the lattice of its corners would have more than {} points; round "
               "the gap to a simpler fraction, such as 0.3, 1/4 or 2/7",
               board.gap_steps, board.tag_steps, kMostLatticePoints));
  board.columns = static_cast<int>(points(board.tag_columns));
  board.rows = static_cast<int>(points(board.tag_rows));
  return board;
}

bool is_target_file(const std::string& spec) { return spec.ends_with(".yaml") || spec.ends_with(".yml"); }

/// Whether the tags of a row have a corner at that point.
bool has_edge(const Board& board, int point) {
  const int within = point % (board.tag_steps + board.gap_steps);
  return within == 0 || within == board.tag_steps;
}

std::string millimetres(double m) { return fmt::format("{:.10g}mm", m * 1e3); }

}  // namespace

bool Board::has_corner(int point) const {
  return kind != Kind::aprilgrid || (has_edge(*this, point % columns) && has_edge(*this, point / columns));
}

int Board::real_corners() const { return kind == Kind::aprilgrid ? 4 * tag_columns * tag_rows : corners(); }

Board parse_board(const std::string& spec) {
  if (is_target_file(spec)) return parse_board(kalibr_target_spec(spec));
  const Reader in{spec, split(spec, ':')};
  if (in.fields[0] == "chessboard") return parse_chessboard(in);
  if (in.fields[0] == "charuco") return parse_charuco(in);
  if (in.fields[0] == "aprilgrid") return parse_aprilgrid(in);
  refuse(spec, "is of no known kind");
}

std::string board_spec(const Board& b) {
  switch (b.kind) {
    case Board::Kind::charuco:
      return fmt::format("charuco:{}x{}:{}:{}:{}{}{}", b.columns + 1, b.rows + 1, millimetres(b.square_m),
                         millimetres(b.marker_m), b.dictionary, b.inverted ? ":inverted" : "",
                         b.legacy ? ":legacy" : "");
    case Board::Kind::aprilgrid:
      return fmt::format("aprilgrid:{}x{}:{}:{}/{}", b.tag_columns, b.tag_rows, millimetres(b.tag_m()),
                         b.gap_steps, b.tag_steps);
    case Board::Kind::chessboard:
      break;
  }
  return fmt::format("chessboard:{}x{}:{}", b.columns, b.rows, millimetres(b.square_m));
}

std::vector<Eigen::Vector3d> board_points(const Board& board) {
  std::vector<Eigen::Vector3d> points;
  points.reserve(static_cast<std::size_t>(board.corners()));
  for (int y = 0; y < board.rows; ++y)
    for (int x = 0; x < board.columns; ++x) points.emplace_back(x * board.square_m, y * board.square_m, 0);
  return points;
}

Eigen::AlignedBox2d board_outline(const Board& board) {
  const Eigen::Vector2d last((board.columns - 1) * board.square_m, (board.rows - 1) * board.square_m);
  const double outside = board.kind == Board::Kind::aprilgrid ? board.gap_steps : 1;
  const Eigen::Vector2d margin = Eigen::Vector2d::Constant(outside * board.square_m);
  return {-margin, last + margin};
}

}  // namespace stuv
