#pragma once

#include <Eigen/Dense>
#include <filesystem>
#include <string>

#include "calib/board/board.h"

namespace stuv {

struct PrintOptions {
  /// Paper, either way round; 0: the smallest of A4 to A0 that holds board and margin, or as large as these
  /// are.
  Eigen::Vector2d paper_m = {0, 0};
  double margin_m = 0.01;  ///< white around the board, at least half a square (or a gap)
};

/// What was printed where.
struct PrintedBoard {
  Eigen::Vector2d paper_m;
  Eigen::Vector2d origin_m;  ///< the board's frame on the paper, from its top left
};

/// "A4", "a3" .. or "WxHmm" (cm, m): metres. Throws Error naming the text.
Eigen::Vector2d parse_paper(const std::string& text);

/// Draws the board into a .pdf or .svg, in vectors and at its exact size, over a bar of 100 mm to check the
/// print with and the text that parse_board reads. Throws Error if the name ends otherwise, the paper is too
/// small, or the file cannot be written.
PrintedBoard print_board(const Board& board, const std::filesystem::path& file,
                         const PrintOptions& options = {});

}  // namespace stuv
