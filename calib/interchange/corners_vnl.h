#pragma once

#include <Eigen/Dense>
#include <filesystem>
#include <string>
#include <vector>

#include "calib/board/find_corners.h"
#include "core/recording.h"

namespace stuv {

/// A board's corners in one picture, as mrcal's corners.vnl has them.
struct PictureCorners {
  std::string picture;                      ///< path, as the file has it
  std::vector<Eigen::Vector2d> corners_px;  ///< row by row, x fastest; NaN where none was seen
  std::vector<double> weights;              ///< 0 where none was seen
};

/// Text, a line a corner: `# filename x y level` or `# filename x y weight`, then the values; `-` for what is
/// not there. A picture without a board has one line `FILE - -`. A level L (how often the picture was halved
/// to find the corner) is the weight 2^-L; a level below 0, a weight of 0 or less, or `-` is a corner that
/// was not seen. Without a fourth column all weigh 1. Pictures with a board must have `corners` lines each.
/// Throws Error naming the line.
std::vector<PictureCorners> read_corners_vnl(const std::filesystem::path& file, int corners);

/// With weights; pictures without corners get their one line.
void write_corners_vnl(const std::filesystem::path& file, const std::vector<PictureCorners>& pictures);

/// Which frame of a recording each picture is: the one whose path ends with the picture's, folder by folder.
struct FramePlace {
  int set = -1, camera = -1;  ///< -1: none
};
/// Throws Error naming `file` if a picture fits several frames, or if none fits any.
std::vector<FramePlace> places_of(const std::vector<PictureCorners>& pictures, const Recording& recording,
                                  const std::string& file);

/// What find_corners found, pictures that were looked at only; a path is below the recording's folder if the
/// picture lies there, else whole.
std::vector<PictureCorners> picture_corners(const Recording& recording, const FoundCorners& found);

/// Corners of a recording's pictures from a corners.vnl instead of from the pictures themselves, of which
/// only the sizes are read. `unused`: pictures of the file that the recording does not have.
FoundCorners read_found_corners(const std::filesystem::path& file, const Board& board,
                                const Recording& recording, int& unused);

}  // namespace stuv
