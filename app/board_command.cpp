#include <fmt/format.h>

#include <cmath>

#include "app/commands.h"
#include "app/console.h"
#include "calib/board/print.h"
#include "core/files.h"

namespace stuv {
namespace {

struct Flags : CommonFlags {
  std::string board, paper;
  std::filesystem::path output;
  double margin_mm = 10;
};

int run(const Flags& flags) {
  check_name("-o", flags.output, {".pdf", ".svg"});
  check_output(flags.output, flags.force);
  const Board board = parse_board(flags.board);
  PrintOptions options;
  if (!flags.paper.empty()) options.paper_m = parse_paper(flags.paper);
  options.margin_m = 1e-3 * flags.margin_mm;
  AtomicOutput output(flags.output, AtomicOutput::Kind::file, flags.force);
  const PrintedBoard printed = print_board(board, output.path(), options);
  output.commit();
  const Eigen::Vector2d paper_mm = 1e3 * printed.paper_m, origin_mm = 1e3 * printed.origin_m;
  write_result(flags, {{"board", board_spec(board)},
                       {"paper_mm", {paper_mm.x(), paper_mm.y()}},
                       {"origin_mm", {origin_mm.x(), origin_mm.y()}},
                       {"corners", board.real_corners()}});
  fmt::print("{}: {} on {:.0f}x{:.0f} mm; print at 100 %, then measure the bar of 100 mm\n",
             flags.output.string(), board_spec(board), paper_mm.x(), paper_mm.y());
  return kDone;
}

}  // namespace

void add_board_command(CLI::App& app, Action& action) {
  auto flags = std::make_shared<Flags>();
  CLI::App* command =
      app.add_subcommand("board",
                         "Draws a calibration board at its exact size.\n\n"
                         "  stuv board charuco:5x7:38mm:28mm:DICT_4X4_50 -o board.pdf\n"
                         "  stuv board aprilgrid:6x6:88mm:0.3 -o board.svg --paper 700x700mm\n"
                         "  stuv board chessboard:10x7:25mm -o board.pdf --paper A3\n");
  command
      ->add_option(
          "board", flags->board,
          "chessboard:COLSxROWS:SQUARE (inner corners), "
          "charuco:COLSxROWS:SQUARE:MARKER:DICT[:inverted][:legacy] (squares), "
          "aprilgrid:COLSxROWS:TAG:GAP (tags; gap in tags or with its unit), or Kalibr's target .yaml")
      ->required()
      ->type_name("BOARD");
  command->add_option("-o,--output", flags->output, "A .pdf or .svg")->required()->type_name("FILE");
  command->add_option("--paper", flags->paper, "A0 to A4 or WxHmm [the smallest of A4 to A0 that holds it]")
      ->type_name("PAPER");
  command->add_option("--margin-mm", flags->margin_mm, "White around the board [10]")
      ->check(CLI::Range(0.0, 1000.0));
  add_common_flags(*command, *flags);
  command->callback([flags, &action] { action = [flags] { return run(*flags); }; });
}

}  // namespace stuv
