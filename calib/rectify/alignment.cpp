#include "calib/rectify/alignment.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>

namespace stuv {
namespace {

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

struct Offsets {
  std::vector<double> as_they_are, beyond;
};

double rms(const std::vector<double>& values) {
  double sum = 0;
  for (const double v : values) sum += v * v;
  return values.empty() ? kNan : std::sqrt(sum / static_cast<double>(values.size()));
}

double quantile(std::vector<double> values, double part) {
  if (values.empty()) return kNan;
  const auto at = values.begin() + static_cast<long>(part * static_cast<double>(values.size() - 1) + 0.5);
  std::nth_element(values.begin(), at, values.end());
  return *at;
}

double p95(std::vector<double> values) {
  for (double& v : values) v = std::abs(v);
  return quantile(std::move(values), 0.95);
}

/// Signed distance from the epipolar line.
double beyond(const LightField& lf, const ViewMatch& m) {
  const auto [far, near] = epipolar_segment(lf, lf.views[m.a], lf.views[m.b], m.in_a);
  const Eigen::Vector2d way = (near - far).normalized();
  const Eigen::Vector2d off = m.in_b - far;
  return way.x() * off.y() - way.y() * off.x();
}

bool in_a_row(const LightField& lf, const ViewMatch& m) { return lf.views[m.a].row == lf.views[m.b].row; }

Offsets without_wrong_ones(const Offsets& all) {
  const double middle = quantile(all.beyond, 0.5);
  std::vector<double> away;
  for (const double v : all.beyond) away.push_back(std::abs(v - middle));
  const double most = 4.5 * std::max(0.05, 1.4826 * quantile(away, 0.5));
  Offsets kept;
  for (std::size_t i = 0; i < all.beyond.size(); ++i)
    if (away[i] <= most) {
      kept.beyond.push_back(all.beyond[i]);
      kept.as_they_are.push_back(all.as_they_are[i]);
    }
  return kept;
}

}  // namespace

Alignment alignment_of(const LightField& lf, const std::vector<ViewMatch>& matches,
                       const std::string& measured_from) {
  constexpr std::size_t kLeastPoints = 8;
  std::map<std::pair<int, int>, Offsets> pairs;
  for (const ViewMatch& m : matches) {
    Offsets& o = pairs[{m.a, m.b}];
    o.as_they_are.push_back(in_a_row(lf, m) ? m.in_b.y() - m.in_a.y() : m.in_b.x() - m.in_a.x());
    o.beyond.push_back(beyond(lf, m));
  }
  Alignment result;
  result.measured_from = measured_from;
  Offsets all;
  for (auto& [pair, offsets] : pairs) {
    if (measured_from == "features") offsets = without_wrong_ones(offsets);
    if (offsets.beyond.size() < kLeastPoints) continue;
    const View &a = lf.views[pair.first], &b = lf.views[pair.second];
    result.pairs.push_back({a.name, b.name, a.row == b.row, static_cast<int>(offsets.beyond.size()),
                            rms(offsets.as_they_are), p95(offsets.as_they_are), rms(offsets.beyond),
                            p95(offsets.beyond)});
    all.as_they_are.insert(all.as_they_are.end(), offsets.as_they_are.begin(), offsets.as_they_are.end());
    all.beyond.insert(all.beyond.end(), offsets.beyond.begin(), offsets.beyond.end());
  }
  result.points = static_cast<int>(all.beyond.size());
  result.rms_px = rms(all.as_they_are);
  result.p95_px = p95(all.as_they_are);
  result.beyond_rms_px = rms(all.beyond);
  result.beyond_p95_px = p95(all.beyond);
  return result;
}

Json to_json(const Alignment& alignment) {
  Json pairs = Json::array();
  for (const PairAlignment& p : alignment.pairs)
    pairs.push_back({{"a", p.a},
                     {"b", p.b},
                     {"along", p.in_a_row ? "s" : "t"},
                     {"points", p.points},
                     {"rms_px", p.rms_px},
                     {"p95_px", p.p95_px},
                     {"beyond_parallax_rms_px", p.beyond_rms_px},
                     {"beyond_parallax_p95_px", p.beyond_p95_px}});
  return {{"measured_from", alignment.measured_from},
          {"points", alignment.points},
          {"rms_px", alignment.rms_px},
          {"p95_px", alignment.p95_px},
          {"beyond_parallax_rms_px", alignment.beyond_rms_px},
          {"beyond_parallax_p95_px", alignment.beyond_p95_px},
          {"pairs", pairs}};
}

}  // namespace stuv
