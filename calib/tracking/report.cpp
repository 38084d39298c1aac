#include "calib/tracking/report.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <limits>
#include <numbers>

namespace stuv::tracking {
namespace {

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
constexpr double kDegree = 180 / std::numbers::pi;

/// null for what is no number: JSON has no Inf or NaN.
Json number(double value) { return std::isfinite(value) ? Json(value) : Json(nullptr); }

Json pose_json(const Pose& pose) {
  const Eigen::Quaterniond q(pose.R);
  return {{"t_m", {pose.t.x(), pose.t.y(), pose.t.z()}}, {"q_xyzw", {q.x(), q.y(), q.z(), q.w()}}};
}

Json matrix_json(const Matrix6& m) {
  Json rows = Json::array();
  for (int i = 0; i < 6; ++i) {
    Json row = Json::array();
    for (int j = 0; j < 6; ++j) row.push_back(number(m(i, j)));
    rows.push_back(row);
  }
  return rows;
}

Json seconds_json(const StageSeconds& s) {
  return {{"gradient", s.gradient}, {"keypoints", s.keypoints}, {"texture", s.texture},
          {"filter", s.filter},     {"estimate", s.estimate},   {"total", s.total}};
}

Json frame_json(const Track& track, std::size_t i) {
  const TrackedFrame& f = track.tracked[i];
  Json json = {{"frame", track.frames[i].name},
               {"t", track.frames[i].time},
               {"lost", f.lost},
               {"initialised", f.initialised},
               {"pose", f.has_pose ? pose_json(f.cam_from_object) : Json(nullptr)},
               {"covariance", f.has_pose ? matrix_json(f.covariance) : Json(nullptr)},
               {"n_eff", f.n_eff},
               {"particles", f.particles},
               {"visible", f.edges.visible},
               {"matched", f.edges.matched},
               {"mean_distance_px", f.edges.mean_distance_px},
               {"deviation_px", f.deviation_px},
               {"texture_points", f.texture_points},
               {"correlation", number(f.correlation)}};
  if (!track.truth.empty() && track.truth[i] && f.has_pose) {
    const PoseError e = pose_error(f.cam_from_object, *track.truth[i]);
    json["error"] = {{"translation_m", e.translation_m}, {"rotation_rad", e.rotation_rad}};
  }
  json["seconds"] = seconds_json(f.seconds);
  return json;
}

/// Root mean square of the errors of the frames that are not lost.
Json error_json(const Track& track) {
  double t2 = 0, r2 = 0, n = 0;
  for (std::size_t i = 0; i < track.truth.size(); ++i) {
    if (!track.truth[i] || track.tracked[i].lost) continue;
    const PoseError e = pose_error(track.tracked[i].cam_from_object, *track.truth[i]);
    t2 += e.translation_m * e.translation_m, r2 += e.rotation_rad * e.rotation_rad, n += 1;
  }
  return {{"frames", n},
          {"rms_translation_m", number(std::sqrt(t2 / n))},
          {"rms_rotation_rad", number(std::sqrt(r2 / n))}};
}

// --- the page ---------------------------------------------------------------------------------------------

struct Curve {
  std::string name, colour;
  std::function<double(std::size_t)> value;  ///< NaN: a gap
};

std::string plot(const Track& track, const std::string& title, const std::vector<Curve>& curves) {
  constexpr double width = 900, height = 190, left = 70, bottom = 22;
  const std::size_t n = track.frames.size();
  double low = std::numeric_limits<double>::infinity(), high = -low;
  for (const Curve& c : curves)
    for (std::size_t i = 0; i < n; ++i)
      if (const double v = c.value(i); std::isfinite(v)) low = std::min(low, v), high = std::max(high, v);
  if (!(low <= high)) return "";
  if (high - low < 1e-9) low -= 0.5, high += 0.5;
  const double step = (width - left) / std::max<double>(1, static_cast<double>(n));
  const auto x = [&](std::size_t i) { return left + step * (static_cast<double>(i) + 0.5); };
  const auto y = [&](double v) { return 8 + (height - bottom - 16) * (high - v) / (high - low); };
  std::string svg =
      fmt::format("<h2>{}</h2><svg viewBox='0 0 {} {}' width='{}'>", title, width, height, width);
  for (std::size_t i = 0; i < n; ++i)
    if (track.tracked[i].lost)
      svg += fmt::format("<rect x='{:.1f}' y='0' width='{:.1f}' height='{}' fill='#fcc'/>", x(i) - step / 2,
                         step, height - bottom);
  for (const double v : {low, high})
    svg += fmt::format(
        "<path d='M{} {:.1f}H{}' stroke='#ddd'/><text x='{}' y='{:.1f}' text-anchor='end'>{:.4g}</text>",
        left, y(v), width, left - 6, y(v) + 4, v);
  svg += fmt::format("<text x='{}' y='{}'>{}</text><text x='{}' y='{}' text-anchor='end'>{}</text>", left,
                     height - 5, track.frames.front().name, width, height - 5, track.frames.back().name);
  double legend = left + 120;
  for (const Curve& c : curves) {
    std::string path;
    bool down = false;
    for (std::size_t i = 0; i < n; ++i) {
      const double v = c.value(i);
      if (std::isfinite(v)) path += fmt::format("{}{:.1f} {:.1f}", down ? "L" : "M", x(i), y(v));
      down = std::isfinite(v);
    }
    svg += fmt::format(
        "<path d='{}' fill='none' stroke='{}' stroke-width='1.5'/><text x='{}' y='{}' fill='{}'>{}</text>",
        path, c.colour, legend, height - 5, c.colour, c.name);
    legend += 110;
  }
  return svg + "</svg>\n";
}

/// Roll, pitch, yaw: R = Rz(yaw) Ry(pitch) Rx(roll) [degrees].
Eigen::Vector3d roll_pitch_yaw(const Eigen::Matrix3d& R) {
  return kDegree * Eigen::Vector3d(std::atan2(R(2, 1), R(2, 2)), std::asin(std::clamp(-R(2, 0), -1.0, 1.0)),
                                   std::atan2(R(1, 0), R(0, 0)));
}

std::vector<Curve> components(const Track& track, const std::array<std::string, 3>& names,
                              const std::function<Eigen::Vector3d(const Pose&)>& of) {
  static const std::array<std::string, 3> colours = {"#c22", "#282", "#24c"}, pale = {"#e99", "#9c9", "#9ae"};
  std::vector<Curve> curves;
  for (int k = 0; k < 3; ++k) {
    if (!track.truth.empty())
      curves.push_back({names[k] + " (truth)", pale[k], [&track, of, k](std::size_t i) {
                          return track.truth[i] ? of(*track.truth[i])[k] : kNaN;
                        }});
    curves.push_back({names[k], colours[k], [&track, of, k](std::size_t i) {
                        return track.tracked[i].has_pose ? of(track.tracked[i].cam_from_object)[k] : kNaN;
                      }});
  }
  return curves;
}

}  // namespace

PoseError pose_error(const Pose& pose, const Pose& truth) {
  return {(pose.t - truth.t).norm(), log({pose.R * truth.R.transpose(), Eigen::Vector3d::Zero()}).norm()};
}

Json track_json(const Track& track) {
  Json frames = Json::array();
  int lost = 0, starts = 0;
  StageSeconds sum;
  for (std::size_t i = 0; i < track.tracked.size(); ++i) {
    const TrackedFrame& f = track.tracked[i];
    frames.push_back(frame_json(track, i));
    lost += f.lost ? 1 : 0;
    starts += f.initialised ? 1 : 0;
    sum.gradient += f.seconds.gradient, sum.keypoints += f.seconds.keypoints,
        sum.texture += f.seconds.texture;
    sum.filter += f.seconds.filter, sum.estimate += f.seconds.estimate, sum.total += f.seconds.total;
  }
  Json json = {{"frames_total", track.tracked.size()},
               {"frames_lost", lost},
               {"starts", starts},
               {"seconds", seconds_json(sum)}};
  if (!track.truth.empty()) json["error"] = error_json(track);
  json["frames"] = frames;
  return json;
}

std::string track_page(const Track& track) {
  const auto& t = track.tracked;
  std::string page =
      "<!doctype html><html lang='en'><meta charset='utf-8'><title>Track</title><style>body{font:15px "
      "sans-serif;margin:2em;"
      "max-width:1000px}svg{max-width:100%}text{font-size:11px}h2{font-size:1em;margin:.8em 0 "
      "0}</style><h1>Track</h1>\n";
  const auto lost = std::count_if(t.begin(), t.end(), [](const TrackedFrame& f) { return f.lost; });
  page += fmt::format("<p>{} frames, {} lost (shaded).</p>\n", t.size(), lost);
  page += plot(track, "Translation, object in camera [mm]",
               components(track, {"x", "y", "z"}, [](const Pose& p) { return Eigen::Vector3d(1e3 * p.t); }));
  page +=
      plot(track, "Rotation [degrees]",
           components(track, {"roll", "pitch", "yaw"}, [](const Pose& p) { return roll_pitch_yaw(p.R); }));
  if (!track.truth.empty()) {
    const auto error = [&track](std::size_t i) -> std::optional<PoseError> {
      if (!track.truth[i] || !track.tracked[i].has_pose) return {};
      return pose_error(track.tracked[i].cam_from_object, *track.truth[i]);
    };
    page += plot(track, "Residual against the truth, translation [mm]",
                 {{"|t|", "#c22", [error](std::size_t i) {
                     const auto e = error(i);
                     return e ? 1e3 * e->translation_m : kNaN;
                   }}});
    page += plot(track, "Residual against the truth, rotation [degrees]",
                 {{"angle", "#24c", [error](std::size_t i) {
                     const auto e = error(i);
                     return e ? kDegree * e->rotation_rad : kNaN;
                   }}});
  }
  page += plot(track, "Robust deviation of the residuals in the picture [px]",
               {{"edges and texture", "#333",
                 [&t](std::size_t i) { return t[i].has_pose ? t[i].deviation_px : kNaN; }}});
  page += plot(track, "Effective number of particles",
               {{"N_eff", "#c22", [&t](std::size_t i) { return t[i].n_eff; }},
                {"particles", "#999", [&t](std::size_t i) { return t[i].particles; }}});
  page += plot(track, "Edge samples",
               {{"visible", "#999", [&t](std::size_t i) { return t[i].edges.visible; }},
                {"matched", "#282", [&t](std::size_t i) { return t[i].edges.matched; }}});
  return page + "</html>\n";
}

}  // namespace stuv::tracking
