#pragma once

#include <string>
#include <vector>

#include "core/light_field.h"

namespace stuv {

/// The flags that say where a scene lies; empty: not given.
struct RangeFlags {
  std::string disparity, depth_m;
  std::vector<std::string> leave_out;  ///< cameras not to look at
};

struct SearchRange {
  double d_min = 0, d_max = 0;  ///< [px per unit of s]
  std::string from;             ///< in words: the flags, the scene or the pictures
};

/// By the flags, or the scene's own, or estimated from the pictures. Throws UsageError for flags that make no
/// sense, Error if the pictures do not tell.
SearchRange search_range(const LightFieldReader& reader, const RangeFlags& flags);

}  // namespace stuv
