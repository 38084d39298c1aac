#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include "capture/v4l2/v4l2_file.h"

namespace stuv {

struct ControlInfo {
  std::uint32_t id = 0;
  std::string name;  ///< as v4l2-ctl writes it: "exposure_time_absolute"
  std::int64_t least = 0, most = 0, normal = 0;
};

/// Controls of whole numbers, switches and menus that the driver has and lets us set.
std::vector<ControlInfo> list_controls(const V4l2File& file);

/// A control that was set, and what the device says it is now.
struct ControlState {
  std::string name;
  std::int64_t wanted = 0, actual = 0;
};

/// Sets controls and reads them back. `exposure`, `gain`, `white_balance` and `focus` stand for whichever
/// control of that kind the driver has, and switch its automatic off first. Throws Error naming `camera` for
/// a control that the driver does not have or refuses.
std::vector<ControlState> set_controls(const V4l2File& file,
                                       const std::map<std::string, std::int64_t>& wanted,
                                       const std::string& camera, const std::string& device);

/// The value of a control; none if the driver does not have it.
bool read_control(const V4l2File& file, std::uint32_t id, std::int64_t& value);

}  // namespace stuv
