#include "calib/board/print.h"

#include <cairo/cairo-pdf.h>
#include <cairo/cairo-svg.h>
#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <memory>
#include <optional>
#include <vector>

#include "calib/board/pattern.h"
#include "core/error.h"

namespace stuv {
namespace {

constexpr double kFootM = 0.016;  // for bar and text
constexpr double kBarM = 0.1;

struct Destroy {
  void operator()(cairo_surface_t* surface) const { cairo_surface_destroy(surface); }
  void operator()(cairo_t* context) const { cairo_destroy(context); }
};
using Surface = std::unique_ptr<cairo_surface_t, Destroy>;
using Context = std::unique_ptr<cairo_t, Destroy>;

/// ISO 216: A0 has a square metre and sides of 1 to sqrt 2, each next one half of it, rounded down to
/// millimetres.
Eigen::Vector2d iso_a(int n) {
  Eigen::Vector2d size(0.841, 1.189);
  for (int i = 0; i < n; ++i)
    size = Eigen::Vector2d(std::floor(size.y() * 500 + 1e-6) / 1000, size.x()).eval();
  return size;
}

double metres_per(std::string_view unit) {
  if (unit == "mm") return 1e-3;
  if (unit == "cm") return 1e-2;
  return unit == "m" ? 1 : 0;
}

double quiet_zone_m(const Board& board) {
  return board.square_m * (board.kind == Board::Kind::aprilgrid ? board.gap_steps : 0.5);
}

std::optional<Eigen::Vector2d> turned_to_hold(const Eigen::Vector2d& paper, const Eigen::Vector2d& content) {
  constexpr double kHairM = 1e-9;
  const Eigen::Vector2d other(paper.y(), paper.x());
  if (((paper - content).array() >= -kHairM).all()) return paper;
  if (((other - content).array() >= -kHairM).all()) return other;
  return std::nullopt;
}

Eigen::Vector2d choose_paper(const Board& board, const Eigen::Vector2d& content,
                             const PrintOptions& options) {
  if (options.paper_m.minCoeff() > 0) {
    if (const auto paper = turned_to_hold(options.paper_m, content)) return *paper;
    throw Error(
        "board '" + board_spec(board) + "'",
        fmt::format("needs {:.0f}x{:.0f} mm with its margin and foot, more than the paper's {:.0f}x{:.0f}",
                    1e3 * content.x(), 1e3 * content.y(), 1e3 * options.paper_m.x(),
                    1e3 * options.paper_m.y()),
        "use larger paper, a smaller board or a smaller margin");
  }
  for (int n = 4; n >= 0; --n)
    if (const auto paper = turned_to_hold(iso_a(n), content)) return *paper;
  return content;
}

void add_boxes(cairo_t* c, const std::vector<Eigen::AlignedBox2d>& boxes) {
  for (const Eigen::AlignedBox2d& box : boxes)
    cairo_rectangle(c, box.min().x(), box.min().y(), box.sizes().x(), box.sizes().y());
}

/// In metres, the board's frame.
void draw_board(cairo_t* c, const Board& board, double margin_m) {
  cairo_set_source_rgb(c, 0, 0, 0);
  if (board.inverted) {
    Eigen::AlignedBox2d sheet = board_outline(board);
    sheet.min().array() -= margin_m;
    sheet.max().array() += margin_m;
    add_boxes(c, {sheet});
    cairo_fill(c);
    cairo_set_source_rgb(c, 1, 1, 1);
  }
  // One path, so that no viewer leaves hairlines between boxes that touch.
  add_boxes(c, dark_areas(board));
  cairo_fill(c);
}

/// In metres, from the foot's left end and middle height.
void draw_foot(cairo_t* c, const std::string& spec, double width_m) {
  constexpr double kTickM = 0.003, kLineM = 0.0003, kTextM = 0.0035, kSpaceM = 0.004;
  cairo_set_source_rgb(c, 0, 0, 0);
  cairo_set_line_width(c, kLineM);
  // The ticks' middles are 100 mm apart.
  for (const double x : {0.0, kBarM}) {
    cairo_move_to(c, x, -kTickM / 2);
    cairo_line_to(c, x, kTickM / 2);
  }
  cairo_move_to(c, 0, 0);
  cairo_line_to(c, kBarM, 0);
  cairo_stroke(c);
  cairo_select_font_face(c, "sans-serif", CAIRO_FONT_SLANT_NORMAL, CAIRO_FONT_WEIGHT_NORMAL);
  cairo_set_font_size(c, kTextM);
  const std::string text = "100 mm: print at 100 %   --board " + spec;
  cairo_text_extents_t extents;
  cairo_text_extents(c, text.c_str(), &extents);
  // Beside the bar where there is room, else below it, smaller if it must be.
  const bool beside = kBarM + kSpaceM + extents.width <= width_m;
  if (!beside && extents.width > width_m) cairo_set_font_size(c, kTextM * width_m / extents.width);
  cairo_move_to(c, beside ? kBarM + kSpaceM : 0, beside ? kTextM / 3 : kTickM / 2 + 1.3 * kTextM);
  cairo_show_text(c, text.c_str());
}

/// A page of that size, and how many of its units a metre has.
Surface open_page(const std::filesystem::path& file, const Eigen::Vector2d& paper_m, const std::string& title,
                  double& units_per_m) {
  if (file.extension() == ".svg") {
    units_per_m = 1000;
    Surface surface(cairo_svg_surface_create(file.c_str(), 1000 * paper_m.x(), 1000 * paper_m.y()));
    cairo_svg_surface_set_document_unit(surface.get(), CAIRO_SVG_UNIT_MM);
    return surface;
  }
  units_per_m = 72 / 0.0254;
  Surface surface(
      cairo_pdf_surface_create(file.c_str(), units_per_m * paper_m.x(), units_per_m * paper_m.y()));
  cairo_pdf_surface_set_metadata(surface.get(), CAIRO_PDF_METADATA_TITLE, title.c_str());
  // Equal boards, equal bytes.
  cairo_pdf_surface_set_metadata(surface.get(), CAIRO_PDF_METADATA_CREATE_DATE, "2000-01-01T00:00:00Z");
  return surface;
}

}  // namespace

Eigen::Vector2d parse_paper(const std::string& text) {
  const auto refuse = [&] {
    throw Error("paper '" + text + "'", "is of no known size", "give A0 to A4 or e.g. 600x400mm");
  };
  if (text.size() == 2 && (text[0] == 'A' || text[0] == 'a') && text[1] >= '0' && text[1] <= '4')
    return iso_a(text[1] - '0');
  double size[2] = {0, 0};
  const char *at = text.data(), *end = text.data() + text.size();
  for (int i = 0; i < 2; ++i) {
    const auto [next, error] = std::from_chars(at, end, size[i]);
    if (error != std::errc() || !(size[i] > 0) || !std::isfinite(size[i])) refuse();
    at = next;
    if (i == 0 && (at == end || *at++ != 'x')) refuse();
  }
  const double unit = metres_per({at, static_cast<std::size_t>(end - at)});
  if (unit == 0) refuse();
  const Eigen::Vector2d paper(unit * size[0], unit * size[1]);
  if (!(paper.maxCoeff() <= 10)) refuse();
  return paper;
}

PrintedBoard print_board(const Board& board, const std::filesystem::path& file, const PrintOptions& options) {
  if (file.extension() != ".pdf" && file.extension() != ".svg")
    throw Error(file.string(), "is neither a .pdf nor a .svg", "name it so");
  const double margin_m = std::max(options.margin_m, quiet_zone_m(board));
  const Eigen::AlignedBox2d outline = board_outline(board);
  const Eigen::Vector2d content = outline.sizes() + Eigen::Vector2d(2 * margin_m, 2 * margin_m + kFootM);
  PrintedBoard printed;
  printed.paper_m = choose_paper(board, content, options);
  // In the middle of what the foot leaves.
  const Eigen::Vector2d room(printed.paper_m.x(), printed.paper_m.y() - kFootM);
  printed.origin_m = 0.5 * (room - outline.sizes()) - outline.min();

  double units_per_m = 0;
  const Surface surface = open_page(file, printed.paper_m, board_spec(board), units_per_m);
  const Context context(cairo_create(surface.get()));
  cairo_t* c = context.get();
  cairo_set_source_rgb(c, 1, 1, 1);
  cairo_paint(c);
  cairo_scale(c, units_per_m, units_per_m);
  cairo_save(c);
  cairo_translate(c, printed.origin_m.x(), printed.origin_m.y());
  draw_board(c, board, std::min(margin_m, 0.5 * board.square_m));
  cairo_restore(c);
  constexpr double kSideM = 0.01;
  cairo_translate(c, kSideM, printed.paper_m.y() - kFootM + 0.004);
  draw_foot(c, board_spec(board), printed.paper_m.x() - 2 * kSideM);
  cairo_show_page(c);
  cairo_surface_finish(surface.get());
  if (cairo_surface_status(surface.get()) != CAIRO_STATUS_SUCCESS || cairo_status(c) != CAIRO_STATUS_SUCCESS)
    throw Error(file.string(), "cannot be written", "check the folder and the disk");
  return printed;
}

}  // namespace stuv
