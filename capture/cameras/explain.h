#pragma once

#include <filesystem>
#include <string>

#include "core/error.h"

namespace stuv {

/// "pid 123 (v4l2-ctl), ..." of the processes that hold `device` open, our own left out; "" if none can be
/// seen. `proc` is where the processes are listed.
std::string holders_of(const std::filesystem::path& device, const std::filesystem::path& proc = "/proc");

/// The Error for a system call on a camera that failed: what `error` (errno) means for cameras, and the next
/// step.
///   camera: as the user knows it; device: its file; what: "start streaming", for instance.
Error camera_error(const std::string& camera, const std::filesystem::path& device, const std::string& what,
                   int error);

}  // namespace stuv
