#include <fmt/format.h>
#include <yaml-cpp/yaml.h>

#include <algorithm>

#include "calib/interchange/camera_list.h"
#include "calib/interchange/foreign_lens.h"
#include "core/error.h"
#include "core/files.h"

// Kalibr's camchain.yaml: cam0, cam1, ... with camera_model pinhole, distortion_model none, radtan (k1, k2,
// p1, p2) or equidistant (k1 .. k4), intrinsics fu, fv, pu, pv, resolution, rostopic, and from cam1 on
// T_cn_cnm1, the 4 x 4 matrix that takes points of the camera before it to this one [m]. Pixel (0, 0) is the
// centre of the top-left pixel, as ours. Names: the part of rostopic before the last, /NAME/image_raw.

namespace stuv {
namespace {

const std::string kModels[] = {"LENSMODEL_PINHOLE", "LENSMODEL_OPENCV4"};

class Camchain {
 public:
  Camchain(std::string file, LensFits& fits) : file_(std::move(file)), fits_(fits) {}

  CameraList read(const YAML::Node& root) {
    CameraList cameras;
    std::vector<std::string> topics;
    for (int i = 0; root[fmt::format("cam{}", i)]; ++i) {
      where_ = fmt::format("{}: cam{}", file_, i);
      const YAML::Node node = root[fmt::format("cam{}", i)];
      Camera camera = lens(node);
      if (i > 0) camera.cam_from_rig = matrix(node) * cameras.back().camera.cam_from_rig;
      topics.push_back(node["rostopic"] ? node["rostopic"].as<std::string>() : "");
      cameras.push_back({std::move(camera), {}});
    }
    if (cameras.empty()) throw Error(file_, "has no cam0", "this is no Kalibr camchain");
    name(cameras, topics);
    return cameras;
  }

 private:
  template <class T>
  T get(const YAML::Node& node, const char* key) const {
    if (!node[key]) throw Error(where_, fmt::format("has no {}", key), "this is no whole Kalibr camchain");
    return node[key].as<T>();
  }

  std::vector<double> numbers(const YAML::Node& node, const char* key, std::size_t count) const {
    const auto values = get<std::vector<double>>(node, key);
    if (values.size() != count)
      throw Error(where_, fmt::format("has {} numbers in {}, not {}", values.size(), key, count),
                  "check the file");
    return values;
  }

  Camera lens(const YAML::Node& node) {
    const auto model = get<std::string>(node, "camera_model"),
               distortion = get<std::string>(node, "distortion_model");
    if (model != "pinhole")
      throw Error(where_, fmt::format("has the camera_model {}", model), "only pinhole is known");
    const std::vector<double> size = numbers(node, "resolution", 2);
    Camera camera;
    camera.width = static_cast<int>(size[0]);
    camera.height = static_cast<int>(size[1]);
    camera.intrinsics = numbers(node, "intrinsics", 4);
    if (distortion == "none") return camera;
    if (distortion != "radtan" && distortion != "equidistant")
      throw Error(where_, fmt::format("has the distortion_model {}", distortion),
                  "none, radtan and equidistant are known");
    const std::vector<double> d = numbers(node, "distortion_coeffs", 4);
    camera.intrinsics.insert(camera.intrinsics.end(), d.begin(), d.end());
    camera.lens_model = "LENSMODEL_OPENCV4";
    if (distortion == "radtan") return camera;
    return camera_of(FisheyeLens{camera.intrinsics}, where_, camera.width, camera.height, where_, fits_);
  }

  Pose matrix(const YAML::Node& node) const {
    const auto rows = get<std::vector<std::vector<double>>>(node, "T_cn_cnm1");
    Eigen::Matrix<double, 3, 4> m;
    for (int i = 0; i < 12; ++i) {
      if (rows.size() < 3 || rows[i / 4].size() != 4)
        throw Error(where_, "has a T_cn_cnm1 that is not 4x4", "check the file");
      m(i / 4, i % 4) = rows[i / 4][i % 4];
    }
    return {rotation_near(m.leftCols<3>(), where_), m.col(3)};
  }

  /// By topic if that tells all apart, else cam0, cam1, ...
  void name(CameraList& cameras, const std::vector<std::string>& topics) const {
    std::vector<std::string> names;
    for (const std::string& topic : topics)
      names.push_back(std::filesystem::path(topic).parent_path().filename().string());
    std::vector<std::string> sorted = names;
    std::sort(sorted.begin(), sorted.end());
    const bool tell =
        std::adjacent_find(sorted.begin(), sorted.end()) == sorted.end() && !sorted.front().empty();
    for (std::size_t i = 0; i < cameras.size(); ++i) {
      const std::string before = fmt::format("{}: cam{}", file_, i);
      cameras[i].camera.name = tell ? names[i] : fmt::format("cam{}", i);
      for (LensFit& fit : fits_.made)
        if (fit.camera == before) fit.camera = cameras[i].camera.name;
    }
  }

  std::string file_, where_;
  LensFits& fits_;
};

std::string list(const std::vector<double>& values) { return fmt::format("[{}]", fmt::join(values, ", ")); }

std::string matrix_text(const Pose& pose) {
  std::string text;
  for (int i = 0; i < 3; ++i)
    text += fmt::format("  - [{}, {}, {}, {}]\n", pose.R(i, 0), pose.R(i, 1), pose.R(i, 2), pose.t[i]);
  return text + "  - [0.0, 0.0, 0.0, 1.0]\n";
}

std::string lens_text(const Camera& camera, LensFits& fits) {
  const ExpressedLens lens = expressed_or_fisheye(camera, kModels, "Kalibr", fits);
  std::vector<double> p = lens.fisheye ? lens.fisheye->parameters : lens.camera.intrinsics;
  p.resize(8, 0);  // a pinhole: radtan without distortion, which every reader knows
  return fmt::format(
      "  camera_model: pinhole\n  distortion_coeffs: {}\n  distortion_model: {}\n  intrinsics: {}\n"
      "  resolution: [{}, {}]\n  rostopic: /{}/image_raw\n",
      list({p.begin() + 4, p.end()}), lens.fisheye ? "equidistant" : "radtan",
      list({p.begin(), p.begin() + 4}), camera.width, camera.height, camera.name);
}

}  // namespace

CameraList read_kalibr(const std::filesystem::path& file, LensFits& fits) {
  const std::string text = read_text(file);
  try {
    return Camchain(file.string(), fits).read(YAML::Load(text));
  } catch (const YAML::Exception& e) {
    throw Error(e.mark.is_null() ? file.string() : fmt::format("{}:{}", file.string(), e.mark.line + 1),
                e.msg, "this is no Kalibr camchain");
  }
}

void write_kalibr(const std::filesystem::path& file, const CameraList& cameras, LensFits& fits) {
  std::string text;
  for (std::size_t i = 0; i < cameras.size(); ++i) {
    const Camera& camera = cameras[i].camera;
    text += fmt::format("cam{}:\n{}", i, lens_text(camera, fits));
    if (i == 0) continue;
    text +=
        "  T_cn_cnm1:\n" + matrix_text(camera.cam_from_rig * cameras[i - 1].camera.cam_from_rig.inverse());
  }
  write_text(file, text);
}

}  // namespace stuv
