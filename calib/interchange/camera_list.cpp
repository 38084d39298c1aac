#include "calib/interchange/camera_list.h"

#include <fmt/format.h>

#include <algorithm>
#include <set>

#include "calib/solve/lattice.h"
#include "core/error.h"
#include "core/files.h"

namespace stuv {
namespace fs = std::filesystem;
namespace {

std::vector<fs::path> files_with(const fs::path& folder, const std::vector<std::string>& extensions) {
  std::vector<fs::path> files;
  std::error_code ec;
  for (const auto& entry : fs::directory_iterator(folder, ec))
    if (std::find(extensions.begin(), extensions.end(), entry.path().extension()) != extensions.end())
      files.push_back(entry.path());
  std::sort(files.begin(), files.end(), [](const fs::path& a, const fs::path& b) {
    return natural_less(a.filename().string(), b.filename().string());
  });
  return files;
}

CameraList read_mrcal(const fs::path& source) {
  std::vector<fs::path> files = {source};
  if (fs::is_directory(source)) files = files_with(source, {".cameramodel"});
  CameraList cameras;
  for (const fs::path& file : files) cameras.push_back({read_cameramodel(file), {}});
  return cameras;
}

void write_mrcal(const fs::path& folder, const CameraList& cameras) {
  for (const ListedCamera& c : cameras)
    write_cameramodel(folder / (c.camera.name + ".cameramodel"), c.camera);
}

/// The file itself, or the one of that name in a folder.
fs::path file_in(const fs::path& source, const std::string& name) {
  return fs::is_directory(source) ? source / name : source;
}

bool contains(const fs::path& file, const char* text) {
  std::error_code ec;
  if (!fs::is_regular_file(file, ec)) return false;
  return read_text(file).find(text) != std::string::npos;
}

std::optional<CameraFormat> recognise_folder(const fs::path& folder) {
  std::error_code ec;
  if (fs::exists(folder / "cameras.txt", ec) && fs::exists(folder / "images.txt", ec))
    return CameraFormat::colmap;
  if (fs::exists(folder / "transforms.json", ec)) return CameraFormat::nerfstudio;
  if (fs::exists(folder / "poses_bounds.npy", ec)) return CameraFormat::llff;
  if (fs::exists(folder / "camchain.yaml", ec)) return CameraFormat::kalibr;
  if (!files_with(folder, {".cameramodel"}).empty()) return CameraFormat::mrcal;
  for (const fs::path& file : files_with(folder, {".yml", ".yaml", ".xml", ".json"}))
    if (contains(file, "camera_matrix")) return CameraFormat::opencv;
  return std::nullopt;
}

bool all_different(const std::vector<std::string>& names) {
  return std::set<std::string>(names.begin(), names.end()).size() == names.size();
}

}  // namespace

const char* name_of(CameraFormat format) {
  switch (format) {
    case CameraFormat::mrcal:
      return "mrcal";
    case CameraFormat::opencv:
      return "opencv";
    case CameraFormat::kalibr:
      return "kalibr";
    case CameraFormat::colmap:
      return "colmap";
    case CameraFormat::nerfstudio:
      return "nerfstudio";
    default:
      return "llff";
  }
}

std::optional<CameraFormat> recognise_cameras(const fs::path& source) {
  std::error_code ec;
  if (!fs::exists(source, ec)) throw Error(source.string(), "does not exist", "check the path");
  if (fs::is_directory(source, ec)) return recognise_folder(source);
  const std::string extension = source.extension().string();
  if (extension == ".cameramodel") return CameraFormat::mrcal;
  if (extension == ".npy") return CameraFormat::llff;
  if (contains(source, "camera_matrix")) return CameraFormat::opencv;
  if (contains(source, "transform_matrix")) return CameraFormat::nerfstudio;
  if (contains(source, "distortion_model") && contains(source, "cam0")) return CameraFormat::kalibr;
  return std::nullopt;
}

CameraList read_cameras(const fs::path& source, CameraFormat format, LensFits& fits) {
  const fs::path file = file_in(source, file_name_of(format));
  switch (format) {
    case CameraFormat::mrcal:
      return read_mrcal(source);
    case CameraFormat::opencv:
      return read_opencv(source);
    case CameraFormat::kalibr:
      return read_kalibr(file, fits);
    case CameraFormat::colmap:
      return read_colmap(source, fits);
    case CameraFormat::nerfstudio:
      return read_nerfstudio(file, fits);
    default:
      return read_llff(file);
  }
}

std::string file_name_of(CameraFormat format) {
  switch (format) {
    case CameraFormat::kalibr:
      return "camchain.yaml";
    case CameraFormat::nerfstudio:
      return "transforms.json";
    case CameraFormat::llff:
      return "poses_bounds.npy";
    default:
      return "";
  }
}

void write_cameras(const fs::path& target, CameraFormat format, const CameraList& cameras, LensFits& fits) {
  const fs::path file = file_in(target, file_name_of(format));
  switch (format) {
    case CameraFormat::mrcal:
      return write_mrcal(target, cameras);
    case CameraFormat::opencv:
      return write_opencv(target, cameras, fits);
    case CameraFormat::kalibr:
      return write_kalibr(file, cameras, fits);
    case CameraFormat::colmap:
      return write_colmap(target, cameras, fits);
    case CameraFormat::nerfstudio:
      return write_nerfstudio(file, cameras, fits);
    default:
      return write_llff(file, cameras, fits);
  }
}

CameraList cameras_of(const Rig& rig) {
  CameraList cameras;
  for (const RigCamera& rc : rig.cameras) {
    if (!rc.determined) continue;
    ListedCamera listed{rc.camera, "images/" + rc.camera.name + ".png"};
    if (rig.nearest_seen_m > 0) listed.near_m = rig.nearest_seen_m, listed.far_m = rig.farthest_seen_m;
    cameras.push_back(std::move(listed));
  }
  return cameras;
}

Rig rig_of(const CameraList& cameras, double unit_m, const std::string& source) {
  if (cameras.empty()) throw Error(source, "holds no camera", "check the file and --format");
  std::vector<PlacedCamera> placed;
  std::vector<std::string> names;
  for (const ListedCamera& c : cameras) {
    Pose pose = c.camera.cam_from_rig;
    pose.t *= unit_m;
    placed.push_back({pose, 0, static_cast<int>(placed.size())});
    names.push_back(c.camera.name);
  }
  if (!all_different(names)) throw Error(source, "has two cameras of one name", "rename one");
  const Layout layout = fit_layout(placed, 1, static_cast<int>(cameras.size()));
  Rig rig;
  set_lattice(layout, rig);
  rig.nearest_seen_m = std::numeric_limits<double>::infinity();
  for (std::size_t i = 0; i < cameras.size(); ++i) {
    RigCamera rc;
    rc.camera = cameras[i].camera;
    rc.camera.cam_from_rig = placed[i].cam_from_ref * layout.rig_from_ref.inverse();
    rc.row = layout.row[i];
    rc.col = layout.col[i];
    rc.off_lattice_m = layout.off_lattice_m[i];
    validate(rc.camera, fmt::format("{}: camera {}", source, rc.camera.name));
    rig.cameras.push_back(std::move(rc));
    if (!(cameras[i].near_m > 0)) continue;
    rig.nearest_seen_m = std::min(rig.nearest_seen_m, unit_m * cameras[i].near_m);
    rig.farthest_seen_m = std::max(rig.farthest_seen_m, unit_m * cameras[i].far_m);
  }
  if (!std::isfinite(rig.nearest_seen_m)) rig.nearest_seen_m = rig.farthest_seen_m = 0;
  return rig;
}

std::vector<std::string> names_from_pictures(const std::vector<std::string>& paths) {
  std::vector<std::string> stems, folders, whole;
  for (const std::string& text : paths) {
    const fs::path path(text);
    stems.push_back(path.stem().string());
    folders.push_back(path.parent_path().filename().string());
    whole.push_back(path.parent_path().empty() ? stems.back() : (path.parent_path() / path.stem()).string());
    std::replace(whole.back().begin(), whole.back().end(), '/', '_');
  }
  if (all_different(stems)) return stems;
  return all_different(folders) ? folders : whole;
}

Eigen::Matrix3d rotation_near(const Eigen::Matrix3d& matrix, const std::string& where) {
  const Eigen::JacobiSVD<Eigen::Matrix3d> svd(matrix, Eigen::ComputeFullU | Eigen::ComputeFullV);
  const Eigen::Matrix3d R = svd.matrixU() * svd.matrixV().transpose();
  if (!matrix.allFinite() || R.determinant() < 0 || (R - matrix).norm() > 0.01)
    throw Error(where, "has a rotation that is none", "check the file");
  return R;
}

}  // namespace stuv
