#pragma once

#include <string>
#include <vector>

namespace stuv {

/// One marker's code, row by row from the top left; true is white. Outside comes the black border.
struct MarkerBits {
  int size = 0;  ///< bits along a side
  std::vector<bool> white;
};

/// Number of markers in OpenCV's dictionary of that name (DICT_4X4_50 ..); 0 if there is none such.
int dictionary_size(const std::string& name);

/// What OpenCV's aruco module calls the dictionary; -1 if it has none such.
int dictionary_index(const std::string& name);

/// Throws std::invalid_argument if dictionary or id do not exist.
MarkerBits marker_bits(const std::string& dictionary, int id);

/// The dictionary of Kalibr's boards, 587 tags, and the width of their border in bits.
inline constexpr const char* kAprilGridDictionary = "DICT_APRILTAG_36h11";
inline constexpr int kAprilGridBorder = 2;

}  // namespace stuv
