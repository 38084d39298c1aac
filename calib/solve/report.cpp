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

Json maps_json(const CameraSummary& summary) {
  Json rows = Json::array();
  for (const ProjectionMap& map : summary.maps)
    rows.push_back({{"distance_m", number(map.distance_m)},
                    {"rms_px", number(map.rms_px)},
                    {"worst_px", number(map.worst_px)},
                    {"middle_px", number(map.centre_px)}});
  return rows;
}

/// Rows; null where unknown, or of splines, which have hundreds of parameters.
Json covariance_json(const Eigen::MatrixXd& C) {
  constexpr Eigen::Index kMost = 12;
  if (C.size() == 0 || C.rows() > kMost || !C.allFinite()) return nullptr;
  Json rows = Json::array();
  for (Eigen::Index i = 0; i < C.rows(); ++i) rows.push_back(list(C.row(i)));
  return rows;
}

Json camera_json(const RigCamera& rc, const CameraSummary& summary) {
  const bool known = rc.determined;
  const Camera& camera = rc.camera;
  const auto if_known = [&](const auto& v) { return known ? list(v) : Json(nullptr); };
  return {{"name", camera.name},
          {"row", rc.row},
          {"col", rc.col},
          {"focal_px", if_known(Eigen::Vector2d(camera.intrinsics[0], camera.intrinsics[1]))},
          {"focal_sigma_px", if_known(summary.focal_sigma_px)},
          {"lens_covariance", known ? covariance_json(summary.lens_covariance) : Json(nullptr)},
          {"position_m", if_known(camera.cam_from_rig.centre())},
          {"position_sigma_m", if_known(rc.position_sigma_m)},
          {"rotation_sigma_rad", if_known(summary.rotation_sigma_rad)},
          {"rms_px", number(summary.rms_px)},
          {"noise_px", number(summary.noise_px)},
          {"boards", summary.boards},
          {"coverage", number(summary.coverage)},
          {"tilt_rad", number(summary.seen.tilt_rad)},
          {"projection", maps_json(summary)},
          {"determined", known},
          {"reason", summary.undetermined.empty() ? Json(nullptr) : Json(summary.undetermined)}};
}

Json left_out_json(const Calibration& c) {
  if (!c.validation || !c.validation->left_out) return nullptr;
  const CrossValidation& cv = *c.validation->left_out;
  return {{"folds", cv.folds}, {"rms_px", number(cv.rms_px)}, {"predicted_px", number(cv.predicted_px)}};
}

Json halves_json(const Calibration& c) {
  if (!c.validation || !c.validation->halves) return nullptr;
  const HalfData& h = *c.validation->halves;
  Json cameras = Json::array();
  for (const HalfData::Camera& camera : h.cameras)
    cameras.push_back({{"name", c.observations.camera_names[camera.camera]},
                       {"lens_px", number(camera.lens_px)},
                       {"lens_predicted_px", number(camera.lens_predicted_px)},
                       {"position_m", number(camera.centre_m)},
                       {"position_predicted_m", number(camera.centre_predicted_m)}});
  return {
      {"lens_ratio", number(h.lens_ratio)}, {"position_ratio", number(h.centre_ratio)}, {"cameras", cameras}};
}

Json sigma_json(const Calibration& c) {
  if (!c.validation) return nullptr;
  const SigmaScale& sigma = c.validation->sigma;
  return {{"ratio", number(sigma.ratio)}, {"freedom", number(sigma.freedom)}, {"scale", number(sigma.scale)}};
}

Json structure_json(const Calibration& c) {
  const ResidualStructure& s = c.structure;
  Json sets = Json::array();
  for (const auto& set : s.sets)
    sets.push_back({{"name", c.observations.set_names[set.set]},
                    {"rms_px", number(set.rms_px)},
                    {"shift_px", number(set.view_px)}});
  return {{"by_position", {{"px", number(s.position_px)}, {"ratio", number(s.position_ratio)}}},
          {"by_view", {{"px", number(s.view_px)}, {"ratio", number(s.view_ratio)}}},
          {"by_row", {{"px", number(s.row_px)}, {"ratio", number(s.row_ratio)}}},
          {"sets", sets}};
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
  const auto sigma = [](double step, double value) { return step > 0 ? number(value) : Json(nullptr); };
  const double s_spacing = c.rig.s_step_m.norm(), t_spacing = c.rig.t_step_m.norm();
  const double corners = std::max(1, s.inliers + s.outliers);
  return {
      {"rms_px", number(s.rms_px)},
      {"rms_unweighted_px", number(s.rms_unweighted_px)},
      {"worst_px", number(s.worst_px)},
      {"outlier_fraction", s.outliers / corners},
      {"cameras", cameras},
      {"plane",
       {{"rms_off_plane_m", number(c.rig.rms_off_plane_m)},
        {"spacing_m", {spacing(c.rig.s_step_m), spacing(c.rig.t_step_m)}},
        {"spacing_sigma_m",
         {sigma(s_spacing, c.lattice_sigma.s_spacing_m), sigma(t_spacing, c.lattice_sigma.t_spacing_m)}}}},
      {"cross_validation_px", c.cross_validation_px ? number(*c.cross_validation_px) : Json(nullptr)},
      {"left_out", left_out_json(c)},
      {"half_data", halves_json(c)},
      {"sigma", sigma_json(c)},
      {"residuals", structure_json(c)},
      {"board_warp_m", list(s.warp_m)},
      {"noise_px", number(s.noise_px)},
      {"ghosting", ghosting_json(c)},
      {"verdict", {{"good", c.good}, {"reasons", c.reasons}}},
      {"notes", c.notes},
      {"advice", c.advice},
      {"seconds", seconds},
      {"seconds_corners", seconds_corners}};
}

Eigen::MatrixXd lens_covariance_of(const Json& camera) {
  const Json rows = camera.is_object() ? camera.value("lens_covariance", Json()) : Json();
  if (!rows.is_array() || rows.empty()) return {};
  const auto n = static_cast<Eigen::Index>(rows.size());
  Eigen::MatrixXd C(n, n);
  for (Eigen::Index i = 0; i < n; ++i) {
    if (!rows[i].is_array() || rows[i].size() != rows.size()) return {};
    for (Eigen::Index j = 0; j < n; ++j) {
      if (!rows[i][j].is_number()) return {};
      C(i, j) = rows[i][j].get<double>();
    }
  }
  return C;
}

}  // namespace stuv
