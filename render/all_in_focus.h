#pragma once

#include <vector>

#include "core/progress.h"
#include "render/focal_plane.h"

namespace stuv {

/// The paper's parameters, with its values as defaults.
struct LiteralOptions {
  int planes = 13;                   ///< N
  int window = 7;                    ///< M: the window has (2M + 1)^2 pixels
  double a01 = 1, a02 = 1, a12 = 0;  ///< a_kl of equation 5; filters are numbered normal, wide, skipped
  Filter k = Filter::normal;         ///< the filter of the picture, equation 8
  double d_min = 0, d_max = 0;       ///< disparity of the farthest and the nearest plane [px per unit of s]
};

/// Throws std::invalid_argument naming the value: planes >= 1, window >= 0, a_kl >= 0 and one of them > 0, a
/// finite d_min <= d_max.
void validate(const LiteralOptions& options);

/// Disparity of plane n of N, even in disparity, both ends included; plane 0 is the farthest. N = 1: the
/// middle.
double plane_disparity(const LiteralOptions& options, int n);

/// All-in-focus view synthesis, the 2003 paper's equations as they stand (method `literal`): with I_k^n the
/// view through filter k focused on plane n,
///
///   (5)  E_0^n(x, y) = sum over k < l of a_kl | I_k^n(x, y) - I_l^n(x, y) |, summed over channels
///   (6)  E^n(x, y) = sum over -M <= i, j <= M of E_0^n(x + i, y + j)
///   (7)  n(x, y) = argmin over n of E^n(x, y)
///   (8)  I(x, y) = I_k^{n(x, y)}(x, y)
///
/// Where the paper is silent: of equal minima the farther plane. E_0^n is not defined where a filter that
/// takes part keeps less than half its weight (the others see outside their pictures); equation 6 is then the
/// mean over the defined pixels of the window, which is cut at the picture's border: the same minimum
/// wherever all are defined. A plane is a candidate at a pixel where filter k has a sample. If E^n is defined
/// for none, the farthest candidate, confidence 0; without candidate: black, plane -1, disparity NaN,
/// confidence 0. confidence = coverage (1 - min_n E^n / mean_n E^n) inside the hull of the cameras, else 0; 0
/// if all E^n are 0. Source: Takahashi, Kubota, Naemura, ICAT 2003, equations 5 to 8. Throws
/// std::invalid_argument as validate() does.
RenderedView all_in_focus(FocalPlaneRenderer& renderer, const Viewpoint& view, const LiteralOptions& options,
                          const Reporter& reporter = {});

/// The view on one focal plane in the same form: plane 0, confidence = coverage inside the hull.
RenderedView focal_plane(FocalPlaneRenderer& renderer, const Viewpoint& view, double d_px, Filter filter);

}  // namespace stuv
