#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include "core/rig.h"

namespace stuv::synthetic {

/// Standard deviations of what differs from camera to camera; all Gaussian and independent.
struct JitterOptions {
  std::array<double, 3> position_m = {0.001, 0.001, 0.001};  ///< along s, t and z
  double direction_rad = 0.01;                               ///< about each axis
  double focal_relative = 0.005;
  double principal_point_px = 3;
  std::array<double, 4> distortion = {0.005, 0.003, 0.0003, 0.0003};  ///< of k1, k2, p1, p2
  double gain_relative = 0.02;
  double vignetting = 0.03;
  double time_skew_ns = 0;          ///< of the moment of exposure
  double colour_gain_relative = 0;  ///< of each channel, beside the gain
  double offset = 0;                ///< of stored values, 0..1
};

struct RigOptions {
  std::uint64_t seed = 1;
  int rows = 5, cols = 5;
  std::array<double, 2> spacing_m = {0.03, 0.03};  ///< between columns, between rows
  int width = 640, height = 480;
  double focal_px = 600;
  std::array<double, 4> distortion = {-0.08, 0.02, 0, 0};  ///< mean k1, k2, p1, p2 (LENSMODEL_OPENCV4)
  double vignetting = 0.15;                                ///< mean loss of light in the picture's corners
  double offset = 0;                                       ///< mean, added to stored values, 0..1
  std::vector<std::string> missing;                        ///< names of places without a camera: r0c1
  JitterOptions jitter;
};

/// The rig as it truly is. Its frame is the nominal lattice's: origin in its middle, x (= s) along the rows
/// to the right, y (= t) down, z into the scene.
struct TrueRig {
  Rig rig;
  // One per camera, in the order of rig.cameras:
  std::vector<double> gain;
  std::vector<std::array<double, 3>> colour_gain;
  std::vector<double> offset;
  std::vector<double> vignetting;
  std::vector<std::int64_t> time_skew_ns;
};

/// "" if the options can be used, else the value and the constraint it breaks.
std::string problem_of(const RigOptions& options);

/// Builds poses and lenses from the options; cameras are named r{row}c{col}, row by row. The same camera gets
/// the same values whichever others are missing. Throws std::invalid_argument if problem_of() has one.
TrueRig make_rig(const RigOptions& options);

}  // namespace stuv::synthetic
