#include "calib/solve/report.h"

#include <algorithm>
#include <cmath>

namespace stuv {
namespace {

/// null for what is no number: JSON has no Inf or NaN.
Json number(double value) { return std::isfinite(value) ? Json(value) : Json(nullptr); }

template <class Vector>
Json list(const Vector& v) {
  Json json = Json::array();
  for (Eigen::Index i = 0; i < v.size(); ++i) json.push_back(number(v[i]));
  return json;
}

Json camera_json(const RigCamera& rc, const CameraSummary& summary) {
  const bool known = rc.determined;
  const Camera& camera = rc.camera;
  return {
      {"name", camera.name},
      {"row", rc.row},
      {"col", rc.col},
      {"focal_px", known ? list(Eigen::Vector2d(camera.intrinsics[0], camera.intrinsics[1])) : Json(nullptr)},
      {"position_m", known ? list(camera.cam_from_rig.centre()) : Json(nullptr)},
      {"position_sigma_m", known ? list(rc.position_sigma_m) : Json(nullptr)},
      {"rms_px", number(summary.rms_px)},
      {"determined", known}};
}

Json ghosting_json(const Calibration& c) {
  Json rows = Json::array();
  for (const Ghosting& g : c.ghosting)
    rows.push_back(
        {{"depth_m", number(g.depth_m)},
         {"rms_px", number(g.rms_px)},
         {"worst_px", number(g.worst_px)},
         {"worst_camera",
          g.worst_camera < 0 ? Json(nullptr) : Json(c.observations.camera_names[g.worst_camera])}});
  return rows;
}

}  // namespace

Json report_json(const Calibration& c, double seconds, double seconds_corners) {
  const JointSolution& s = c.solution;
  Json cameras = Json::array();
  for (std::size_t i = 0; i < c.rig.cameras.size(); ++i)
    cameras.push_back(camera_json(c.rig.cameras[i], c.cameras[i]));
  const auto spacing = [](const Eigen::Vector2d& step) {
    return step.norm() > 0 ? Json(step.norm()) : Json(nullptr);
  };
  const double corners = std::max(1, s.inliers + s.outliers);
  return {{"rms_px", number(s.rms_px)},
          {"worst_px", number(s.worst_px)},
          {"outlier_fraction", s.outliers / corners},
          {"cameras", cameras},
          {"plane",
           {{"rms_off_plane_m", number(c.rig.rms_off_plane_m)},
            {"spacing_m", {spacing(c.rig.s_step_m), spacing(c.rig.t_step_m)}}}},
          {"cross_validation_px", c.cross_validation_px ? number(*c.cross_validation_px) : Json(nullptr)},
          {"ghosting", ghosting_json(c)},
          {"verdict", {{"good", c.good}, {"reasons", c.reasons}}},
          {"notes", c.notes},
          {"seconds", seconds},
          {"seconds_corners", seconds_corners}};
}

}  // namespace stuv
