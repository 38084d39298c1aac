#pragma once

#include <Eigen/Dense>

namespace stuv::synthetic {

// Procedural patterns, linear light, band-limited: `step` is the distance between samples on the surface [m],
// and what is finer than about two steps fades to its mean.

using Colour = Eigen::Vector3f;

Colour bricks(double x, double y, double step);
Colour plaster(double x, double y, double step);
Colour planks(double x, double z, double step);
Colour painting(double x, double y, double step);  ///< x, y in 0..1
Colour crate(double x, double y, const Eigen::Vector3d& p, double step);
Colour marble(const Eigen::Vector3d& p, double step);
Colour fabric(double along, double around, double step);
Colour striped_ball(const Eigen::Vector3d& unit, double step);

}  // namespace stuv::synthetic
