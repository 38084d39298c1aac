#include <fmt/format.h>

#include "calib/interchange/camera_list.h"
#include "calib/interchange/foreign_lens.h"
#include "core/error.h"
#include "core/json.h"

// nerfstudio's transforms.json. transform_matrix: world from camera, whose axes are OpenGL's (x right, y up,
// z out of the scene). The centre of the top-left pixel is (0.5, 0.5), ours (0, 0). Lens parameters stand at
// the top for all frames, or in a frame. OPENCV here: radial 1 + k1 r^2 + k2 r^4 + k3 r^6 (+ k4 r^8, which no
// lens of ours has), tangential p1, p2.

namespace stuv {
namespace {

constexpr double kHalf = 0.5;
const std::string kModels[] = {"LENSMODEL_PINHOLE", "LENSMODEL_OPENCV4", "LENSMODEL_OPENCV5"};
const Eigen::Vector3d kFlip(1, -1, -1);  // OpenGL's axes of a camera to ours, and back

class Transforms {
 public:
  Transforms(std::string file, const Json& json, LensFits& fits)
      : file_(std::move(file)), all_(json), fits_(fits) {}

  CameraList read() {
    std::vector<std::string> files;
    for (const Json& frame : all_.at("frames")) files.push_back(frame.at("file_path"));
    const std::vector<std::string> names = names_from_pictures(files);
    CameraList cameras;
    for (std::size_t i = 0; i < names.size(); ++i) {
      const Json& frame = all_.at("frames").at(i);
      where_ = fmt::format("{}: frame {}", file_, files[i]);
      Camera camera = lens(frame, names[i]);
      camera.cam_from_rig = pose(frame).inverse();
      validate(camera, where_);
      cameras.push_back({std::move(camera), files[i]});
    }
    return cameras;
  }

 private:
  const Json* find(const Json& frame, const char* key) const {
    if (frame.contains(key)) return &frame[key];
    return all_.contains(key) ? &all_[key] : nullptr;
  }
  double number(const Json& frame, const char* key) const {
    const Json* value = find(frame, key);
    if (value == nullptr)
      throw Error(where_, fmt::format("has no {}", key), "this is no whole transforms.json");
    return value->get<double>();
  }
  double number_or_0(const Json& frame, const char* key) const {
    return find(frame, key) == nullptr ? 0 : number(frame, key);
  }

  Camera lens(const Json& frame, const std::string& name) const {
    const Json* named = find(frame, "camera_model");
    const std::string model = named == nullptr ? "OPENCV" : named->get<std::string>();
    Camera camera;
    camera.name = name;
    camera.width = static_cast<int>(number(frame, "w"));
    camera.height = static_cast<int>(number(frame, "h"));
    const double fx = number(frame, "fl_x");
    camera.intrinsics = {fx, find(frame, "fl_y") == nullptr ? fx : number(frame, "fl_y"),
                         number(frame, "cx") - kHalf, number(frame, "cy") - kHalf};
    if (model == "PINHOLE" || model == "SIMPLE_PINHOLE") return camera;
    if (model == "OPENCV_FISHEYE") {
      FisheyeLens fisheye{camera.intrinsics};
      for (const char* key : {"k1", "k2", "k3", "k4"}) fisheye.parameters.push_back(number_or_0(frame, key));
      return camera_of(fisheye, name, camera.width, camera.height, where_, fits_);
    }
    if (model != "OPENCV" && model != "SIMPLE_RADIAL" && model != "RADIAL")
      throw Error(where_, fmt::format("has the camera_model {}", model),
                  "PINHOLE, OPENCV, OPENCV_FISHEYE are known");
    if (number_or_0(frame, "k4") != 0)
      throw Error(where_, "has a k4 in an OPENCV lens, r^8, which no lens model here has",
                  "fit it without k4");
    for (const char* key : {"k1", "k2", "p1", "p2", "k3"})
      camera.intrinsics.push_back(number_or_0(frame, key));
    camera.lens_model = "LENSMODEL_OPENCV5";
    while (camera.intrinsics.back() == 0 && camera.intrinsics.size() == 9) shorten(camera);
    return camera;
  }

  /// Without k3 it is OPENCV4, without any a pinhole.
  static void shorten(Camera& camera) {
    const std::vector<double>& p = camera.intrinsics;
    const bool distorts = p[4] != 0 || p[5] != 0 || p[6] != 0 || p[7] != 0;
    camera.lens_model = distorts ? "LENSMODEL_OPENCV4" : "LENSMODEL_PINHOLE";
    camera.intrinsics.resize(distorts ? 8 : 4);
  }

  /// World from camera, in our axes.
  Pose pose(const Json& frame) const {
    const Json& rows = frame.at("transform_matrix");
    Eigen::Matrix<double, 3, 4> m;
    for (std::size_t i = 0; i < 3; ++i)
      for (std::size_t j = 0; j < 4; ++j) m(i, j) = rows.at(i).at(j);
    return {rotation_near(m.leftCols<3>() * kFlip.asDiagonal(), where_), m.col(3)};
  }

  std::string file_, where_;
  const Json& all_;
  LensFits& fits_;
};

Json frame_of(const ListedCamera& listed, LensFits& fits) {
  const Camera& camera = listed.camera;
  const ExpressedLens lens = expressed_or_fisheye(camera, kModels, "nerfstudio", fits);
  std::vector<double> p = lens.fisheye ? lens.fisheye->parameters : lens.camera.intrinsics;
  const char* model = lens.fisheye ? "OPENCV_FISHEYE" : p.size() == 4 ? "PINHOLE" : "OPENCV";
  p.resize(9, 0);
  Json frame = {{"file_path", listed.picture}, {"camera_model", model}, {"w", camera.width},
                {"h", camera.height},          {"fl_x", p[0]},          {"fl_y", p[1]},
                {"cx", p[2] + kHalf},          {"cy", p[3] + kHalf}};
  const std::vector<const char*> keys =
      lens.fisheye ? std::vector{"k1", "k2", "k3", "k4"} : std::vector{"k1", "k2", "p1", "p2", "k3"};
  if (lens.fisheye || lens.camera.intrinsics.size() > 4)
    for (std::size_t k = 0; k < keys.size(); ++k) frame[keys[k]] = p[4 + k];
  const Pose world_from_cam = camera.cam_from_rig.inverse();
  Eigen::Matrix4d m = Eigen::Matrix4d::Identity();
  m.topLeftCorner<3, 3>() = world_from_cam.R * kFlip.asDiagonal();
  m.topRightCorner<3, 1>() = world_from_cam.t;
  for (int i = 0; i < 4; ++i) frame["transform_matrix"].push_back({m(i, 0), m(i, 1), m(i, 2), m(i, 3)});
  return frame;
}

}  // namespace

CameraList read_nerfstudio(const std::filesystem::path& file, LensFits& fits) {
  const Json json = read_json(file);
  try {
    return Transforms(file.string(), json, fits).read();
  } catch (const Json::exception&) {
    throw Error(file.string(), "lacks a field or has one of the wrong type",
                "this is no whole transforms.json");
  }
}

void write_nerfstudio(const std::filesystem::path& file, const CameraList& cameras, LensFits& fits) {
  Json frames = Json::array();
  for (const ListedCamera& c : cameras) frames.push_back(frame_of(c, fits));
  // Most readers look for the lens model at the top.
  const std::string first = frames.empty() ? "OPENCV" : frames[0]["camera_model"].get<std::string>();
  write_json(file, {{"camera_model", first}, {"frames", frames}});
}

}  // namespace stuv
