#include "calib/rectify/lens_map.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

#include "calib/rectify/warp_kernels.h"

namespace stuv {
namespace {

struct Field {
  double pixel_limit, node_limit;  ///< cosines, see LensMap
};

/// Lens models are polynomials: beyond some angle their projection turns back towards the middle, and would
/// show the picture a second time.
Field field_of(const Camera& camera) {
  constexpr int kAzimuths = 72, kSteps = 720;
  const auto inside = [&](const Eigen::Vector2d& q) {
    return q.x() >= 0 && q.y() >= 0 && q.x() <= camera.width - 1 && q.y() <= camera.height - 1;
  };
  const auto angle = [](int i) { return 0.5 * std::numbers::pi * i / kSteps; };
  double leaves = 0, turns_inside = angle(kSteps), turns = angle(kSteps - 1);
  for (int a = 0; a < kAzimuths; ++a) {
    const double azimuth = 2 * std::numbers::pi * a / kAzimuths;
    std::vector<Eigen::Vector3d> rays;
    for (int i = 0; i < kSteps; ++i)
      rays.emplace_back(std::sin(angle(i)) * std::cos(azimuth), std::sin(angle(i)) * std::sin(azimuth),
                        std::cos(angle(i)));
    const std::vector<Eigen::Vector2d> q = project(camera, rays);
    // From where the axis is seen, which splined models need not put at (cx, cy).
    const auto grows = [&](int i) { return (q[i] - q[0]).norm() > (q[i - 1] - q[0]).norm(); };
    int leave = 1;
    while (leave < kSteps && inside(q[leave]) && grows(leave)) ++leave;
    int turn = leave;
    while (turn < kSteps && grows(turn)) ++turn;
    if (leave < kSteps && inside(q[leave]))
      turns_inside = std::min(turns_inside, angle(leave));
    else
      leaves = std::max(leaves, angle(leave));
    turns = std::min(turns, angle(turn - 1));
  }
  // The corners lie between two azimuths: allow a degree more. A fold leaves no such room.
  return {std::cos(std::min(leaves + 0.02, turns_inside)), std::cos(turns)};
}

/// Weights of the cubic through the values at -1, 0, 1 and 2 (Lagrange), at t in 0..1.
std::array<double, 4> cubic_weights(double t) {
  return {-t * (t - 1) * (t - 2) / 6, (t + 1) * (t - 1) * (t - 2) / 2, -(t + 1) * t * (t - 2) / 2,
          (t + 1) * t * (t - 1) / 6};
}

/// The same cubic in powers of t.
void cubic_powers(double p0, double p1, double p2, double p3, float* out) {
  out[0] = static_cast<float>(p1);
  out[1] = static_cast<float>(-p0 / 3 - p1 / 2 + p2 - p3 / 6);
  out[2] = static_cast<float>(p0 / 2 - p1 + p2 / 2);
  out[3] = static_cast<float>((p3 - p0) / 6 + (p1 - p2) / 2);
}

}  // namespace

LensMap::LensMap(const Camera& camera, const CommonView& view) : camera_(camera), view_(view) {
  const Field field = field_of(camera);
  pixel_limit_ = field.pixel_limit;
  node_limit_ = field.node_limit;
  constexpr double kMostExact = 0.02;
  for (int step = kBlock; step >= 4; step /= 2) {
    make(step);
    if (exact_fraction() <= kMostExact) break;
  }
}

double LensMap::exact_fraction() const {
  const auto exact = static_cast<double>(std::count(cells_.begin(), cells_.end(), Cell::exact));
  const auto smooth = static_cast<double>(std::count(cells_.begin(), cells_.end(), Cell::smooth));
  return exact / std::max(1.0, exact + smooth);
}

Eigen::Vector3d LensMap::ray(double x, double y) const {
  return camera_.cam_from_rig.R *
         Eigen::Vector3d((x - view_.cx_px) / view_.focal_px, (y - view_.cy_px) / view_.focal_px, 1);
}

void LensMap::make_nodes() {
  std::vector<Eigen::Vector3d> rays;
  for (int j = -1; j < rows_ + 2; ++j)
    for (int i = -1; i < columns_ + 2; ++i) rays.push_back(ray(i * step_, j * step_).normalized());
  const std::vector<Eigen::Vector2d> q = project(camera_, rays);
  nodes_.resize(rays.size());
  for (std::size_t k = 0; k < rays.size(); ++k)
    nodes_[k] = {q[k], rays[k].z() > node_limit_ && q[k].allFinite()};
}

void LensMap::make(int step) {
  step_ = step;
  columns_ = (view_.width + step - 1) / step;
  rows_ = (view_.height + step - 1) / step;
  make_nodes();
  std::vector<Eigen::Vector3d> rays;
  for (int j = 0; j < rows_; ++j)
    for (int i = 0; i < columns_; ++i) rays.push_back(ray((i + 0.5) * step, (j + 0.5) * step).normalized());
  const std::vector<Eigen::Vector2d> centres = project(camera_, rays);
  cells_.resize(rays.size());
  for (int j = 0; j < rows_; ++j)
    for (int i = 0; i < columns_; ++i) cells_[j * columns_ + i] = kind_of(i, j, centres[j * columns_ + i]);
}

LensMap::Cell LensMap::kind_of(int column, int row, const Eigen::Vector2d& centre) const {
  const std::array<double, 4> w = cubic_weights(0.5);
  Eigen::Vector2d sum = Eigen::Vector2d::Zero();
  Eigen::AlignedBox2d box;
  for (int j = 0; j < 4; ++j)
    for (int i = 0; i < 4; ++i) {
      const Node& node = nodes_[(row + j) * (columns_ + 3) + column + i];
      if (!node.good) return Cell::exact;
      sum += w[i] * w[j] * node.q;
      // The cell is surrounded by its sixteen nodes with a step to spare.
      box.extend(node.q);
    }
  const Eigen::AlignedBox2d picture(Eigen::Vector2d(0, 0),
                                    Eigen::Vector2d(camera_.width - 1, camera_.height - 1));
  if (!box.intersects(picture)) return Cell::outside;
  constexpr double kMostSize_px = 1000;  // what positions() holds relative to a cell's corner
  if (box.sizes().maxCoeff() > kMostSize_px) return Cell::exact;
  return (sum - centre).norm() <= kMostError_px ? Cell::smooth : Cell::exact;
}

void LensMap::smooth_row(int column, int y, int columns, int width, std::int32_t* qx,
                         std::int32_t* qy) const {
  const int row = y / step_;
  const std::array<double, 4> w = cubic_weights(static_cast<double>(y - row * step_) / step_);
  const auto down = [&](int i) {
    const Node* n = &nodes_[static_cast<std::size_t>(row) * (columns_ + 3) + i];
    const int pitch = columns_ + 3;
    return Eigen::Vector2d(w[0] * n[0].q + w[1] * n[pitch].q + w[2] * n[2 * pitch].q + w[3] * n[3 * pitch].q);
  };
  Eigen::Vector2d p[4] = {{}, down(column), down(column + 1), down(column + 2)};
  for (int i = 0; i < columns; ++i) {
    std::copy(p + 1, p + 4, p);
    p[3] = down(column + i + 3);
    const int begin = i * step_, count = std::min(step_, width - begin);
    if (cells_[row * columns_ + column + i] != Cell::smooth) {
      std::fill_n(qx + begin, count, kNowhere);
      std::fill_n(qy + begin, count, kNowhere);
      continue;
    }
    warp_kernels::CubicRow cubic;
    // Relative to a whole pixel, so that single precision suffices.
    const Eigen::Vector2d base = p[1].array().floor();
    cubic.base_x = static_cast<std::int32_t>(base.x());
    cubic.base_y = static_cast<std::int32_t>(base.y());
    for (Eigen::Vector2d& v : p) v -= base;
    cubic_powers(p[0].x(), p[1].x(), p[2].x(), p[3].x(), cubic.x);
    cubic_powers(p[0].y(), p[1].y(), p[2].y(), p[3].y(), cubic.y);
    for (Eigen::Vector2d& v : p) v += base;
    warp_kernels::positions(cubic, step_, count, camera_.width, camera_.height, qx + begin, qy + begin);
  }
}

void LensMap::exact_cell(int x0, int y0, int x1, int y1, int left, int top, int stride, std::int32_t* qx,
                         std::int32_t* qy) const {
  std::vector<Eigen::Vector3d> rays;
  std::vector<int> where;
  for (int y = y0; y < y1; ++y)
    for (int x = x0; x < x1; ++x) {
      const Eigen::Vector3d r = ray(x, y).normalized();
      if (r.z() < pixel_limit_) continue;
      rays.push_back(r);
      where.push_back((y - top) * stride + x - left);
    }
  const std::vector<Eigen::Vector2d> q = project(camera_, rays);
  for (std::size_t k = 0; k < q.size(); ++k) {
    const double fx = std::round(q[k].x() * kPhases), fy = std::round(q[k].y() * kPhases);
    if (!(fx >= 0 && fy >= 0 && fx <= double(camera_.width - 1) * kPhases &&
          fy <= double(camera_.height - 1) * kPhases))
      continue;
    qx[where[k]] = static_cast<std::int32_t>(fx);
    qy[where[k]] = static_cast<std::int32_t>(fy);
  }
}

void LensMap::block(int x, int y, int width, int height, std::int32_t* qx, std::int32_t* qy) const {
  const int column = x / step_, columns = (width + step_ - 1) / step_;
  for (int j = 0; j < height; ++j)
    smooth_row(column, y + j, columns, width, qx + static_cast<std::size_t>(j) * width,
               qy + static_cast<std::size_t>(j) * width);
  for (int row = y / step_; row * step_ < y + height; ++row)
    for (int c = column; c < column + columns; ++c)
      if (cells_[row * columns_ + c] == Cell::exact)
        exact_cell(c * step_, row * step_, std::min((c + 1) * step_, x + width),
                   std::min((row + 1) * step_, y + height), x, y, width, qx, qy);
}

}  // namespace stuv
