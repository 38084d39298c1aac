#include "calib/tracking/measurement.h"

#include <algorithm>
#include <cmath>

namespace stuv::tracking {
namespace {

constexpr int kMostSamplesPerSegment = 100;

struct Residual {
  double e = 0, weight = 1;
  Eigen::Matrix<double, 1, 6> J;
  bool of_point = false;
};

/// d pixel / d twist of X exp(twist) at 0, 2 x 6.
Eigen::Matrix<double, 2, 6> pose_derivative(const Eigen::Matrix<double, 2, 3>& by_point, const Pose& pose,
                                            const Eigen::Vector3d& x) {
  Eigen::Matrix<double, 2, 6> J;
  J.leftCols<3>() = by_point * pose.R;
  J.rightCols<3>() = -J.leftCols<3>() * cross_matrix(x);
  return J;
}

/// Nearest hypothesis to where the sample is now, along its first normal.
double nearest_residual(const EdgeSample& sample, const Eigen::Vector2d& now) {
  const double moved = sample.n.dot(now - sample.p);
  double best = sample.found.distance[0] - moved;
  for (int k = 1; k < sample.found.count; ++k) {
    const double e = sample.found.distance[k] - moved;
    if (std::abs(e) < std::abs(best)) best = e;
  }
  return best;
}

void collect(const std::vector<EdgeSample>& samples, const std::vector<PointMatch>& points, const Lens& lens,
             const Pose& pose, std::vector<Residual>& out) {
  out.clear();
  Eigen::Vector2d q;
  Eigen::Matrix<double, 2, 3> by_point;
  for (const EdgeSample& sample : samples) {
    if (sample.found.count == 0 || !lens.project(pose * sample.x, q, &by_point)) continue;
    const double e = nearest_residual(sample, q);
    // n^T times pose_derivative.
    const Eigen::Vector3d v = pose.R.transpose() * (by_point.transpose() * sample.n);
    Residual& r = out.emplace_back();
    r.e = e;
    r.J << v.transpose(), sample.x.cross(v).transpose();
  }
  for (const PointMatch& point : points) {
    if (!lens.project(pose * point.x, q, &by_point)) continue;
    const Eigen::Matrix<double, 2, 6> J = pose_derivative(by_point, pose, point.x);
    for (int k = 0; k < 2; ++k) out.push_back({point.q[k] - q[k], point.weight, J.row(k), true});
  }
}

/// 1.48 times the median of |e| of the edges' or the points' residuals; 0 without any.
double robust_deviation(const std::vector<Residual>& residuals, bool of_points) {
  std::vector<double> e;
  e.reserve(residuals.size());
  for (const Residual& r : residuals)
    if (r.of_point == of_points) e.push_back(std::abs(r.e));
  if (e.empty()) return 0;
  const auto middle = e.begin() + static_cast<std::ptrdiff_t>(e.size() / 2);
  std::nth_element(e.begin(), middle, e.end());
  return 1.4826 * *middle;
}

double weight_of(double e, double deviation, const RefineOptions& options) {
  if (options.weights == RefineOptions::Weights::reciprocal)
    return options.c_px / (options.c_px + std::abs(e));
  const double u = e / std::max(options.c_px, 4.685 * deviation);
  return std::abs(u) < 1 ? (1 - u * u) * (1 - u * u) : 0;
}

}  // namespace

std::vector<EdgeSample> sample_edges(const ObjectModel& model, const Lens& lens, const Pose& pose,
                                     double spacing_px, double slack) {
  std::vector<EdgeSample> samples;
  for (const VisibleSegment& segment : visible_edges(model, pose, slack)) {
    const ObjectModel::Edge& edge = model.edges[segment.edge];
    const Eigen::Vector3d along = model.vertices[edge.b] - model.vertices[edge.a];
    const Eigen::Vector3d a = model.vertices[edge.a] + segment.t0 * along;
    const Eigen::Vector3d b = model.vertices[edge.a] + segment.t1 * along;
    const double za = (pose * a).z(), zb = (pose * b).z();
    const Eigen::Vector2d qa = (pose * a).hnormalized(), qb = (pose * b).hnormalized();
    const double length_px = lens.focal_px() * (qb - qa).norm();
    const int count = std::clamp(static_cast<int>(std::lround(std::min(1e6, length_px / spacing_px))),
                                 length_px > 3 ? 1 : 0, kMostSamplesPerSegment);
    for (int i = 0; i < count; ++i) {
      // Evenly in the picture: 1 / z is linear there.
      const double u = (i + 0.5) / count, wa = (1 - u) / za, wb = u / zb;
      EdgeSample s;
      s.x = (wa * a + wb * b) / (wa + wb);
      Eigen::Matrix<double, 2, 3> by_point;
      if (!lens.project(pose * s.x, s.p, &by_point) || !lens.inside(s.p, 1)) continue;
      const Eigen::Vector2d tangent = by_point * (pose.R * along);
      if (!(tangent.norm() > 0)) continue;
      s.n = Eigen::Vector2d(-tangent.y(), tangent.x()).normalized();
      samples.push_back(s);
    }
  }
  return samples;
}

void match_edges(const GradientPicture& picture, double range_px, double least_cosine,
                 std::vector<EdgeSample>& samples) {
  for (EdgeSample& s : samples) s.found = search_edges(picture, s.p, s.n, range_px, least_cosine);
}

MatchSummary summarise(const std::vector<EdgeSample>& samples) {
  MatchSummary m;
  m.visible = static_cast<int>(samples.size());
  for (const EdgeSample& s : samples) {
    if (s.found.count == 0) continue;
    ++m.matched;
    m.mean_distance_px += std::abs(s.found.distance[0]);
  }
  if (m.matched > 0) m.mean_distance_px /= m.matched;
  return m;
}

double log_likelihood(const MatchSummary& m, double range_px, const LikelihoodOptions& options) {
  const double missing = m.visible > 0 ? double(m.visible - m.matched) / m.visible : 1.0;
  return -options.lambda_v * missing - options.lambda_e * (m.matched > 0 ? m.mean_distance_px : range_px);
}

Refined refine(const std::vector<EdgeSample>& samples, const std::vector<PointMatch>& points,
               const Lens& lens, const Pose& cam_from_object, const RefineOptions& options,
               const PosePrior& prior) {
  const bool has_prior = !prior.information.isZero();
  Refined out;
  out.cam_from_object = cam_from_object;
  std::vector<Residual> residuals;
  for (int step = 0; step <= options.iterations; ++step) {
    collect(samples, points, lens, out.cam_from_object, residuals);
    out.residuals = static_cast<int>(residuals.size());
    if (residuals.size() < 3 && !has_prior) return out;
    double edges_px = 0, points_px = 0;
    if (step == options.iterations || options.weights == RefineOptions::Weights::tukey) {
      edges_px = robust_deviation(residuals, false);
      points_px = robust_deviation(residuals, true);
      out.deviation_px = std::max(edges_px, points_px);
    }
    Matrix6 JtJ = Matrix6::Zero();
    Twist Jte = Twist::Zero();
    for (const Residual& r : residuals) {
      const double w = r.weight * weight_of(r.e, r.of_point ? points_px : edges_px, options);
      JtJ.noalias() += w * r.J.transpose() * r.J;
      Jte.noalias() += w * r.e * r.J.transpose();
    }
    if (has_prior) {
      JtJ += prior.information;
      Jte += prior.information * log(out.cam_from_object.inverse() * prior.cam_from_object);
    }
    out.information = JtJ;
    if (step == options.iterations) break;
    const double damping = 1e-6 * JtJ.diagonal().maxCoeff();
    const Twist mu = (JtJ + damping * Matrix6::Identity()).ldlt().solve(Jte);
    // A step of more than the object's size is no refinement any more.
    if (!mu.allFinite() || mu.tail<3>().norm() > 1) return out;
    out.cam_from_object = out.cam_from_object * exp(mu);
  }
  return out;
}

}  // namespace stuv::tracking
