#include "render/plan/sampling.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <string>

#include "render/lattice_chart.h"

namespace stuv {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();
constexpr double kMost = 1e6;

void require(bool good, const char* what) {
  if (!good) throw std::invalid_argument(std::string("plan: ") + what);
}

void validate(const SamplingProblem& p) {
  require(p.rows >= 1 && p.cols >= 1, "a grid has at least one row and one column");
  require(std::isfinite(p.spacing_s) && std::isfinite(p.spacing_t) && p.spacing_s >= 0 && p.spacing_t >= 0,
          "the spacing must be finite and not negative");
  require(p.cols == 1 || p.spacing_s > 0, "cameras side by side need a spacing above 0");
  require(p.rows == 1 || p.spacing_t > 0, "cameras above each other need a spacing above 0");
  require(std::isfinite(p.inverse_far) && std::isfinite(p.inverse_near) && p.inverse_far <= p.inverse_near,
          "the near depth must not lie beyond the far one");
  require(std::isfinite(p.bandwidth) && p.bandwidth > 0, "the bandwidth must be above 0");
}

/// Rounded up, a whole number that rounding has missed by a hair stays what it is.
double whole_up(double value) { return std::ceil(value - 1e-9); }

}  // namespace

SamplingPlan plan_sampling(const SamplingProblem& p) {
  validate(p);
  const double range = p.inverse_near - p.inverse_far;
  const double spacing = std::max(p.cols > 1 ? p.spacing_s : 0.0, p.rows > 1 ? p.spacing_t : 0.0);
  SamplingPlan out;
  out.max_spacing = range > 0 ? 1 / (p.bandwidth * range) : kInfinity;
  out.max_spacing_three_filters = out.max_spacing / 2;
  const auto needed = [&](int cameras, double step) {
    return cameras == 1 ? 1.0 : cameras * std::max(1.0, whole_up(step / out.max_spacing));
  };
  out.cameras_needed = needed(p.rows, p.spacing_t) * needed(p.cols, p.spacing_s);
  out.factor = out.cameras_needed / (static_cast<double>(p.rows) * p.cols);
  out.inverse_optimum = (p.inverse_near + p.inverse_far) / 2;
  out.three_filter_range = spacing > 0 ? 1 / (2 * p.bandwidth * spacing) : kInfinity;
  out.one_plane_is_enough = range <= out.three_filter_range;
  const double steps = out.one_plane_is_enough ? 0 : whole_up(range / out.three_filter_range);
  require(steps < kMost, "that asks for more than a million focal planes; check the units");
  const int count = static_cast<int>(steps) + 1;
  const double half = std::min(out.three_filter_range, range > 0 ? range : kInfinity) / 2;
  for (int n = 0; n < count; ++n) {
    const double a = count == 1 ? 0.5 : static_cast<double>(n) / (count - 1);
    const double at = (1 - a) * p.inverse_far + a * p.inverse_near;
    const double reach = count == 1 ? std::max(half, out.three_filter_range / 2) : out.three_filter_range / 2;
    out.planes.push_back({at, at - reach, at + reach});
  }
  return out;
}

std::pair<double, double> lattice_spacing(const LightField& lf) {
  std::vector<View> cameras;
  for (const int i : lf.views_with(ViewRole::input)) cameras.push_back(lf.views[static_cast<std::size_t>(i)]);
  const LatticeChart chart(lf.rows, lf.cols, cameras);
  // Columns of the inverse: where one step along a row and one along a column lead.
  const Eigen::Matrix2d steps = chart.affine().leftCols<2>().inverse();
  const auto length = [](const Eigen::Vector2d& v) { return v.allFinite() ? v.norm() : 0.0; };
  return {lf.cols > 1 ? length(steps.col(0)) : 0.0, lf.rows > 1 ? length(steps.col(1)) : 0.0};
}

SamplingProblem sampling_problem(const LightField& lf, double d_min, double d_max) {
  SamplingProblem p;
  p.rows = lf.rows;
  p.cols = lf.cols;
  std::tie(p.spacing_s, p.spacing_t) = lattice_spacing(lf);
  p.inverse_far = lf.inverse_depth(d_min);
  p.inverse_near = lf.inverse_depth(d_max);
  p.bandwidth = lf.focal_px / 2;
  return p;
}

int planes_needed(const LightField& lf, double d_min, double d_max) {
  const auto [s, t] = lattice_spacing(lf);
  const double steps = (d_max - d_min) * std::max(s, t);
  return static_cast<int>(std::clamp(whole_up(steps), 0.0, kMostPlanes - 1.0)) + 1;
}

}  // namespace stuv
