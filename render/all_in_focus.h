#pragma once

#include <vector>

#include "core/progress.h"
#include "render/focal_plane.h"
#include "render/renderer.h"

namespace stuv {

/// Throws std::invalid_argument naming the value: planes >= 1, window >= 0, a_kl >= 0 and one of them > 0, a
/// finite d_min <= d_max.
void validate(const RenderOptions& options);

/// Disparity of plane n of N, even in disparity, both ends included; plane 0 is the farthest. N = 1: the
/// middle.
double plane_disparity(const RenderOptions& options, int n);

/// All-in-focus view synthesis, the 2003 paper's equations as they stand (method `literal`): with I_k^n the
/// view through filter k focused on plane n,
///
///   (5)  E_0^n(x, y) = sum over k < l of a_kl | I_k^n(x, y) - I_l^n(x, y) |, summed over channels
///   (6)  E^n(x, y) = sum over -M <= i, j <= M of E_0^n(x + i, y + j)
///   (7)  n(x, y) = argmin over n of E^n(x, y)
///   (8)  I(x, y) = I_k^{n(x, y)}(x, y)
///
/// Where the paper is silent: of equal minima (tie_of) the farther plane. E_0^n is not defined where a filter
/// that takes part keeps less than half its weight (the others see outside their pictures); equation 6 is
/// then the mean over the defined pixels of the window, which is cut at the picture's border: the same
/// minimum wherever all are defined. A plane is a candidate at a pixel where filter k has a sample. If E^n is
/// defined for none, the farthest candidate, confidence 0; without candidate: black, plane -1, disparity NaN,
/// confidence 0. confidence = coverage (1 - min_n E^n / mean_n E^n) inside the hull of the cameras, else 0; 0
/// if all E^n are 0. Source: Takahashi, Kubota, Naemura, ICAT 2003, equations 5 to 8. Throws
/// std::invalid_argument as validate() does.
RenderedView all_in_focus(FocalPlaneRenderer& renderer, const Viewpoint& view, const RenderOptions& options,
                          const Reporter& reporter = {});

/// The view on one focal plane in the same form: plane 0, confidence = coverage inside the hull.
RenderedView focal_plane(FocalPlaneRenderer& renderer, const Viewpoint& view, double d_px, Filter filter);

/// E^n of equation 6 of one plane, per pixel; Inf where it is not defined.
Raster<double> focus_cost(FocalPlaneRenderer& renderer, const Viewpoint& view, const RenderOptions& options,
                          int n);

/// Costs of integer pictures that differ by no more are equal: the rounding of float is larger. Float
/// pictures have no full scale; there equal means equal.
inline double tie_of(PixelType type) { return type == PixelType::u8 || type == PixelType::u16 ? 1e-6 : 0; }

/// Method `literal` on the planes that `planes` makes.
std::unique_ptr<Renderer> make_literal_renderer(std::unique_ptr<FocalPlaneRenderer> planes);

}  // namespace stuv
