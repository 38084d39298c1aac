#pragma once

#include "calib/board/detect.h"
#include "core/image.h"

namespace stuv {

/// The picture as 8 bit RGB with the corners that were found: a circle each, green, or orange where its sigma
/// is more than twice `usual_sigma_px`; rows joined by lines from corner to corner; the lattice's first row
/// red, and its first corner, if it was seen, with a square.
Image draw_board_overlay(const Image& picture, const Board& board, const BoardView& view,
                         double usual_sigma_px);

}  // namespace stuv
