#include "render/lattice_chart.h"

#include <algorithm>
#include <cmath>
#include <set>

namespace stuv {
namespace {

double cross(const Eigen::Vector2d& a, const Eigen::Vector2d& b) { return a.x() * b.y() - a.y() * b.x(); }

double snapped(double value) {
  const double whole = std::round(value);
  return std::abs(value - whole) < LatticeChart::kSnap ? whole : value;
}

/// Cameras of one row or one column determine one direction only.
bool one_dimensional(const std::vector<View>& cameras) {
  std::set<int> rows, cols;
  for (const View& c : cameras) {
    rows.insert(c.row);
    cols.insert(c.col);
  }
  return rows.size() == 1 || cols.size() == 1;
}

}  // namespace

LatticeChart::LatticeChart(int rows, int cols, const std::vector<View>& cameras) : rows_(rows), cols_(cols) {
  planar_ = std::all_of(cameras.begin(), cameras.end(), [](const View& c) { return c.w == 0; });
  fit_affine(cameras);
  fill_nodes(cameras);
  build_hull(cameras);
}

void LatticeChart::fit_affine(const std::vector<View>& cameras) {
  const int n = static_cast<int>(cameras.size());
  Eigen::MatrixXd from(n, 2), to(n, 2);
  for (int i = 0; i < n; ++i) {
    const View& c = cameras[static_cast<std::size_t>(i)];
    from.row(i) << c.s, c.t;
    to.row(i) << c.col, c.row;
  }
  const Eigen::RowVector2d from_mean = from.colwise().mean(), to_mean = to.colwise().mean();
  from.rowwise() -= from_mean;
  to.rowwise() -= to_mean;
  // Pseudo-inverse by hand: the small axis of a row of cameras is jitter, not geometry.
  const Eigen::JacobiSVD<Eigen::MatrixXd> svd(from, Eigen::ComputeThinU | Eigen::ComputeThinV);
  const Eigen::VectorXd& sigma = svd.singularValues();
  const int usable = one_dimensional(cameras) ? 1 : 2;
  Eigen::Matrix2d linear = Eigen::Matrix2d::Zero();
  for (int k = 0; k < std::min<int>(usable, static_cast<int>(sigma.size())); ++k)
    if (sigma[k] > 1e-9 * sigma[0] && sigma[k] > 0)
      linear += to.transpose() * svd.matrixU().col(k) * svd.matrixV().col(k).transpose() / sigma[k];
  // Across a line of cameras the same scale as along it: tells how far off the line a ray crosses.
  if (n == 1) {
    linear.setIdentity();
  } else if (usable == 1) {
    const Eigen::Vector2d v = svd.matrixV().col(0), along = linear * v;
    linear += Eigen::Vector2d(-along.y(), along.x()) * Eigen::RowVector2d(-v.y(), v.x());
  }
  affine_.leftCols<2>() = linear;
  affine_.col(2) = to_mean.transpose() - linear * from_mean.transpose();
}

void LatticeChart::fill_nodes(const std::vector<View>& cameras) {
  const auto index = [&](int row, int col) { return static_cast<std::size_t>(row * cols_ + col); };
  nodes_.assign(static_cast<std::size_t>(rows_ * cols_), Eigen::Vector3d::Zero());
  std::vector<char> known(nodes_.size(), 0);
  for (const View& c : cameras) {
    const Eigen::Vector2d e = affine_ * Eigen::Vector3d(c.s, c.t, 1) - Eigen::Vector2d(c.col, c.row);
    nodes_[index(c.row, c.col)] << e.x(), e.y(), c.w;
    known[index(c.row, c.col)] = 1;
  }
  // A hole takes the mean of its known neighbours, from the rim inwards.
  while (std::find(known.begin(), known.end(), 0) != known.end()) {
    const std::vector<char> before = known;
    for (int row = 0; row < rows_; ++row) {
      for (int col = 0; col < cols_; ++col) {
        if (before[index(row, col)]) continue;
        Eigen::Vector3d sum = Eigen::Vector3d::Zero();
        int count = 0;
        for (int r = std::max(row - 1, 0); r <= std::min(row + 1, rows_ - 1); ++r)
          for (int c = std::max(col - 1, 0); c <= std::min(col + 1, cols_ - 1); ++c)
            if (before[index(r, c)]) sum += nodes_[index(r, c)], ++count;
        if (count == 0) continue;
        nodes_[index(row, col)] = sum / count;
        known[index(row, col)] = 1;
      }
    }
  }
}

/// Andrew's monotone chain; points on the boundary are left out of it.
void LatticeChart::build_hull(const std::vector<View>& cameras) {
  std::vector<Eigen::Vector2d> points;
  for (const View& c : cameras) points.emplace_back(c.col, c.row);
  low_ = high_ = points.front();
  for (const auto& p : points) low_ = low_.cwiseMin(p), high_ = high_.cwiseMax(p);
  std::sort(points.begin(), points.end(),
            [](const auto& a, const auto& b) { return a.x() < b.x() || (a.x() == b.x() && a.y() < b.y()); });
  const auto half = [&](auto begin, auto end) {
    const std::size_t base = hull_.size();
    for (auto it = begin; it != end; ++it) {
      while (hull_.size() >= base + 2 &&
             cross(hull_.back() - hull_[hull_.size() - 2], *it - hull_[hull_.size() - 2]) <= 0)
        hull_.pop_back();
      hull_.push_back(*it);
    }
    hull_.pop_back();
  };
  half(points.begin(), points.end());
  half(points.rbegin(), points.rend());
}

LatticeChart::Interpolated LatticeChart::node_at(const Eigen::Vector2d& p) const {
  const double x = std::clamp(p.x(), 0.0, cols_ - 1.0), y = std::clamp(p.y(), 0.0, rows_ - 1.0);
  const int x0 = std::min(static_cast<int>(x), std::max(cols_ - 2, 0));
  const int y0 = std::min(static_cast<int>(y), std::max(rows_ - 2, 0));
  const int x1 = std::min(x0 + 1, cols_ - 1), y1 = std::min(y0 + 1, rows_ - 1);
  const double ax = x - x0, ay = y - y0;
  const auto node = [&](int col, int row) -> const Eigen::Vector3d& {
    return nodes_[static_cast<std::size_t>(row * cols_ + col)];
  };
  const Eigen::Vector3d upper = (1 - ax) * node(x0, y0) + ax * node(x1, y0);
  const Eigen::Vector3d lower = (1 - ax) * node(x0, y1) + ax * node(x1, y1);
  Interpolated out;
  out.value = (1 - ay) * upper + ay * lower;
  out.gradient.setZero();  // beyond the lattice the border value goes on
  if (x == p.x())
    out.gradient.col(0) = (1 - ay) * (node(x1, y0) - node(x0, y0)) + ay * (node(x1, y1) - node(x0, y1));
  if (y == p.y()) out.gradient.col(1) = lower - upper;
  return out;
}

Eigen::Vector2d LatticeChart::position(const Eigen::Vector3d& o, double gx, double gy) const {
  const auto at = [&](double z) -> Eigen::Vector2d {
    return affine_ * Eigen::Vector3d(o.x() + (z - o.z()) * gx, o.y() + (z - o.z()) * gy, 1);
  };
  const Eigen::Vector2d along_ray = affine_.leftCols<2>() * Eigen::Vector2d(gx, gy);
  Eigen::Vector2d p = at(0);
  for (int i = 0; i < kIterations; ++i) {
    const Interpolated node = node_at(p);
    const Eigen::Vector2d f = p + node.value.head<2>() - at(node.value.z());
    const Eigen::Matrix2d J =
        Eigen::Matrix2d::Identity() + node.gradient.topRows<2>() - along_ray * node.gradient.row(2);
    Eigen::Vector2d step = J.determinant() > kLeastDeterminant ? Eigen::Vector2d(J.inverse() * f) : f;
    // Newton's method may go to and fro between two cells of a piecewise function: shorter steps end that.
    if (i >= kIterations / 2) step *= 0.5;
    p -= step;
    if (step.norm() < 1e-14) break;
  }
  return {snapped(p.x()), snapped(p.y())};
}

bool LatticeChart::inside_hull(const Eigen::Vector2d& p) const {
  const bool one_col = low_.x() == high_.x(), one_row = low_.y() == high_.y();
  // A line of cameras holds one spacing to both sides; a single camera has none.
  const double beside = one_col && one_row ? kSnap : 1 + kSnap;
  const Eigen::Vector2d margin(one_col ? beside : kSnap, one_row ? beside : kSnap);
  if (((p - low_ + margin).array() < 0).any() || ((high_ - p + margin).array() < 0).any()) return false;
  if (one_col || one_row) return true;
  for (std::size_t i = 0; i < hull_.size(); ++i) {
    const Eigen::Vector2d edge = hull_[(i + 1) % hull_.size()] - hull_[i];
    if (cross(edge, p - hull_[i]) < -kSnap * edge.norm()) return false;
  }
  return true;
}

namespace {

/// Present cameras of the (thinned) lattice, -1 where there is none.
struct Occupancy {
  int rows = 0, cols = 0;
  std::vector<int> camera;

  int at(int row, int col) const {
    if (row < 0 || row >= rows || col < 0 || col >= cols) return -1;
    return camera[static_cast<std::size_t>(row * cols + col)];
  }
};

/// The next present camera from a node in one direction, and how many steps away; -1, 0 if there is none.
std::pair<int, int> next_present(const Occupancy& o, int row, int col, int d_row, int d_col) {
  for (int k = 1; k < std::max(o.rows, o.cols); ++k)
    if (const int camera = o.at(row + k * d_row, col + k * d_col); camera >= 0) return {camera, k};
  return {-1, 0};
}

int nearest_present(const Occupancy& o, int row, int col) {
  int best = -1, best_distance = 0;
  for (int r = 0; r < o.rows; ++r) {
    for (int c = 0; c < o.cols; ++c) {
      const int distance = (r - row) * (r - row) + (c - col) * (c - col);
      if (o.at(r, c) < 0 || (best >= 0 && distance >= best_distance)) continue;
      best = o.at(r, c);
      best_distance = distance;
    }
  }
  return best;
}

std::vector<CameraWeight> bridge(const Occupancy& o, int row, int col) {
  if (const int camera = o.at(row, col); camera >= 0) return {{camera, 1.0}};
  std::vector<CameraWeight> bracketed, one_sided;
  for (const auto& [d_row, d_col] : {std::pair(0, 1), std::pair(1, 0)}) {
    const auto [before, steps_before] = next_present(o, row, col, -d_row, -d_col);
    const auto [after, steps_after] = next_present(o, row, col, d_row, d_col);
    if (before >= 0 && after >= 0) {
      const double span = steps_before + steps_after;
      bracketed.push_back({before, steps_after / span});
      bracketed.push_back({after, steps_before / span});
    } else if (before >= 0 || after >= 0) {
      one_sided.push_back({std::max(before, after), 1.0});
    }
  }
  std::vector<CameraWeight> out = bracketed.empty() ? one_sided : bracketed;
  if (out.empty()) {
    const int nearest = nearest_present(o, row, col);
    if (nearest < 0) return {};
    out.push_back({nearest, 1.0});
  }
  double sum = 0;
  for (const CameraWeight& c : out) sum += c.weight;
  for (CameraWeight& c : out) c.weight /= sum;
  return out;
}

void add_weight(std::vector<CameraWeight>& out, int camera, double weight) {
  for (CameraWeight& c : out)
    if (c.camera == camera) {
      c.weight += weight;
      return;
    }
  out.push_back({camera, weight});
}

}  // namespace

LatticeFilter::LatticeFilter(int rows, int cols, const std::vector<View>& cameras, Filter filter)
    : full_rows_(rows), full_cols_(cols) {
  stride_ = filter == Filter::skipped ? 2 : 1;
  half_width_ = filter == Filter::wide ? 2 : 1;
  rows_ = (rows + stride_ - 1) / stride_;
  cols_ = (cols + stride_ - 1) / stride_;
  const auto occupy = [&](int stride) {
    Occupancy o{rows_, cols_, std::vector<int>(static_cast<std::size_t>(rows_ * cols_), -1)};
    for (std::size_t i = 0; i < cameras.size(); ++i)
      if (cameras[i].row % stride == 0 && cameras[i].col % stride == 0)
        o.camera[static_cast<std::size_t>(cameras[i].row / stride * cols_ + cameras[i].col / stride)] =
            static_cast<int>(i);
    return o;
  };
  Occupancy present = occupy(stride_);
  // Holes may take every camera of the thinned lattice away: each of its nodes then stands on what is next to
  // it.
  if (std::all_of(present.camera.begin(), present.camera.end(), [](int c) { return c < 0; }))
    for (std::size_t i = 0; i < cameras.size(); ++i)
      present.camera[static_cast<std::size_t>(cameras[i].row / stride_ * cols_ + cameras[i].col / stride_)] =
          static_cast<int>(i);
  for (int row = 0; row < rows_; ++row)
    for (int col = 0; col < cols_; ++col) bridges_.push_back(bridge(present, row, col));
}

void LatticeFilter::weights(Eigen::Vector2d p, std::vector<CameraWeight>& out) const {
  out.clear();
  p.x() = std::clamp(p.x(), 0.0, full_cols_ - 1.0) / stride_;
  p.y() = std::clamp(p.y(), 0.0, full_rows_ - 1.0) / stride_;
  const auto tent = [&](int node, double at, int size) {
    return size == 1 ? 1.0 : std::max(0.0, 1 - std::abs(node - at) / half_width_);
  };
  const int reach = static_cast<int>(half_width_);
  const int col0 = static_cast<int>(p.x()) - reach + 1, row0 = static_cast<int>(p.y()) - reach + 1;
  for (int row = std::max(row0, 0); row <= std::min(row0 + 2 * reach - 1, rows_ - 1); ++row) {
    const double w_row = tent(row, p.y(), full_rows_);
    for (int col = std::max(col0, 0); col <= std::min(col0 + 2 * reach - 1, cols_ - 1); ++col) {
      const double weight = w_row * tent(col, p.x(), full_cols_);
      if (weight <= 0) continue;
      for (const CameraWeight& c : bridges_[static_cast<std::size_t>(row * cols_ + col)])
        add_weight(out, c.camera, weight * c.weight);
    }
  }
  double sum = 0;
  for (const CameraWeight& c : out) sum += c.weight;
  for (CameraWeight& c : out) c.weight /= sum;
}

}  // namespace stuv
