#include "app/search_range.h"

#include "app/console.h"
#include "core/error.h"
#include "render/plan/depth_range.h"

namespace stuv {

SearchRange search_range(const LightFieldReader& reader, const RangeFlags& flags) {
  const LightField& lf = reader.light_field();
  if (!flags.disparity.empty() && !flags.depth_m.empty())
    throw UsageError("--disparity and --depth-m exclude each other");
  if (!flags.disparity.empty()) {
    const auto [d_min, d_max] = parse_disparity(flags.disparity);
    return {d_min, d_max, "as given"};
  }
  if (!flags.depth_m.empty()) {
    if (!lf.metric)
      throw UsageError("--depth-m needs metres, which this scene does not have; use --disparity");
    const auto [near_m, far_m] = parse_pair("--depth-m", flags.depth_m);
    if (!(near_m > 0 && near_m <= far_m)) throw UsageError("--depth-m wants 0 < NEAR <= FAR");
    return {lf.disparity(1 / far_m), lf.disparity(1 / near_m), "as given"};
  }
  if (lf.has_range()) return {lf.d_min, lf.d_max, "the scene's own"};
  const DepthRange range = estimate_depth_range(open_views(reader, flags.leave_out));
  if (!range.found)
    throw Error(lf.folder.string(),
                "states no range of disparity, and its pictures show too little to tell one",
                "give --disparity MIN,MAX");
  return {range.d_min, range.d_max, "from the pictures"};
}

}  // namespace stuv
