#pragma once

#include <vector>

#include "core/light_field.h"

namespace stuv {

/// What plenoptic sampling is asked about. Inverse depths in 1/m, or, for scenes without metres, in any unit
/// whose product with the spacing's has none.
struct SamplingProblem {
  int rows = 1, cols = 1;
  double spacing_s = 0, spacing_t = 0;       ///< of the cameras; 0 where there is one row (column)
  double inverse_far = 0, inverse_near = 0;  ///< 1 / z_max and 1 / z_min; far may be 0, infinity
  double bandwidth = 0;  ///< K_fu f: highest frequency of the views [cycles per unit tangent]
};

/// A focal plane and the depths at which the three filters still agree about it.
struct FocalPlane {
  double inverse_depth = 0, inverse_far = 0, inverse_near = 0;
};

struct SamplingPlan {
  /// Equation 2: with more cameras than this far apart a plain light field shows ghosts. Inf: any will do.
  double max_spacing = 0;
  /// Cameras that a plain light field of this extent needs: rows ceil(Dt / max) x cols ceil(Ds / max).
  double cameras_needed = 0;
  double factor = 1;  ///< of the cameras there are
  /// Equation 3: the one best focal plane.
  double inverse_optimum = 0;
  /// Equation 4: the range of inverse depth that three filters can tell about at once, and whether the
  /// scene's fits.
  double three_filter_range = 0;
  bool one_plane_is_enough = false;
  double max_spacing_three_filters = 0;
  /// Far to near, even in inverse depth, both ends included: each covers three_filter_range, so everything
  /// is in focus in at least one. At least one.
  std::vector<FocalPlane> planes;
};

/// Plenoptic sampling. Source: Takahashi, Kubota, Naemura, ICAT 2003, equations 2 to 4:
///
///   (2) Ds <= 1 / (K_fu f (1/z_min - 1/z_max))   (3) 1/z_opt = (1/z_min + 1/z_max) / 2
///   (4) 1/z_min - 1/z_max <= 1 / (2 K_fu f Ds)
///
/// Throws std::invalid_argument naming what is not positive, finite or in order, and if more than a million
/// planes came out.
SamplingPlan plan_sampling(const SamplingProblem& problem);

/// The problem of a light field whose scene lies between two disparities. The views' bandwidth is half a
/// cycle a pixel, f / 2.
SamplingProblem sampling_problem(const LightField& lf, double d_min, double d_max);

/// Mean distance of neighbours along rows and along columns, 0 where there is one column (row).
std::pair<double, double> lattice_spacing(const LightField& lf);

/// Number of focal planes between two disparities so that everything is in focus in one: about one px of
/// disparity between neighbouring cameras apart. 1 to kMostPlanes.
inline constexpr int kMostPlanes = 1000;
int planes_needed(const LightField& lf, double d_min, double d_max);

}  // namespace stuv
