#pragma once

#include <string>

#include "calib/solve/calibrate.h"

namespace stuv {

/// The contents of RIG/report.json; numbers that were not determined are null.
Json report_json(const Calibration& calibration, double seconds, double seconds_corners);

/// Covariance of a lens's parameters, in the order of Camera::intrinsics, from that camera's entry in a
/// report.json; empty where it is not known.
Eigen::MatrixXd lens_covariance_of(const Json& camera);

/// RIG/report.html: one page that needs nothing else. Verdict, layout, residuals, coverage, cameras.
std::string report_page(const Calibration& calibration);

}  // namespace stuv
