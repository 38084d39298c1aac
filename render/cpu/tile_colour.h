#pragma once

#include "render/cpu/tile_plan.h"

namespace stuv {

/// Brightness, as costs see it.
inline float brightness(const float* rgb) { return 0.25F * (rgb[0] + 2 * rgb[1] + rgb[2]); }

/// Rms over channels and those of `cells` whose colour is known of what brightness does not say about a
/// colour: its distance from mean + slope (Y - mean Y), Y being the brightness and slope the best one for
/// these cells, cov(colour, Y) / var Y. Bricks and mortar lie near such a line; leaves before blue tiles as
/// bright as they are do not, and costs of brightness would not tell one from the other.
double colour_beside_brightness(const Expectation& expected, const PixelRect& cells);

/// From there on costs have to see colour.
inline constexpr double kLeastColour = 3.0 / 255;

}  // namespace stuv
