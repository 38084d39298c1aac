#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <map>
#include <sstream>

#include "calib/interchange/camera_list.h"
#include "calib/interchange/foreign_lens.h"
#include "core/error.h"
#include "core/files.h"

// COLMAP's text model: cameras.txt, images.txt, points3D.txt and, from 3.12 on, rigs.txt and frames.txt.
// Poses are quaternions (w, x, y, z) and translations, camera from world. The centre of COLMAP's top-left
// pixel is (0.5, 0.5), ours (0, 0).

namespace stuv {
namespace fs = std::filesystem;
namespace {

constexpr double kHalf = 0.5;  // COLMAP's pixel = ours + 0.5
const std::string kModels[] = {"LENSMODEL_PINHOLE", "LENSMODEL_OPENCV4", "LENSMODEL_OPENCV8"};

/// Lines of a file that are no comments, with their numbers.
struct Line {
  int number = 0;
  std::string text;
};

std::vector<Line> lines_of(const fs::path& file) {
  std::istringstream in(read_text(file));
  std::vector<Line> lines;
  std::string text;
  for (int number = 1; std::getline(in, text); ++number) {
    if (!text.empty() && text.back() == '\r') text.pop_back();
    if (text.empty() || text[0] != '#') lines.push_back({number, text});
  }
  return lines;
}

/// Words of a line, taken one after the other.
class Words {
 public:
  Words(const fs::path& file, const Line& line)
      : where_(fmt::format("{}:{}", file.string(), line.number)), in_(line.text) {}

  std::string word() {
    std::string text;
    if (!(in_ >> text)) fail("ends too early");
    return text;
  }
  double number() {
    const std::string text = word();
    double value = 0;
    const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
    if (error != std::errc() || end != text.data() + text.size())
      fail(fmt::format("'{}' is no number", text));
    return value;
  }
  int whole() { return static_cast<int>(number()); }
  Pose pose() {
    Eigen::Quaterniond q;
    q.w() = number(), q.x() = number(), q.y() = number(), q.z() = number();
    if (!(q.norm() > 0.5 && q.norm() < 2)) fail("has a quaternion that is none");
    Pose p;
    p.R = q.normalized().toRotationMatrix();
    for (int i = 0; i < 3; ++i) p.t[i] = number();
    return p;
  }
  std::string rest() {
    std::string text;
    std::getline(in_ >> std::ws, text);
    return text;
  }
  [[noreturn]] void fail(const std::string& problem) const {
    throw Error(where_, problem, "this is no COLMAP text model (`colmap model_converter --output_type TXT`)");
  }
  const std::string& where() const { return where_; }

 private:
  std::string where_;
  std::istringstream in_;
};

/// Where a COLMAP model's parameters belong in (fx, fy, cx, cy, k1, k2, p1, p2, k3, k4, k5, k6).
struct Model {
  const char* name;
  std::vector<int> places;  ///< of its parameters; -1: fx and fy
  bool fisheye;
};
const Model kColmapModels[] = {{"SIMPLE_PINHOLE", {-1, 2, 3}, false},
                               {"PINHOLE", {0, 1, 2, 3}, false},
                               {"SIMPLE_RADIAL", {-1, 2, 3, 4}, false},
                               {"RADIAL", {-1, 2, 3, 4, 5}, false},
                               {"OPENCV", {0, 1, 2, 3, 4, 5, 6, 7}, false},
                               {"FULL_OPENCV", {0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11}, false},
                               {"SIMPLE_RADIAL_FISHEYE", {-1, 2, 3, 4}, true},
                               {"RADIAL_FISHEYE", {-1, 2, 3, 4, 5}, true},
                               {"OPENCV_FISHEYE", {0, 1, 2, 3, 4, 5, 6, 7}, true}};

Camera read_lens(Words& words, const std::string& name, LensFits& fits) {
  const std::string model = words.word();
  const auto* known = std::find_if(std::begin(kColmapModels), std::end(kColmapModels),
                                   [&](const Model& m) { return model == m.name; });
  if (known == std::end(kColmapModels))
    throw Error(words.where(), fmt::format("has the camera model {}", model),
                "use one of OPENCV, FULL_OPENCV, OPENCV_FISHEYE or a simpler one");
  const int width = words.whole(), height = words.whole();
  std::vector<double> p(12, 0);
  for (const int place : known->places) {
    const double value = words.number();
    if (place < 0)
      p[0] = p[1] = value;
    else
      p[place] = value;
  }
  p[2] -= kHalf, p[3] -= kHalf;
  const std::size_t count = known->places.size();
  if (known->fisheye) {
    p.resize(8);
    return camera_of(FisheyeLens{p}, name, width, height, words.where(), fits);
  }
  Camera camera;
  camera.name = name;
  camera.width = width, camera.height = height;
  camera.lens_model = count == 12                             ? "LENSMODEL_OPENCV8"
                      : count > 4 || known->places.back() > 3 ? "LENSMODEL_OPENCV4"
                                                              : "LENSMODEL_PINHOLE";
  p.resize(count == 12 ? 12 : camera.lens_model == "LENSMODEL_OPENCV4" ? 8 : 4);
  camera.intrinsics = p;
  return camera;
}

struct Picture {
  int camera = 0;
  Pose cam_from_world;
  std::string name;
};

std::vector<Picture> read_pictures(const fs::path& file) {
  std::vector<Picture> pictures;
  const std::vector<Line> lines = lines_of(file);
  for (std::size_t i = 0; i < lines.size(); ++i) {
    if (lines[i].text.find_first_not_of(" \t") == std::string::npos) continue;
    Words words(file, lines[i]);
    words.number();  // its own number
    Picture picture;
    picture.cam_from_world = words.pose();
    picture.camera = words.whole();
    picture.name = words.rest();
    pictures.push_back(std::move(picture));
    ++i;  // the line of its points, empty or not
  }
  return pictures;
}

/// Poses of cameras in a rig, and the one that is its frame.
struct ColmapRig {
  int reference = 0;
  std::map<int, Pose> cam_from_rig;
};

/// The rig with the most sensors; without cameras if none has two.
ColmapRig read_rigs(const fs::path& file) {
  std::error_code ec;
  ColmapRig best;
  if (!fs::exists(file, ec)) return best;
  for (const Line& line : lines_of(file)) {
    if (line.text.find_first_not_of(" \t") == std::string::npos) continue;
    Words words(file, line);
    words.number();
    const int sensors = words.whole();
    ColmapRig rig;
    for (int i = 0; i < sensors; ++i) {
      const bool is_camera = words.word() == "CAMERA";
      const int id = words.whole();
      const bool placed = i == 0 || words.whole() != 0;
      const Pose pose = i > 0 && placed ? words.pose() : Pose{};
      if (i == 0) rig.reference = id;
      if (is_camera && placed) rig.cam_from_rig[id] = pose;
    }
    if (rig.cam_from_rig.size() > std::max<std::size_t>(1, best.cam_from_rig.size())) best = rig;
  }
  return best;
}

/// One of each camera of the rig: the first picture that it took, placed where the rig's frame was in the
/// first picture of its reference.
std::vector<Picture> pictures_of_rig(const std::vector<Picture>& pictures, const ColmapRig& rig) {
  const auto first_of = [&](int camera) {
    return std::find_if(pictures.begin(), pictures.end(),
                        [&](const Picture& p) { return p.camera == camera; });
  };
  const auto reference = first_of(rig.reference);
  const Pose rig_from_world = reference == pictures.end() ? Pose{} : reference->cam_from_world;
  std::vector<Picture> result;
  for (const auto& [id, pose] : rig.cam_from_rig) {
    const auto first = first_of(id);
    result.push_back(
        {id, pose * rig_from_world, first == pictures.end() ? fmt::format("camera{}", id) : first->name});
  }
  return result;
}

std::string pose_text(const Pose& pose) {
  Eigen::Quaterniond q(pose.R);
  if (q.w() < 0) q.coeffs() = -q.coeffs();
  return fmt::format("{} {} {} {} {} {} {}", q.w(), q.x(), q.y(), q.z(), pose.t.x(), pose.t.y(), pose.t.z());
}

std::string lens_text(const Camera& camera, LensFits& fits) {
  const ExpressedLens lens = expressed_or_fisheye(camera, kModels, "COLMAP", fits);
  std::vector<double> p = lens.fisheye ? lens.fisheye->parameters : lens.camera.intrinsics;
  p[2] += kHalf, p[3] += kHalf;
  const char* model = lens.fisheye    ? "OPENCV_FISHEYE"
                      : p.size() == 4 ? "PINHOLE"
                      : p.size() == 8 ? "OPENCV"
                                      : "FULL_OPENCV";
  return fmt::format("{} {} {} {}", model, camera.width, camera.height, fmt::join(p, " "));
}

/// COLMAP's names are relative to its folder of pictures.
std::string picture_name(const ListedCamera& c) { return fs::path(c.picture).filename().string(); }

}  // namespace

CameraList read_colmap(const fs::path& folder, LensFits& fits) {
  const std::vector<Picture> all = read_pictures(folder / "images.txt");
  const ColmapRig rig = read_rigs(folder / "rigs.txt");
  const std::vector<Picture> pictures = rig.cam_from_rig.empty() ? all : pictures_of_rig(all, rig);
  std::vector<std::string> files;
  for (const Picture& p : pictures) files.push_back(p.name);
  const std::vector<std::string> names = names_from_pictures(files);
  std::map<int, Line> lenses;
  for (const Line& line : lines_of(folder / "cameras.txt")) {
    if (line.text.find_first_not_of(" \t") == std::string::npos) continue;
    Words words(folder / "cameras.txt", line);
    lenses[words.whole()] = line;
  }
  CameraList cameras;
  for (std::size_t i = 0; i < pictures.size(); ++i) {
    const auto line = lenses.find(pictures[i].camera);
    if (line == lenses.end())
      throw Error((folder / "cameras.txt").string(), fmt::format("has no camera {}", pictures[i].camera),
                  "the model is not whole: export it again");
    Words words(folder / "cameras.txt", line->second);
    words.number();
    Camera camera = read_lens(words, names[i], fits);
    camera.cam_from_rig = pictures[i].cam_from_world;
    validate(camera, words.where());
    cameras.push_back({std::move(camera), pictures[i].name});
  }
  return cameras;
}

void write_colmap(const fs::path& folder, const CameraList& cameras, LensFits& fits) {
  if (cameras.empty()) throw Error(folder.string(), "would hold no camera", "calibrate first");
  // The first camera is the rig's reference; the rig's frame is the world.
  const Pose ref_from_world = cameras[0].camera.cam_from_rig, world_from_ref = ref_from_world.inverse();
  const std::size_t n = cameras.size();
  std::string lenses = "# Camera list: CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n";
  std::string images =
      "# Image list, two lines each: IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME\n"
      "#   POINTS2D[] as (X, Y, POINT3D_ID)\n";
  std::string rigs =
      "# Rigs: RIG_ID, NUM_SENSORS, REF_SENSOR_TYPE, REF_SENSOR_ID, SENSORS[] as (SENSOR_TYPE, "
      "SENSOR_ID, HAS_POSE, [QW, QX, QY, QZ, TX, TY, TZ])\n" +
      fmt::format("1 {} CAMERA 1", n);
  std::string frames =
      "# Frames: FRAME_ID, RIG_ID, RIG_FROM_WORLD[QW, QX, QY, QZ, TX, TY, TZ], NUM_DATA_IDS, "
      "DATA_IDS[] as (SENSOR_TYPE, SENSOR_ID, DATA_ID)\n" +
      fmt::format("1 1 {} {}", pose_text(ref_from_world), n);
  for (std::size_t i = 0; i < n; ++i) {
    const Camera& camera = cameras[i].camera;
    lenses += fmt::format("{} {}\n", i + 1, lens_text(camera, fits));
    images += fmt::format("{} {} {} {}\n\n", i + 1, pose_text(camera.cam_from_rig), i + 1,
                          picture_name(cameras[i]));
    if (i > 0) rigs += fmt::format(" CAMERA {} 1 {}", i + 1, pose_text(camera.cam_from_rig * world_from_ref));
    frames += fmt::format(" CAMERA {} {}", i + 1, i + 1);
  }
  write_text(folder / "cameras.txt", lenses);
  write_text(folder / "images.txt", images);
  write_text(folder / "points3D.txt",
             "# 3D points: POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[] as (IMAGE_ID, POINT2D_IDX)\n");
  write_text(folder / "rigs.txt", rigs + "\n");
  write_text(folder / "frames.txt", frames + "\n");
}

}  // namespace stuv
