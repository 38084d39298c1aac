#pragma once

#include <algorithm>
#include <cmath>
#include <fstream>
#include <functional>
#include <string>
#include <vector>

#include "calib/tracking/edge_search.h"
#include "calib/tracking/object_model.h"
#include "calib/tracking/se3.h"
#include "core/camera.h"
#include "core/parallel.h"

// Pictures of known objects at known poses, made by plain ray casting: nothing here is shared with the
// tracker's own projection, hidden-line or warping code.
namespace stuv::test {

using tracking::Grey;
using tracking::ObjectModel;

/// Wavefront text of a box of the given size, middle at the origin, z towards the camera.
inline std::string box_obj(double x, double y, double z) {
  std::string text;
  for (int i = 0; i < 8; ++i)
    text += "v " + std::to_string((i & 1 ? x : -x) / 2) + " " + std::to_string((i & 2 ? y : -y) / 2) + " " +
            std::to_string((i & 4 ? z : -z) / 2) + "\n";
  return text + "f 1 3 4 2\nf 5 6 8 7\nf 1 2 6 5\nf 3 7 8 4\nf 1 5 7 3\nf 2 4 8 6\n";
}

/// A cylinder along y, closed.
inline std::string cylinder_obj(double radius, double height, int sides) {
  std::string text, bottom = "f", top = "f", walls;
  for (int i = 0; i < sides; ++i) {
    const double a = 2 * M_PI * i / sides;
    for (const double y : {-height / 2, height / 2})
      text += "v " + std::to_string(radius * std::cos(a)) + " " + std::to_string(y) + " " +
              std::to_string(radius * std::sin(a)) + "\n";
    const int k = 2 * i + 1, n = 2 * ((i + 1) % sides) + 1;
    walls += "f " + std::to_string(k) + " " + std::to_string(k + 1) + " " + std::to_string(n + 1) + " " +
             std::to_string(n) + "\n";
    bottom += " " + std::to_string(k);
    top = "f " + std::to_string(k + 1) + top.substr(1);
  }
  return text + bottom + "\n" + top + "\n" + walls;
}

/// A slab with a notch and a slanted side: the outline of a car's door.
inline std::string door_obj() {
  const std::vector<Eigen::Vector2d> outline = {{-0.1, 0.08},  {0.1, 0.08},   {0.1, -0.01},
                                                {0.05, -0.02}, {0.01, -0.09}, {-0.09, -0.09}};
  std::string text, front = "f", back = "f", sides;
  const int n = static_cast<int>(outline.size());
  for (int i = 0; i < n; ++i) {
    for (const double z : {-0.012, 0.012})
      text += "v " + std::to_string(outline[i].x()) + " " + std::to_string(outline[i].y()) + " " +
              std::to_string(z) + "\n";
    const int k = 2 * i + 1, m = 2 * ((i + 1) % n) + 1;
    sides += "f " + std::to_string(k) + " " + std::to_string(m) + " " + std::to_string(m + 1) + " " +
             std::to_string(k + 1) + "\n";
    front += " " + std::to_string(k + 1);
    back = "f " + std::to_string(k) + back.substr(1);
  }
  return text + front + "\n" + back + "\n" + sides;
}

inline double hashed(int x, int y, int z) {
  std::uint64_t h = static_cast<std::uint64_t>(x) * 0x9E3779B97F4A7C15ULL ^
                    static_cast<std::uint64_t>(y) * 0xC2B2AE3D27D4EB4FULL ^
                    static_cast<std::uint64_t>(z) * 0x165667B19E3779F9ULL;
  h ^= h >> 29, h *= 0xBF58476D1CE4E5B9ULL, h ^= h >> 32;
  h *= 0x94D049BB133111EBULL, h ^= h >> 29;
  return static_cast<double>(h >> 11) * 0x1p-53;
}

/// Patches of random brightness, `cell` wide; a print on the object.
inline double patches(const Eigen::Vector3d& x, double cell, int seed) {
  const auto f = [&](double v) { return static_cast<int>(std::floor(v / cell + 0.37)); };
  return hashed(f(x.x()) + 1000 * seed, f(x.y()), f(x.z()));
}

struct Scene {
  ObjectModel model;
  double texture = 0.35;   ///< contrast of the print
  double cell = 0.011;     ///< [m]
  bool cluttered = false;  ///< the object lies on a calibration grid, among scraps
  bool grid = true;        ///< false: among scraps only
  double floor_z = 0.06;   ///< of the plane it lies on: object z [m], behind it
  double reach = 1e3;      ///< no point of the object is farther from its origin [m]
  double gain = 1;         ///< of the exposure
  Eigen::Vector3d light = Eigen::Vector3d(0.4, 0.7, -0.6).normalized();
};

/// Brightness along a ray from `eye` (both in the object's frame).
inline double shade(const Scene& scene, const Eigen::Vector3d& eye, const Eigen::Vector3d& ray) {
  double nearest = 1e300;
  int hit = -1;
  const bool misses = eye.cross(ray).squaredNorm() > scene.reach * scene.reach * ray.squaredNorm();
  for (std::size_t i = 0; !misses && i < scene.model.triangles.size(); ++i) {
    const auto& t = scene.model.triangles[i];
    const Eigen::Vector3d a = scene.model.vertices[t[0]], e1 = scene.model.vertices[t[1]] - a,
                          e2 = scene.model.vertices[t[2]] - a, p = ray.cross(e2);
    const double det = e1.dot(p);
    if (std::abs(det) < 1e-14) continue;
    const Eigen::Vector3d s = eye - a, q = s.cross(e1);
    const double u = s.dot(p) / det, v = ray.dot(q) / det, d = e2.dot(q) / det;
    if (u >= 0 && v >= 0 && u + v <= 1 && d > 0 && d < nearest) nearest = d, hit = static_cast<int>(i);
  }
  if (hit >= 0) {
    const int face = scene.model.face_of_triangle[hit];
    const Eigen::Vector3d x = eye + nearest * ray, n = scene.model.face_normals[face];
    const double lit = 0.45 + 0.4 * std::abs(n.dot(scene.light)) + 0.1 * (n.dot(scene.light) > 0 ? 1 : 0);
    return lit * (1 - scene.texture * (0.6 * patches(x + 1e-7 * n, scene.cell, face + 1) +
                                       0.4 * patches(x + 1e-7 * n, scene.cell * 2.7, face + 77)));
  }
  const double d = (scene.floor_z - eye.z()) / ray.z();
  if (!(d > 0) || !scene.cluttered) return 0.25;
  const Eigen::Vector3d x = eye + d * ray;
  const int i = static_cast<int>(std::floor(x.x() / 0.02)), j = static_cast<int>(std::floor(x.y() / 0.02));
  if (scene.grid && std::abs(x.x()) < 0.16 && std::abs(x.y()) < 0.12) return ((i + j) & 1) != 0 ? 0.85 : 0.15;
  return 0.2 + 0.5 * patches({x.x(), x.y(), 0}, 0.03, 5);
}

/// Where an occluder stands in the picture: a disc of scraps.
struct Disc {
  Eigen::Vector2d at{0, 0};
  double radius_px = 0;
};

/// An 8-bit picture: four samples a pixel, `noise` grey levels of uniform noise seeded by `seed`.
inline Grey photograph(const Scene& scene, const Camera& camera, const std::vector<Pose>& exposure,
                       const Disc& disc = {}, double noise = 4, int seed = 0) {
  std::vector<Eigen::Vector2d> pixels;
  for (int y = 0; y < camera.height; ++y)
    for (int x = 0; x < camera.width; ++x)
      for (int k = 0; k < 4; ++k) pixels.emplace_back(x - 0.25 + 0.5 * (k & 1), y - 0.25 + 0.5 * (k >> 1));
  const std::vector<Eigen::Vector3d> rays = unproject(camera, pixels);
  Grey grey(camera.width, camera.height, 1);
  parallel_for(camera.height, [&](int y) {
    for (int x = 0; x < camera.width; ++x) {
      double sum = 0;
      for (const Pose& pose : exposure)
        for (int k = 0; k < 4; ++k) {
          const std::size_t i = 4 * (static_cast<std::size_t>(y) * camera.width + x) + k;
          if ((pixels[i] - disc.at).norm() < disc.radius_px)
            sum += 0.3 + 0.4 * patches({pixels[i].x() - disc.at.x(), pixels[i].y() - disc.at.y(), 0}, 17, 9);
          else
            sum += shade(scene, pose.centre(), pose.R.transpose() * rays[i]);
        }
      const double level = 255 * scene.gain * sum / (4.0 * static_cast<double>(exposure.size())) +
                           noise * (hashed(x, y, seed) - 0.5);
      grey.at(x, y) = static_cast<std::uint8_t>(std::lround(std::clamp(level, 0.0, 255.0)));
    }
  });
  return grey;
}

/// cam_from_object of a camera in front of the object: distance, turns about the camera's y and x axes [rad],
/// place in the view [m].
inline Pose view_of(double distance, double turn, double tilt, double roll = 0, double x = 0, double y = 0) {
  const Eigen::Matrix3d R =
      (Eigen::AngleAxisd(roll, Eigen::Vector3d::UnitZ()) * Eigen::AngleAxisd(tilt, Eigen::Vector3d::UnitX()) *
       Eigen::AngleAxisd(turn, Eigen::Vector3d::UnitY()))
          .toRotationMatrix();
  return {R, {x, y, distance}};
}

inline ObjectModel model_of(const std::string& obj, const std::filesystem::path& file) {
  std::ofstream(file) << obj;
  return tracking::read_obj(file);
}

inline Camera plain_camera(int width, int height, double focal_px) {
  Camera camera;
  camera.name = "test";
  camera.intrinsics = {focal_px, focal_px, (width - 1) / 2.0, (height - 1) / 2.0};
  camera.width = width;
  camera.height = height;
  return camera;
}

}  // namespace stuv::test
