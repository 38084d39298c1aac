#pragma once

#include <cstdint>
#include <mutex>
#include <string>
#include <vector>

#include "capture/cameras/camera_source.h"
#include "capture/cameras/set_matcher.h"
#include "core/json.h"

namespace stuv {

/// Counts what becomes of every frame; used from the polling thread and from the recording one.
struct CameraTally {
  std::string name;
  std::size_t frames = 0;      ///< delivered by the driver
  std::size_t dropped = 0;     ///< gaps in the driver's sequence numbers
  std::size_t duplicates = 0;  ///< numbers that came again
  std::size_t flawed = 0;      ///< delivered with an error flag or too few bytes
  std::size_t recorded = 0;    ///< handed over in sets, good or flawed
  std::size_t unmatched = 0;   ///< no set had a place for it
  std::size_t queue_full = 0;  ///< in sets that were dropped because the disk was too slow
  std::size_t lost = 0;        ///< how often it failed while streaming
  std::int64_t clock_offset_ns = 0;
  std::int64_t first_ns = 0, last_ns = 0;
  std::string trouble;
};

struct SetTally {
  std::size_t complete = 0, incomplete = 0, queue_full = 0;
  std::vector<std::int64_t> skews_ns;  ///< of complete sets: last minus first frame
};

/// The report; see docs/formats.md, `report.json` of a recording.
Json report_of(const std::vector<CameraTally>& cameras, const SetTally& sets, const MotionOptions& motion,
               int width, double seconds);

}  // namespace stuv
