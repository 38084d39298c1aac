#include "capture/synthetic/lens_grid.h"

namespace stuv::synthetic {
LensGrid::LensGrid(const Camera& camera)
    : columns_(camera.width / kStep + 2 * kMargin + 2), rows_(camera.height / kStep + 2 * kMargin + 2) {
  std::vector<Eigen::Vector2d> pixels;
  for (int row = 0; row < rows_; ++row)
    for (int column = 0; column < columns_; ++column)
      pixels.emplace_back((column - kMargin) * kStep, (row - kMargin) * kStep);
  for (const Eigen::Vector3d& ray : unproject(camera, pixels)) nodes_.emplace_back(ray.hnormalized());
}

LensGrid::Row::Row(const LensGrid& grid, double y_px) {
  const double y = y_px / kStep + kMargin;
  const int first = std::clamp(static_cast<int>(std::floor(y)) - 1, 0, grid.rows_ - 4);
  const std::array<double, 4> weights = cubic_weights(y - first - 1);
  nodes_.assign(static_cast<std::size_t>(grid.columns_), Eigen::Vector2d::Zero());
  for (std::size_t k = 0; k < 4; ++k) {
    const Eigen::Vector2d* from = &grid.nodes_[(static_cast<std::size_t>(first) + k) * nodes_.size()];
    for (std::size_t i = 0; i < nodes_.size(); ++i) nodes_[i] += weights[k] * from[i];
  }
}

}  // namespace stuv::synthetic
