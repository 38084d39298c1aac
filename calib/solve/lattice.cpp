#include "calib/solve/lattice.h"

#include <ceres/ceres.h>
#include <ceres/rotation.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <set>

#include "calib/lattice_places.h"

namespace stuv {
namespace {

/// The unknowns: rotation vector of R, o, s_x, t.
struct Unknowns {
  std::array<double, 3> r = {};
  std::array<double, 2> origin = {};
  double s = 0;
  std::array<double, 2> t = {};
};

struct OffLattice {
  Eigen::Vector3d centre;  ///< from the mean
  double row, col;

  template <class T>
  bool operator()(const T* r, const T* o, const T* s, const T* t, T* residual) const {
    const T c[3] = {T(centre.x()), T(centre.y()), T(centre.z())};
    ceres::AngleAxisRotatePoint(r, c, residual);
    residual[0] -= o[0] + col * s[0] + row * t[0];
    residual[1] -= o[1] + row * t[1];
    return true;
  }
};

/// Holds the turn that centres on one line leave free: one component of the mean viewing direction is 0.
/// Along a line this is exact whatever its weight, as nothing else depends on that turn.
struct DirectionComponent {
  Eigen::Vector3d direction;
  int component;
  double weight_m;

  template <class T>
  bool operator()(const T* r, T* residual) const {
    const T d[3] = {T(direction.x()), T(direction.y()), T(direction.z())};
    T turned[3];
    ceres::AngleAxisRotatePoint(r, d, turned);
    residual[0] = weight_m * turned[component];
    return true;
  }
};

struct Means {
  Eigen::Vector3d centre = Eigen::Vector3d::Zero(), right = centre, forward = centre;
};

Means means_of(const std::vector<PlacedCamera>& cameras) {
  Means m;
  double n = 0;
  for (const PlacedCamera& c : cameras) {
    if (!c.determined) continue;
    m.centre += c.cam_from_ref.centre();
    m.right += c.cam_from_ref.R.row(0).transpose();
    m.forward += c.cam_from_ref.R.row(2).transpose();
    ++n;
  }
  m.centre /= n;
  m.forward.normalize();
  return m;
}

/// Centres as an affine function of (col, row) in 3-D.
struct Affine {
  Eigen::Vector3d s = Eigen::Vector3d::Zero(), t = s;
  bool has_s = false, has_t = false;
};

Affine affine_fit(const std::vector<PlacedCamera>& cameras) {
  std::vector<Eigen::Vector3d> centres;
  std::vector<Eigen::Vector2d> places;
  for (const PlacedCamera& c : cameras) {
    if (!c.determined) continue;
    centres.push_back(c.cam_from_ref.centre());
    places.emplace_back(c.col, c.row);
  }
  Affine fit;
  const auto varies = [&](int k) {
    return std::any_of(places.begin(), places.end(), [&](const auto& p) { return p[k] != places[0][k]; });
  };
  fit.has_s = varies(0);
  fit.has_t = varies(1);
  Eigen::MatrixXd A(centres.size(), 3), b(centres.size(), 3);
  for (std::size_t i = 0; i < centres.size(); ++i) {
    A.row(i) << 1, places[i].x(), places[i].y();
    b.row(i) = centres[i].transpose();
  }
  // The least norm solution: 0 for a step that no two cameras differ by.
  const Eigen::MatrixXd x = (A.rowwise() - A.colwise().mean())
                                .completeOrthogonalDecomposition()
                                .solve(b.rowwise() - b.colwise().mean());
  if (fit.has_s) fit.s = x.row(1).transpose();
  if (fit.has_t) fit.t = x.row(2).transpose();
  return fit;
}

/// First guess of the frame: z off the steps' plane where there are two, x along s; else from the directions.
Eigen::Matrix3d frame_of(const Affine& fit, const Means& means) {
  Eigen::Vector3d x = fit.has_s ? fit.s : means.right;
  Eigen::Vector3d z = means.forward;
  if (fit.has_s && fit.has_t) {
    const Eigen::Vector3d normal = fit.s.cross(fit.t);
    if (normal.norm() > 1e-6 * fit.s.norm() * fit.t.norm()) z = normal.dot(z) < 0 ? -normal : normal;
  } else if (fit.has_t) {
    const Eigen::Vector3d y = fit.t.normalized();
    z -= z.dot(y) * y;
    x = y.cross(z);
  }
  if (x.dot(means.right) < 0) x = -x;
  if (fit.has_s && !fit.has_t) z -= z.dot(x) / x.squaredNorm() * x;
  z.normalize();
  x = (x - x.dot(z) * z).normalized();
  Eigen::Matrix3d R;
  R << x.transpose(), z.cross(x).transpose(), z.transpose();
  return R;
}

/// Counts rows and columns the other way round where they run against s or t.
void orient(const Eigen::Matrix3d& R, Affine& fit, Layout& layout) {
  const Eigen::Vector3d s = R * fit.s, t = R * fit.t;
  if (fit.has_s && s.x() < 0) {
    for (int& c : layout.col) c = layout.cols - 1 - c;
    fit.s = -fit.s;
  }
  if (fit.has_t && t.y() < 0) {
    for (int& r : layout.row) r = layout.rows - 1 - r;
    fit.t = -fit.t;
  }
}

void refine(const std::vector<PlacedCamera>& cameras, const Means& means, const Affine& fit, Layout& layout) {
  Unknowns u;
  const Eigen::Vector3d r = vector_from_rotation(layout.rig_from_ref.R);
  u.r = {r.x(), r.y(), r.z()};
  const Eigen::Vector3d s = layout.rig_from_ref.R * fit.s, t = layout.rig_from_ref.R * fit.t;
  u.s = s.x();
  u.t = {t.x(), t.y()};
  const double spacing =
      std::max(1e-9, fit.has_s && fit.has_t ? std::min(s.norm(), t.norm()) : s.norm() + t.norm());

  ceres::Problem problem;
  Eigen::Vector2d mean_place = Eigen::Vector2d::Zero();
  double n = 0;
  for (std::size_t i = 0; i < cameras.size(); ++i) {
    if (!cameras[i].determined) continue;
    auto* cost = new ceres::AutoDiffCostFunction<OffLattice, 3, 3, 2, 1, 2>(new OffLattice{
        cameras[i].cam_from_ref.centre() - means.centre, double(layout.row[i]), double(layout.col[i])});
    problem.AddResidualBlock(cost, new ceres::HuberLoss(0.1 * spacing), u.r.data(), u.origin.data(), &u.s,
                             u.t.data());
    mean_place += Eigen::Vector2d(layout.col[i], layout.row[i]);
    ++n;
  }
  mean_place /= n;
  u.origin = {-mean_place.x() * u.s - mean_place.y() * u.t[0], -mean_place.y() * u.t[1]};
  if (!fit.has_s) problem.SetParameterBlockConstant(&u.s);
  if (!fit.has_t) problem.SetParameterBlockConstant(u.t.data());
  if (!(fit.has_s && fit.has_t))
    problem.AddResidualBlock(new ceres::AutoDiffCostFunction<DirectionComponent, 1, 3>(
                                 new DirectionComponent{means.forward, fit.has_s ? 1 : 0, spacing}),
                             nullptr, u.r.data());
  ceres::Solver::Options options;
  options.linear_solver_type = ceres::DENSE_QR;
  options.function_tolerance = 1e-16;
  options.parameter_tolerance = 1e-14;
  options.gradient_tolerance = 1e-18;
  options.max_num_iterations = 200;
  options.logging_type = ceres::SILENT;
  ceres::Solver::Summary summary;
  ceres::Solve(options, &problem, &summary);
  layout.converged = summary.IsSolutionUsable();
  layout.rig_from_ref.R = rotation_from_vector({u.r[0], u.r[1], u.r[2]});
  layout.origin_m = {u.origin[0], u.origin[1]};
  layout.s_step_m = {u.s, 0};
  layout.t_step_m = {u.t[0], u.t[1]};
}

double spacing_of(const Layout& layout) {
  const double s = layout.s_step_m.norm(), t = layout.t_step_m.norm();
  return s > 0 && t > 0 ? std::min(s, t) : std::max(s, t);
}

Layout fit_counted(const std::vector<PlacedCamera>& cameras, int rows, int cols) {
  Layout layout;
  layout.rows = rows;
  layout.cols = cols;
  for (const PlacedCamera& c : cameras) layout.row.push_back(c.row), layout.col.push_back(c.col);
  layout.off_lattice_m.assign(cameras.size(), Eigen::Vector3d::Zero());
  const auto determined =
      std::count_if(cameras.begin(), cameras.end(), [](const auto& c) { return c.determined; });
  if (determined == 0) return layout;

  const Means means = means_of(cameras);
  Affine fit = affine_fit(cameras);
  layout.rig_from_ref.R = frame_of(fit, means);
  orient(layout.rig_from_ref.R, fit, layout);
  if (determined > 1)
    refine(cameras, means, fit, layout);
  else
    layout.converged = true;
  layout.rig_from_ref.t = -(layout.rig_from_ref.R * means.centre);
  double sum_sq = 0;
  for (std::size_t i = 0; i < cameras.size(); ++i) {
    const Eigen::Vector2d point =
        layout.origin_m + layout.col[i] * layout.s_step_m + layout.row[i] * layout.t_step_m;
    layout.off_lattice_m[i] = layout.rig_from_ref * cameras[i].cam_from_ref.centre();
    layout.off_lattice_m[i].head<2>() -= point;
    if (cameras[i].determined) sum_sq += std::pow(layout.off_lattice_m[i].z(), 2);
  }
  layout.rms_off_plane_m = std::sqrt(sum_sq / static_cast<double>(determined));
  return layout;
}

/// Every camera within half a spacing of its lattice point, and s where the cameras' right is.
bool fits(const Layout& layout, const std::vector<PlacedCamera>& cameras) {
  const double most_m = 0.5 * spacing_of(layout);
  for (std::size_t i = 0; i < cameras.size(); ++i)
    if (cameras[i].determined && !(layout.off_lattice_m[i].norm() < most_m)) return false;
  const Eigen::Vector3d right = layout.rig_from_ref.R * means_of(cameras).right;
  return right.x() > std::abs(right.y());
}

/// Rows and columns counted along the centres as the cameras see them. Cameras that are not determined take
/// no part and get the place that their centre is nearest to.
std::vector<PlacedCamera> recount(std::vector<PlacedCamera> cameras, int& rows, int& cols) {
  const Means means = means_of(cameras);
  const Eigen::Vector3d x = (means.right - means.right.dot(means.forward) * means.forward).normalized();
  const Eigen::Vector3d y = means.forward.cross(x);
  std::vector<Eigen::Vector2d> points;
  std::vector<std::size_t> which;
  for (std::size_t i = 0; i < cameras.size(); ++i) {
    if (!cameras[i].determined) continue;
    const Eigen::Vector3d c = cameras[i].cam_from_ref.centre() - means.centre;
    points.emplace_back(x.dot(c), y.dot(c));
    which.push_back(i);
  }
  const Eigen::Rotation2Dd turn(-lattice_angle(points));
  for (Eigen::Vector2d& p : points) p = turn * p;
  const LatticePlaces places = places_on_lattice(points);
  rows = places.rows;
  cols = places.cols;
  for (PlacedCamera& camera : cameras) {
    const Eigen::Vector3d c = camera.cam_from_ref.centre() - means.centre;
    const Eigen::Vector2d at = turn * Eigen::Vector2d(x.dot(c), y.dot(c));
    std::size_t nearest = 0;
    for (std::size_t k = 1; k < points.size(); ++k)
      if ((points[k] - at).squaredNorm() < (points[nearest] - at).squaredNorm()) nearest = k;
    camera.row = places.row[nearest];
    camera.col = places.col[nearest];
  }
  return cameras;
}

bool places_differ(const std::vector<PlacedCamera>& cameras) {
  std::set<std::pair<int, int>> taken;
  for (const PlacedCamera& c : cameras)
    if (c.determined && !taken.emplace(c.row, c.col).second) return false;
  return true;
}

}  // namespace

Layout fit_layout(const std::vector<PlacedCamera>& cameras, int rows, int cols) {
  Layout recorded = fit_counted(cameras, rows, cols);
  const auto determined =
      std::count_if(cameras.begin(), cameras.end(), [](const auto& c) { return c.determined; });
  if (determined < 2 || fits(recorded, cameras)) return recorded;
  const std::vector<PlacedCamera> counted = recount(cameras, rows, cols);
  if (!places_differ(counted)) return recorded;
  Layout layout = fit_counted(counted, rows, cols);
  if (!fits(layout, counted)) return recorded;
  layout.as_recorded = false;
  return layout;
}

void set_lattice(const Layout& layout, Rig& rig) {
  rig.rows = layout.rows;
  rig.cols = layout.cols;
  rig.lattice_origin_m = layout.origin_m;
  rig.s_step_m = layout.s_step_m;
  rig.t_step_m = layout.t_step_m;
  rig.rms_off_plane_m = layout.rms_off_plane_m;
}

}  // namespace stuv
