#pragma once

#include <filesystem>
#include <string>

namespace stuv {

/// Reads a Kalibr target file, "key: value" lines, into parse_board's text:
///   target_type aprilgrid: tagCols, tagRows, tagSize [m], tagSpacing [tags]
///   target_type checkerboard: targetCols, targetRows (inner corners), rowSpacingMeters, colSpacingMeters
/// Throws Error naming the file if it cannot be read, is of another type, or its squares are not square.
std::string kalibr_target_spec(const std::filesystem::path& file);

}  // namespace stuv
