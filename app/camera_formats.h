#pragma once

#include <string>

#include "calib/interchange/camera_list.h"
#include "core/json.h"
#include "core/progress.h"

namespace stuv {

/// "mrcal, opencv, ..." for help and errors, and back. Throws UsageError naming the flag.
std::string format_names();
CameraFormat parse_camera_format(const std::string& flag, const std::string& text);

/// Which lenses were fitted and how well: a warning each, and for --json.
void print_fits(const LensFits& fits, const Reporter& reporter);
Json fits_json(const LensFits& fits);

}  // namespace stuv
