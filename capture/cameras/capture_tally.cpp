#include "capture/cameras/capture_tally.h"

#include <algorithm>

namespace stuv {
namespace {

/// The value below which a share of `sorted` lies (nearest rank).
double quantile(const std::vector<std::int64_t>& sorted, double share) {
  const auto rank = static_cast<std::size_t>(share * static_cast<double>(sorted.size() - 1) + 0.5);
  return static_cast<double>(sorted[rank]);
}

Json spread(const std::vector<std::int64_t>& sorted, double factor) {
  if (sorted.empty()) return {{"median", nullptr}, {"p95", nullptr}, {"worst", nullptr}};
  return {{"median", factor * quantile(sorted, 0.5)},
          {"p95", factor * quantile(sorted, 0.95)},
          {"worst", factor * static_cast<double>(sorted.back())}};
}

Json camera_report(const CameraTally& tally) {
  const double span_s = 1e-9 * static_cast<double>(tally.last_ns - tally.first_ns);
  // Before the first set, after the last one, or behind the end of the recording.
  const std::size_t placed = tally.recorded + tally.unmatched + tally.queue_full + tally.duplicates;
  const std::size_t outside = tally.frames - std::min(tally.frames, placed);
  const auto periods = static_cast<double>(tally.frames + tally.dropped) - 1;
  Json json = {{"name", tally.name},
               {"frames", tally.frames},
               {"dropped", tally.dropped},
               {"duplicates", tally.duplicates},
               {"flawed", tally.flawed},
               {"recorded", tally.recorded},
               {"outside", outside},
               {"unmatched", tally.unmatched},
               {"queue_full", tally.queue_full},
               {"lost", tally.lost},
               {"fps", span_s > 0 && periods > 0 ? Json(periods / span_s) : Json()},
               {"clock_offset_ns", tally.clock_offset_ns}};
  if (!tally.trouble.empty()) json["trouble"] = tally.trouble;
  return json;
}

}  // namespace

Json report_of(const std::vector<CameraTally>& cameras, const SetTally& sets, const MotionOptions& motion,
               int width, double seconds) {
  std::vector<std::int64_t> sorted = sets.skews_ns;
  std::sort(sorted.begin(), sorted.end());
  const double focal_px = motion.focal_px > 0 ? motion.focal_px : width;
  Json list = Json::array();
  for (const CameraTally& tally : cameras) list.push_back(camera_report(tally));
  return {
      {"format", "stuv.capture_report"},
      {"version", 1},
      {"seconds", seconds},
      {"sets",
       {{"complete", sets.complete},
        {"incomplete", sets.incomplete},
        {"dropped_queue_full", sets.queue_full}}},
      {"skew_ms", spread(sorted, 1e-6)},
      {"motion",
       {{"speed_m_per_s", motion.speed_m_per_s}, {"distance_m", motion.distance_m}, {"focal_px", focal_px}}},
      {"skew_px", spread(sorted, 1e-9 * motion.speed_m_per_s * focal_px / motion.distance_m)},
      {"cameras", list}};
}

}  // namespace stuv
