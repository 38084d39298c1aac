#pragma once

#include <Eigen/Dense>
#include <vector>

namespace stuv {

/// Rows and columns of points that stand roughly on a grid.
struct LatticePlaces {
  int rows = 0, cols = 0;
  std::vector<int> row, col;  ///< of each point: col grows with x, row with y
};

/// Clusters the points' x into columns and their y into rows: sorted neighbours that lie further apart than
/// half the median distance to the nearest point part two clusters. A line on which no point stands is not
/// counted. Two points may share a place.
LatticePlaces places_on_lattice(const std::vector<Eigen::Vector2d>& points);

/// Angle by which the grid is turned against the axes, -pi/4..pi/4 [rad]: the mean of the directions to the
/// nearest point, taken modulo a right angle.
double lattice_angle(const std::vector<Eigen::Vector2d>& points);

}  // namespace stuv
