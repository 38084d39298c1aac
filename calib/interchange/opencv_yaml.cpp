#include <fmt/format.h>

#include <algorithm>
#include <opencv2/core.hpp>

#include "calib/interchange/camera_list.h"
#include "calib/interchange/foreign_lens.h"
#include "core/error.h"
#include "core/files.h"

// OpenCV's own calibration files, one a camera: image_width, image_height, camera_matrix,
// distortion_coefficients (4, 5, 8, 12 or 14: OpenCV's order is mrcal's), and R, T: x_cam = R x_rig + T [m].
// OpenCV's pixel (0, 0) is the centre of the top-left pixel, as ours.

namespace stuv {
namespace fs = std::filesystem;
namespace {

const std::string kModels[] = {"LENSMODEL_PINHOLE", "LENSMODEL_OPENCV4", "LENSMODEL_OPENCV5",
                               "LENSMODEL_OPENCV12", "LENSMODEL_OPENCV8"};

cv::Mat matrix_at(const cv::FileStorage& storage, const char* key, const std::string& file) {
  cv::Mat m;
  storage[key] >> m;
  if (m.empty()) throw Error(file, fmt::format("has no matrix '{}'", key), "this is no OpenCV calibration");
  m.convertTo(m, CV_64F);
  return m.reshape(1);
}

void require_size(const cv::Mat& m, int rows, int cols, const char* key, const std::string& file) {
  if (m.rows != rows || m.cols != cols)
    throw Error(file, fmt::format("has a '{}' of {}x{}, not {}x{}", key, m.rows, m.cols, rows, cols),
                "check the file");
}

void read_lens(const cv::FileStorage& storage, const std::string& file, Camera& camera) {
  const cv::Mat K = matrix_at(storage, "camera_matrix", file);
  require_size(K, 3, 3, "camera_matrix", file);
  if (K.at<double>(0, 1) != 0) throw Error(file, "has a skewed camera_matrix", "no lens model here has skew");
  camera.intrinsics = {K.at<double>(0, 0), K.at<double>(1, 1), K.at<double>(0, 2), K.at<double>(1, 2)};
  std::vector<double> d;
  if (!storage["distortion_coefficients"].empty())
    d = matrix_at(storage, "distortion_coefficients", file).reshape(1, 1).clone();
  // Fourteen: the last two tilt the sensor.
  if (d.size() == 14 && d[12] == 0 && d[13] == 0) d.resize(12);
  if (d.size() != 0 && d.size() != 4 && d.size() != 5 && d.size() != 8 && d.size() != 12)
    throw Error(file, fmt::format("has {} distortion coefficients", d.size()),
                "4, 5, 8 or 12 are known, or 14 without tilt");
  camera.lens_model = d.empty() ? "LENSMODEL_PINHOLE" : fmt::format("LENSMODEL_OPENCV{}", d.size());
  camera.intrinsics.insert(camera.intrinsics.end(), d.begin(), d.end());
}

/// The pose if there is one: a file of a single camera needs none.
void read_pose(const cv::FileStorage& storage, const std::string& file, Camera& camera) {
  if (storage["R"].empty() && storage["T"].empty()) return;
  const cv::Mat R = matrix_at(storage, "R", file), T = matrix_at(storage, "T", file).reshape(1, 3);
  require_size(R, 3, 3, "R", file);
  require_size(T, 3, 1, "T", file);
  Eigen::Matrix3d m;
  for (int i = 0; i < 9; ++i) m(i / 3, i % 3) = R.at<double>(i / 3, i % 3);
  camera.cam_from_rig.R = rotation_near(m, file);
  camera.cam_from_rig.t = {T.at<double>(0), T.at<double>(1), T.at<double>(2)};
}

Camera read_one(const fs::path& path) {
  const std::string file = path.string();
  try {
    const cv::FileStorage storage(read_text(path), cv::FileStorage::READ | cv::FileStorage::MEMORY);
    Camera camera;
    camera.name = path.stem().string();
    if (storage["image_width"].empty() || storage["image_height"].empty())
      throw Error(file, "has no image_width, image_height", "add the size of the camera's pictures");
    camera.width = static_cast<int>(storage["image_width"]);
    camera.height = static_cast<int>(storage["image_height"]);
    read_lens(storage, file, camera);
    read_pose(storage, file, camera);
    validate(camera, file);
    return camera;
  } catch (const cv::Exception&) {
    throw Error(file, "is not readable as an OpenCV file", "check it, or restore a copy");
  }
}

std::string text_of(const Camera& camera) {
  const std::vector<double>& k = camera.intrinsics;
  const cv::Mat K = (cv::Mat_<double>(3, 3) << k[0], 0, k[2], 0, k[1], k[3], 0, 0, 1);
  cv::Mat D = cv::Mat::zeros(1, std::max<int>(4, static_cast<int>(k.size()) - 4), CV_64F);
  std::copy(k.begin() + 4, k.end(), D.ptr<double>());
  cv::Mat R(3, 3, CV_64F), T(3, 1, CV_64F);
  for (int i = 0; i < 3; ++i) {
    T.at<double>(i) = camera.cam_from_rig.t[i];
    for (int j = 0; j < 3; ++j) R.at<double>(i, j) = camera.cam_from_rig.R(i, j);
  }
  cv::FileStorage storage(".yml", cv::FileStorage::WRITE | cv::FileStorage::MEMORY);
  storage << "image_width" << camera.width << "image_height" << camera.height << "camera_matrix" << K
          << "distortion_coefficients" << D << "R" << R << "T" << T;
  return storage.releaseAndGetString();
}

}  // namespace

CameraList read_opencv(const fs::path& source) {
  std::vector<fs::path> files = {source};
  if (fs::is_directory(source)) {
    files.clear();
    for (const auto& entry : fs::directory_iterator(source))
      for (const char* extension : {".yml", ".yaml", ".xml", ".json"})
        // export.json lies beside the cameras that this program writes.
        if (entry.path().extension() == extension && entry.path().filename() != "export.json")
          files.push_back(entry.path());
    std::sort(files.begin(), files.end(), [](const fs::path& a, const fs::path& b) {
      return natural_less(a.filename().string(), b.filename().string());
    });
  }
  CameraList cameras;
  for (const fs::path& file : files) cameras.push_back({read_one(file), {}});
  return cameras;
}

void write_opencv(const fs::path& folder, const CameraList& cameras, LensFits& fits) {
  for (const ListedCamera& c : cameras)
    write_text(folder / (c.camera.name + ".yml"), text_of(expressed(c.camera, kModels, "OpenCV", fits)));
}

}  // namespace stuv
