#pragma once

#include <string>

#include "calib/solve/calibrate.h"

namespace stuv {

/// The contents of RIG/report.json; numbers that were not determined are null.
Json report_json(const Calibration& calibration, double seconds, double seconds_corners);

/// RIG/report.html: one page that needs nothing else. Verdict, layout, residuals, coverage, cameras.
std::string report_page(const Calibration& calibration);

}  // namespace stuv
