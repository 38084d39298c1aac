#include "core/rig.h"

#include <fmt/format.h>

#include <algorithm>

#include "core/error.h"

namespace stuv {
namespace fs = std::filesystem;
namespace {

constexpr const char* kFormat = "stuv.rig";
constexpr int kVersion = 1;

template <class Vector>
Json list(const Vector& v) {
  Json json = Json::array();
  for (Eigen::Index i = 0; i < v.size(); ++i) json.push_back(v[i]);
  return json;
}

template <class Vector>
Vector vector_from(const Json& json) {
  Vector v;
  for (Eigen::Index i = 0; i < v.size(); ++i) v[i] = json.at(static_cast<std::size_t>(i));
  return v;
}

Json covariance_to_json(const Eigen::MatrixXd& m) {
  Json rows = Json::array();
  for (Eigen::Index i = 0; i < m.rows(); ++i) rows.push_back(list(Eigen::VectorXd(m.row(i))));
  return rows;
}

Eigen::MatrixXd covariance_from_json(const Json& rows) {
  const auto n = static_cast<Eigen::Index>(rows.size());
  Eigen::MatrixXd m(n, n);
  for (Eigen::Index i = 0; i < n; ++i)
    for (Eigen::Index j = 0; j < n; ++j) m(i, j) = rows.at(i).at(j);
  return m;
}

Json sigma_to_json(const RigCamera& rc) {
  return rc.determined && rc.position_sigma_m.allFinite() ? list(rc.position_sigma_m) : Json(nullptr);
}

}  // namespace

int Rig::camera_index(const std::string& name) const {
  const auto it =
      std::find_if(cameras.begin(), cameras.end(), [&](const RigCamera& c) { return c.camera.name == name; });
  return it == cameras.end() ? -1 : static_cast<int>(it - cameras.begin());
}

Rig read_rig(const fs::path& folder) {
  const fs::path file = folder / "rig.json";
  const Json json = read_manifest(file, kFormat, kVersion);
  Rig rig;
  try {
    const Json& lattice = json.at("lattice");
    rig.rows = lattice.at("rows");
    rig.cols = lattice.at("cols");
    rig.lattice_origin_m = vector_from<Eigen::Vector2d>(lattice.at("origin_m"));
    rig.s_step_m = vector_from<Eigen::Vector2d>(lattice.at("s_step_m"));
    rig.t_step_m = vector_from<Eigen::Vector2d>(lattice.at("t_step_m"));
    rig.rms_off_plane_m = json.at("rms_off_plane_m");
    rig.nearest_seen_m = json.at("seen_m").at(0);
    rig.farthest_seen_m = json.at("seen_m").at(1);
    rig.produced_by = json.at("produced_by");
    for (const Json& entry : json.at("cameras")) {
      RigCamera camera;
      const std::string name = entry.at("name");
      camera.determined = entry.at("determined");
      camera.row = entry.at("row");
      camera.col = entry.at("col");
      camera.off_lattice_m = vector_from<Eigen::Vector3d>(entry.at("off_lattice_m"));
      if (!entry.at("position_sigma_m").is_null())
        camera.position_sigma_m = vector_from<Eigen::Vector3d>(entry["position_sigma_m"]);
      camera.camera = read_cameramodel(folder / entry.at("model").get<std::string>());
      camera.camera.name = name;
      rig.cameras.push_back(std::move(camera));
    }
    if (!json.at("centre_covariance_m2").is_null())
      rig.centre_covariance_m2 = covariance_from_json(json["centre_covariance_m2"]);
  } catch (const Json::exception&) {
    throw Error(file.string(), "lacks a field or has one of the wrong type", "calibrate again");
  }
  return rig;
}

void write_rig(const fs::path& folder, const Rig& rig) {
  fs::create_directories(folder / "cameras");
  Json cameras = Json::array();
  for (const RigCamera& rc : rig.cameras) {
    const std::string model = "cameras/" + rc.camera.name + ".cameramodel";
    write_cameramodel(folder / model, rc.camera);
    cameras.push_back({{"name", rc.camera.name},
                       {"row", rc.row},
                       {"col", rc.col},
                       {"model", model},
                       {"determined", rc.determined},
                       {"position_m", rc.determined ? list(rc.camera.cam_from_rig.centre()) : Json(nullptr)},
                       {"position_sigma_m", sigma_to_json(rc)},
                       {"off_lattice_m", list(rc.off_lattice_m)}});
  }
  write_json(
      folder / "rig.json",
      {{"format", kFormat},
       {"version", kVersion},
       {"produced_by", rig.produced_by},
       {"frame",
        "origin: mean of the camera centres; x = s, right along the rows; y = t, down; z into the scene [m]"},
       {"lattice",
        {{"rows", rig.rows},
         {"cols", rig.cols},
         {"origin_m", list(rig.lattice_origin_m)},
         {"s_step_m", list(rig.s_step_m)},
         {"t_step_m", list(rig.t_step_m)}}},
       {"rms_off_plane_m", rig.rms_off_plane_m},
       {"seen_m", {rig.nearest_seen_m, rig.farthest_seen_m}},
       {"cameras", cameras},
       {"centre_covariance_m2",
        rig.centre_covariance_m2.size() > 0 ? covariance_to_json(rig.centre_covariance_m2) : Json(nullptr)}});
}

}  // namespace stuv
