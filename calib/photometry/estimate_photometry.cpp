#include "calib/photometry/estimate_photometry.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>

#include "core/median.h"

namespace stuv {
namespace {

/// How V falls with the decrements d of its Bernstein coefficients: V = 1 - d . fall(rho).
Eigen::Vector3d fall(double rho) {
  const double r2 = rho * rho, r3 = r2 * rho;
  return {3 * rho - 3 * r2 + r3, 3 * r2 - 2 * r3, r3};
}

/// Standard deviations of the priors, and the least noise that they are weighed against: that of 8 bits.
constexpr double kOffsetPrior = 0.05, kGainPrior = 0.5, kFallPrior = 0.03, kMeanFallPrior = 0.3;
constexpr double kLeastNoise = 1e-3;

struct Sample {
  int camera = 0, point = 0;
  std::array<double, 3> stored;
  Eigen::Vector3d fall;
  std::array<double, 3> weight = {1, 1, 1};
};

/// The problem of the cameras that take part, counted from 0 without gaps; samples sorted by point.
struct Problem {
  int cameras = 0, channels = 1, points = 0;
  std::vector<Sample> samples;
  std::vector<std::size_t> begin;  ///< of each point's samples; one more at the end

  int states() const { return 2 * channels + 3; }
  int offset(int camera, int c) const { return camera * states() + 2 * c; }
  int gain(int camera, int c) const { return offset(camera, c) + 1; }
  int fall(int camera, int k) const { return camera * states() + 2 * channels + k; }
};

struct Fit {
  Eigen::VectorXd state;
  std::vector<std::array<double, 3>> light;  ///< L of each point
  double noise = 0;
  Eigen::MatrixXd covariance;
};

double transfer(const Problem& p, const Fit& f, const Sample& s, int c) {
  return f.state[p.gain(s.camera, c)] * (1 - f.state.segment<3>(p.fall(s.camera, 0)).dot(s.fall));
}

double residual(const Problem& p, const Fit& f, const Sample& s, int c) {
  return s.stored[c] - f.state[p.offset(s.camera, c)] - transfer(p, f, s, c) * f.light[s.point][c];
}

/// The best L of every point for the cameras as they are.
void fit_light(const Problem& p, Fit& f) {
  for (int point = 0; point < p.points; ++point)
    for (int c = 0; c < p.channels; ++c) {
      double top = 0, bottom = 0;
      for (std::size_t i = p.begin[point]; i < p.begin[point + 1]; ++i) {
        const Sample& s = p.samples[i];
        const double t = transfer(p, f, s, c);
        top += s.weight[c] * t * (s.stored[c] - f.state[p.offset(s.camera, c)]);
        bottom += s.weight[c] * t * t;
      }
      if (bottom > 0) f.light[point][c] = top / bottom;
    }
}

/// Noise of a sample by the median of the residuals, which the unknowns have taken a part of.
double noise_of(const Problem& p, const Fit& f) {
  std::vector<double> sizes;
  for (const Sample& s : p.samples)
    for (int c = 0; c < p.channels; ++c) sizes.push_back(std::abs(residual(p, f, s, c)));
  if (sizes.empty()) return 0;
  const auto n = static_cast<double>(sizes.size());
  const double free = n - double(p.points) * p.channels - p.cameras * double(p.states());
  return 1.4826 * median(std::move(sizes)) * std::sqrt(n / std::max(1.0, free));
}

void weigh(Problem& p, const Fit& f) {
  constexpr double kTukey = 4.685;
  const double width = kTukey * std::max(f.noise, 0.1 * kLeastNoise);
  for (Sample& s : p.samples)
    for (int c = 0; c < p.channels; ++c) {
      const double r = residual(p, f, s, c) / width;
      s.weight[c] = std::abs(r) < 1 ? std::pow(1 - r * r, 2) : 0;
    }
}

/// A x = b of one Gauss-Newton step in the cameras' states.
struct Normal {
  Eigen::MatrixXd A;
  Eigen::VectorXd b;

  /// A row J x = r with standard deviation sigma, weighed against the samples' noise.
  void prior(const std::vector<std::pair<int, double>>& J, double r, double weight) {
    for (const auto& [i, a] : J) {
      b[i] += weight * a * r;
      for (const auto& [j, e] : J) A(i, j) += weight * a * e;
    }
  }
};

/// Derivatives of a sample by its camera's offset, gain and d.
using Row = Eigen::Matrix<double, 5, 1>;
Row derivatives(const Problem& p, const Fit& f, const Sample& s, int c) {
  const double L = f.light[s.point][c], g = f.state[p.gain(s.camera, c)];
  Row row;
  row << 1, L * (1 - f.state.segment<3>(p.fall(s.camera, 0)).dot(s.fall)), -g * L * s.fall;
  return row;
}

std::array<int, 5> indices(const Problem& p, int camera, int c) {
  return {p.offset(camera, c), p.gain(camera, c), p.fall(camera, 0), p.fall(camera, 1), p.fall(camera, 2)};
}

/// The samples of one point and channel, L eliminated: A += sum w J J^T - h h^T / sum w t^2, h = sum w t J.
void add_point(const Problem& p, const Fit& f, int point, int c, Normal& n) {
  struct Part {
    std::array<int, 5> at;
    Row h;
  };
  std::vector<Part> parts;
  double bottom = 0;
  for (std::size_t i = p.begin[point]; i < p.begin[point + 1]; ++i) {
    const Sample& s = p.samples[i];
    const double w = s.weight[c], t = transfer(p, f, s, c), r = residual(p, f, s, c);
    if (w == 0) continue;
    const Row J = derivatives(p, f, s, c);
    parts.push_back({indices(p, s.camera, c), w * t * J});
    bottom += w * t * t;
    const std::array<int, 5>& at = parts.back().at;
    for (int a = 0; a < 5; ++a) {
      n.b[at[a]] += w * J[a] * r;
      for (int e = 0; e < 5; ++e) n.A(at[a], at[e]) += w * J[a] * J[e];
    }
  }
  // At the best L the samples' own gradient by L is 0: the right side stays.
  for (const Part& a : parts)
    for (const Part& e : parts)
      for (int i = 0; i < 5; ++i)
        for (int j = 0; j < 5; ++j) n.A(a.at[i], e.at[j]) -= a.h[i] * e.h[j] / bottom;
}

void add_gauge(const Problem& p, const Fit& f, Normal& n) {
  constexpr double kStiff = 1e6;
  for (int c = 0; c < p.channels; ++c) {
    std::vector<std::pair<int, double>> gains, offsets;
    double gain = 0, offset = 0;
    for (int k = 0; k < p.cameras; ++k) {
      gains.emplace_back(p.gain(k, c), 1.0 / p.cameras);
      offsets.emplace_back(p.offset(k, c), 1.0 / p.cameras);
      gain += f.state[p.gain(k, c)] / p.cameras;
      offset += f.state[p.offset(k, c)] / p.cameras;
    }
    n.prior(gains, 1 - gain, kStiff);
    n.prior(offsets, -offset, kStiff);
  }
}

void add_priors(const Problem& p, const Fit& f, Normal& n) {
  const double noise = std::max(f.noise, kLeastNoise);
  const auto weight = [&](double sigma) { return std::pow(noise / sigma, 2); };
  for (int k = 0; k < p.cameras; ++k)
    for (int c = 0; c < p.channels; ++c) {
      n.prior({{p.offset(k, c), 1}}, -f.state[p.offset(k, c)], weight(kOffsetPrior));
      n.prior({{p.gain(k, c), 1}}, 1 - f.state[p.gain(k, c)], weight(kGainPrior));
    }
  for (int m = 0; m < 3; ++m) {
    std::vector<std::pair<int, double>> all;
    double mean = 0;
    for (int k = 0; k < p.cameras; ++k) {
      all.emplace_back(p.fall(k, m), 1.0 / p.cameras);
      mean += f.state[p.fall(k, m)] / p.cameras;
    }
    n.prior(all, -mean, weight(kMeanFallPrior));
    // sum_k (d_k - mean)^2 = sum_k d_k^2 - K mean^2
    const double w = weight(kFallPrior);
    for (int k = 0; k < p.cameras; ++k) n.prior({{p.fall(k, m), 1}}, -f.state[p.fall(k, m)], w);
    n.prior(all, -mean, -w * p.cameras);
  }
}

Normal normal_of(const Problem& p, const Fit& f) {
  const Eigen::Index size = static_cast<Eigen::Index>(p.cameras) * p.states();
  Normal n{Eigen::MatrixXd::Zero(size, size), Eigen::VectorXd::Zero(size)};
  for (int point = 0; point < p.points; ++point)
    for (int c = 0; c < p.channels; ++c) add_point(p, f, point, c, n);
  add_gauge(p, f, n);
  add_priors(p, f, n);
  return n;
}

/// Takes the fixed states out: they neither move nor count as unknown.
void fix(const std::vector<char>& fixed, Normal& n) {
  for (std::size_t i = 0; i < fixed.size(); ++i) {
    if (fixed[i] == 0) continue;
    const auto k = static_cast<Eigen::Index>(i);
    n.A.row(k).setZero();
    n.A.col(k).setZero();
    n.A(k, k) = 1;
    n.b[k] = 0;
  }
}

/// States that stay: those `held`, and d at its bound which the step would take below it.
std::vector<char> fixed_states(const Problem& p, const Fit& f, const std::vector<char>& held,
                               const Normal& n) {
  std::vector<char> fixed = held;
  for (int k = 0; k < p.cameras; ++k)
    for (int m = 0; m < 3; ++m) {
      const int i = p.fall(k, m);
      if (f.state[i] <= 0 && n.b[i] <= 0) fixed[i] = 1;
    }
  return fixed;
}

/// d >= 0 and V(1) >= 0.05.
void keep_falling(const Problem& p, Fit& f) {
  constexpr double kMostFall = 0.95;
  for (int k = 0; k < p.cameras; ++k) {
    auto d = f.state.segment<3>(p.fall(k, 0));
    d = d.cwiseMax(0);
    if (d.sum() > kMostFall) d *= kMostFall / d.sum();
  }
}

Fit solve(Problem& p, const std::vector<char>& held) {
  constexpr int kMostSteps = 30, kUnweighted = 3;
  Fit f{Eigen::VectorXd::Zero(static_cast<Eigen::Index>(p.cameras) * p.states()),
        std::vector<std::array<double, 3>>(p.points),
        0,
        {}};
  for (int k = 0; k < p.cameras; ++k)
    for (int c = 0; c < p.channels; ++c) f.state[p.gain(k, c)] = 1;
  for (Sample& s : p.samples) s.weight = {1, 1, 1};
  for (int step = 0; step < kMostSteps; ++step) {
    fit_light(p, f);
    f.noise = noise_of(p, f);
    if (step >= kUnweighted) {
      weigh(p, f);
      fit_light(p, f);
    }
    Normal n = normal_of(p, f);
    fix(fixed_states(p, f, held, n), n);
    const Eigen::VectorXd change = n.A.ldlt().solve(n.b);
    f.state += change;
    keep_falling(p, f);
    if (step > kUnweighted && change.cwiseAbs().maxCoeff() < 1e-6) break;
  }
  fit_light(p, f);
  f.noise = noise_of(p, f);
  // Bounds do not count here: a d that happens to lie at 0 is no better known for it.
  Normal n = normal_of(p, f);
  fix(held, n);
  const double noise = std::max(f.noise, kLeastNoise);
  f.covariance = noise * noise * n.A.ldlt().solve(Eigen::MatrixXd::Identity(n.A.rows(), n.A.cols()));
  for (std::size_t i = 0; i < held.size(); ++i)
    if (held[i] != 0) f.covariance(Eigen::Index(i), Eigen::Index(i)) = 0;
  return f;
}

double sigma_of(const Fit& f, int state) { return std::sqrt(std::max(0.0, f.covariance(state, state))); }

/// Sigma of V(1) = 1 - d1 - d2 - d3: of the mean over the cameras, and of one camera's beside that mean.
double corner_sigma(const Problem& p, const Fit& f, int camera) {
  Eigen::VectorXd J = Eigen::VectorXd::Zero(f.state.size());
  for (int k = 0; k < p.cameras; ++k)
    for (int m = 0; m < 3; ++m)
      J[p.fall(k, m)] = (camera < 0 ? 1.0 : -1.0) / p.cameras + (k == camera ? 1 : 0);
  return std::sqrt(std::max(0.0, J.dot(f.covariance * J)));
}

/// Who takes part, and why others do not.
struct Choice {
  std::vector<int> cameras;         ///< indices of the caller
  std::vector<std::string> reason;  ///< of every camera; "" if it takes part
};

/// Cameras connected by common points: the largest group; each with enough samples.
Choice choose(const std::vector<PhotometricSample>& samples, std::size_t cameras, int points,
              const PhotometryOptions& options) {
  std::vector<int> first(points, -1), seen_by(points, 0), group(cameras);
  std::iota(group.begin(), group.end(), 0);
  const auto root = [&](int k) {
    while (group[k] != k) k = group[k] = group[group[k]];
    return k;
  };
  for (const PhotometricSample& s : samples) {
    if (seen_by[s.point]++ == 0)
      first[s.point] = s.camera;
    else
      group[root(s.camera)] = root(first[s.point]);
  }
  std::vector<int> count(cameras, 0), size(cameras, 0);
  for (const PhotometricSample& s : samples)
    if (seen_by[s.point] > 1) ++count[s.camera];
  for (std::size_t k = 0; k < cameras; ++k) size[root(int(k))] += count[k] > 0 ? 1 : 0;
  const int largest = static_cast<int>(std::max_element(size.begin(), size.end()) - size.begin());
  Choice choice{{}, std::vector<std::string>(cameras)};
  for (std::size_t k = 0; k < cameras; ++k) {
    if (count[k] < options.least_samples)
      choice.reason[k] = fmt::format("{} flat places that other cameras see as well, {} are needed", count[k],
                                     options.least_samples);
    else if (root(int(k)) != largest)
      choice.reason[k] = "no flat place in common with most other cameras";
    else
      choice.cameras.push_back(static_cast<int>(k));
  }
  return choice;
}

double fall_radius_sq(const CameraPhotometry& c, const Eigen::Vector2d& q) {
  return (q - c.centre_px).squaredNorm() / (c.corner_px * c.corner_px);
}

/// The samples of the chosen cameras at points that two of them see, at most as many as can be paid for.
Problem problem_of(const std::vector<PhotometricSample>& samples, const std::vector<int>& chosen,
                   const std::vector<CameraPhotometry>& lenses, int channels, int points,
                   const PhotometryOptions& options) {
  std::vector<int> place(lenses.size(), -1);
  for (std::size_t k = 0; k < chosen.size(); ++k) place[chosen[k]] = static_cast<int>(k);
  std::vector<std::vector<const PhotometricSample*>> at(points);
  for (const PhotometricSample& s : samples)
    if (place[s.camera] >= 0) at[s.point].push_back(&s);
  double pairs = 0;
  for (const auto& list : at) pairs += list.size() > 1 ? std::pow(double(list.size()), 2) : 0;
  const double keep = std::min(1.0, options.most_pairs / std::max(1.0, pairs));
  Problem p{static_cast<int>(chosen.size()), channels, 0, {}, {}};
  double due = 0;
  // Points in an order that no pattern of the board keeps step with.
  std::vector<int> order(points);
  std::iota(order.begin(), order.end(), 0);
  std::sort(order.begin(), order.end(), [](int a, int b) {
    const auto mix = [](int i) { return static_cast<std::uint32_t>(i) * 2654435769U; };
    return mix(a) < mix(b);
  });
  for (const int point : order) {
    if (at[point].size() < 2 || (due += keep) < 1) continue;
    due -= 1;
    p.begin.push_back(p.samples.size());
    for (const PhotometricSample* s : at[point])
      p.samples.push_back({place[s->camera],
                           p.points,
                           s->stored,
                           fall(fall_radius_sq(lenses[s->camera], s->pixel)),
                           {1, 1, 1}});
    ++p.points;
  }
  p.begin.push_back(p.samples.size());
  return p;
}

/// States not to be estimated: offsets whose sigma would be too large.
std::vector<char> loose_offsets(const Problem& p, const Fit& f, const PhotometryOptions& options) {
  std::vector<char> held(f.state.size(), 0);
  for (int k = 0; k < p.cameras; ++k)
    for (int c = 0; c < p.channels; ++c)
      if (!(sigma_of(f, p.offset(k, c)) <= options.most_offset_sigma)) held[p.offset(k, c)] = 1;
  return held;
}

/// Relative spread of the cameras' values about their mean, over the brighter half of the points.
double spread(const Problem& p, const Fit& f, bool correct) {
  double sum = 0, count = 0;
  for (int c = 0; c < p.channels; ++c) {
    std::vector<double> lights;
    for (const auto& light : f.light) lights.push_back(light[c]);
    const double bright = median(lights);
    for (int point = 0; point < p.points; ++point) {
      if (f.light[point][c] < bright) continue;
      std::vector<double> values;
      double mean = 0;
      for (std::size_t i = p.begin[point]; i < p.begin[point + 1]; ++i) {
        const Sample& s = p.samples[i];
        if (s.weight[c] == 0) continue;
        values.push_back(correct ? (s.stored[c] - f.state[p.offset(s.camera, c)]) / transfer(p, f, s, c)
                                 : s.stored[c]);
        mean += values.back();
      }
      if (values.size() < 2) continue;
      mean /= static_cast<double>(values.size());
      for (const double v : values) sum += std::pow(v / mean - 1, 2);
      count += static_cast<double>(values.size() - 1);
    }
  }
  return count > 0 ? std::sqrt(sum / count) : std::numeric_limits<double>::quiet_NaN();
}

void fill_camera(const Problem& p, const Fit& f, const std::vector<char>& held, int k,
                 const PhotometryOptions& options, CameraPhotometry& out) {
  out.determined = true;
  bool offsets_held = false;
  for (int c = 0; c < 3; ++c) {
    const int from = std::min(c, p.channels - 1);
    out.gain[c] = f.state[p.gain(k, from)];
    out.offset[c] = f.state[p.offset(k, from)];
    out.gain_sigma[c] = sigma_of(f, p.gain(k, from));
    out.offset_sigma[c] = sigma_of(f, p.offset(k, from));
    offsets_held |= held[p.offset(k, from)] != 0;
  }
  const Eigen::Vector3d d = f.state.segment<3>(p.fall(k, 0));
  out.falloff = {-3 * d[0], 3 * d[0] - 3 * d[1], -d[0] + 2 * d[1] - d[2]};
  out.corner_sigma = corner_sigma(p, f, k);
  out.samples = static_cast<int>(
      std::count_if(p.samples.begin(), p.samples.end(), [&](const Sample& s) { return s.camera == k; }));
  if (offsets_held) out.reasons.push_back("offset left at 0: what it sees is too much alike in brightness");
  if (out.corner_sigma > options.most_corner_sigma)
    out.reasons.push_back(
        fmt::format("fall of light taken from the rig's mean where it sees no flat place: "
                    "+- {:.0f} % in the corners",
                    100 * out.corner_sigma));
}

/// Solves, and leaves out cameras until the gains of the rest are known.
void solve_determined(const std::vector<PhotometricSample>& samples, int points, Choice& choice,
                      const PhotometryOptions& options, Photometry& result) {
  while (choice.cameras.size() > 1) {
    Problem p = problem_of(samples, choice.cameras, result.cameras, result.channels, points, options);
    std::vector<char> held(static_cast<std::size_t>(p.cameras) * p.states(), 0);
    Fit f = solve(p, held);
    held = loose_offsets(p, f, options);
    if (std::find(held.begin(), held.end(), 1) != held.end()) f = solve(p, held);
    int worst = -1;
    double worst_sigma = options.most_gain_sigma;
    for (int k = 0; k < p.cameras; ++k)
      for (int c = 0; c < p.channels; ++c)
        if (const double sigma = sigma_of(f, p.gain(k, c)); !(sigma <= worst_sigma))
          worst = k, worst_sigma = sigma;
    if (worst >= 0) {
      choice.reason[choice.cameras[worst]] =
          fmt::format("its gain is known to {:.1f} % only", 100 * worst_sigma);
      choice.cameras.erase(choice.cameras.begin() + worst);
      continue;
    }
    for (int k = 0; k < p.cameras; ++k)
      fill_camera(p, f, held, k, options, result.cameras[choice.cameras[k]]);
    result.points = p.points;
    result.spread_before = spread(p, f, false);
    result.spread_after = spread(p, f, true);
    if (const double sigma = corner_sigma(p, f, -1); sigma > options.most_corner_sigma)
      result.notes.push_back(fmt::format(
          "how much light all lenses lose in the corners is known to {:.0f} % only, as things stay at the "
          "same place in all pictures: the cameras are made to agree, the loss they share may remain",
          100 * sigma));
    return;
  }
}

/// A shining board, or light that changed from camera to camera, looks like offsets and gains of cameras:
/// then none of them may be believed.
void refuse_misfit(const PhotometryOptions& options, Photometry& result) {
  if (!(result.spread_after > options.most_spread)) return;
  for (CameraPhotometry& c : result.cameras) {
    CameraPhotometry identity;
    identity.camera = c.camera;
    identity.centre_px = c.centre_px;
    identity.corner_px = c.corner_px;
    identity.samples = c.samples;
    identity.reasons = {
        fmt::format("cameras still differ by {:.1f} % after the best fit, more than {:.1f}: the surface "
                    "shines, or the light changed",
                    100 * result.spread_after, 100 * options.most_spread)};
    c = identity;
  }
  result.notes.clear();
}

CameraPhotometry lens_of(const Camera& camera) {
  CameraPhotometry lens;
  lens.camera = camera.name;
  lens.centre_px = {camera.intrinsics[2], camera.intrinsics[3]};
  lens.corner_px = 0;
  for (const double x : {0.0, camera.width - 1.0})
    for (const double y : {0.0, camera.height - 1.0})
      lens.corner_px = std::max(lens.corner_px, (Eigen::Vector2d(x, y) - lens.centre_px).norm());
  return lens;
}

}  // namespace

Photometry estimate_photometry(const std::vector<PhotometricSample>& samples,
                               const std::vector<Camera>& cameras, int channels, const std::string& source,
                               const PhotometryOptions& options) {
  Photometry result;
  result.source = source;
  result.channels = channels;
  result.spread_before = result.spread_after = std::numeric_limits<double>::quiet_NaN();
  for (const Camera& camera : cameras) result.cameras.push_back(lens_of(camera));
  int points = 0;
  for (const PhotometricSample& s : samples) points = std::max(points, s.point + 1);
  Choice choice = choose(samples, cameras.size(), points, options);
  solve_determined(samples, points, choice, options, result);
  refuse_misfit(options, result);
  for (std::size_t k = 0; k < cameras.size(); ++k) {
    CameraPhotometry& c = result.cameras[k];
    if (c.determined || !c.reasons.empty()) continue;
    if (choice.reason[k].empty()) choice.reason[k] = "there is no other camera to compare it with";
    c.reasons.push_back(choice.reason[k]);
  }
  return result;
}

}  // namespace stuv
