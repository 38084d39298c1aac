#include <fmt/format.h>

#include <algorithm>

#include "calib/interchange/camera_list.h"
#include "calib/interchange/foreign_lens.h"
#include "calib/interchange/npy.h"
#include "core/error.h"
#include "core/files.h"

// LLFF's poses_bounds.npy: a row of 17 numbers a view, in ASCII order of the pictures' names in images/: a 3
// x 5 matrix row by row, [down right back centre (height, width, focal)], the axes of the camera and its
// centre in the world, and the depths of the nearest and the farthest thing. One focal length, principal
// point in the middle of the picture, no distortion.

namespace stuv {
namespace fs = std::filesystem;
namespace {

constexpr Eigen::Index kColumns = 17;

Camera camera_from(const Eigen::Matrix<double, 3, 5>& m, const std::string& where) {
  Camera camera;
  camera.height = static_cast<int>(m(0, 4));
  camera.width = static_cast<int>(m(1, 4));
  camera.intrinsics = {m(2, 4), m(2, 4), 0.5 * (camera.width - 1), 0.5 * (camera.height - 1)};
  Eigen::Matrix3d world_from_cam;
  world_from_cam << m.col(1), m.col(0), -m.col(2);  // right, down, forward
  const Pose pose{rotation_near(world_from_cam, where), m.col(3)};
  camera.cam_from_rig = pose.inverse();
  return camera;
}

/// The pictures beside the file, in ASCII order; empty if there is no folder of them.
std::vector<std::string> pictures_beside(const fs::path& file) {
  std::vector<std::string> names;
  std::error_code ec;
  for (const auto& entry : fs::directory_iterator(file.parent_path() / "images", ec))
    names.push_back(entry.path().filename().string());
  std::sort(names.begin(), names.end());
  return names;
}

}  // namespace

CameraList read_llff(const fs::path& file) {
  const RowMatrix rows = read_npy(file);
  if (rows.cols() != kColumns)
    throw Error(file.string(), fmt::format("has {} columns, not {}", rows.cols(), kColumns),
                "this is no poses_bounds.npy");
  std::vector<std::string> pictures = pictures_beside(file);
  if (!pictures.empty() && static_cast<Eigen::Index>(pictures.size()) != rows.rows())
    throw Error(file.string(),
                fmt::format("has {} views, images/ beside it {} files", rows.rows(), pictures.size()),
                "keep in images/ what belongs to it");
  for (Eigen::Index i = static_cast<Eigen::Index>(pictures.size()); i < rows.rows(); ++i)
    pictures.push_back(fmt::format("view{:03}", i));
  const std::vector<std::string> names = names_from_pictures(pictures);
  CameraList cameras;
  for (Eigen::Index i = 0; i < rows.rows(); ++i) {
    const std::string where = fmt::format("{}: view {}", file.string(), names[i]);
    const Eigen::RowVectorXd row = rows.row(i);
    Eigen::Matrix<double, 3, 5> m;
    for (Eigen::Index k = 0; k < 15; ++k) m(k / 5, k % 5) = row[k];
    ListedCamera listed{camera_from(m, where), pictures[i]};
    listed.camera.name = names[i];
    listed.near_m = row[15];
    listed.far_m = row[16];
    validate(listed.camera, where);
    cameras.push_back(std::move(listed));
  }
  return cameras;
}

void write_llff(const fs::path& file, const CameraList& cameras, LensFits& fits) {
  CameraList ordered = cameras;
  std::sort(ordered.begin(), ordered.end(),
            [](const ListedCamera& a, const ListedCamera& b) { return a.picture < b.picture; });
  RowMatrix rows(static_cast<Eigen::Index>(ordered.size()), kColumns);
  for (std::size_t i = 0; i < ordered.size(); ++i) {
    const Camera& camera = ordered[i].camera;
    double worst_px = 0;
    const double focal = fit_centred_pinhole(camera, worst_px);
    if (!(worst_px <= fits.most_px))
      throw Error(
          fmt::format("camera {}", camera.name),
          fmt::format(
              "LLFF has only a pinhole with its principal point in the middle, off by up to {:.3g} px, "
              "more than {:g}",
              worst_px, fits.most_px),
          "choose another format, or accept the error with --fit-px");
    if (worst_px > 1e-9) fits.made.push_back({camera.name, camera.lens_model, "centred pinhole", worst_px});
    if (!(ordered[i].near_m > 0))
      throw Error(fmt::format("camera {}", camera.name),
                  "LLFF wants the scene's depths, which nobody has said", "give --depth-m NEAR,FAR");
    const Pose world_from_cam = camera.cam_from_rig.inverse();
    Eigen::Matrix<double, 3, 5> m;
    m << world_from_cam.R.col(1), world_from_cam.R.col(0), -world_from_cam.R.col(2), world_from_cam.t,
        Eigen::Vector3d(camera.height, camera.width, focal);
    for (Eigen::Index k = 0; k < 15; ++k) rows(static_cast<Eigen::Index>(i), k) = m(k / 5, k % 5);
    rows(static_cast<Eigen::Index>(i), 15) = ordered[i].near_m;
    rows(static_cast<Eigen::Index>(i), 16) = ordered[i].far_m;
  }
  write_npy(file, rows);
}

}  // namespace stuv
