#include "calib/tracking/keyframes.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <opencv2/calib3d.hpp>
#include <opencv2/features2d.hpp>
#include <opencv2/flann.hpp>
#include <random>

#include "core/error.h"
#include "core/image_io.h"
#include "core/json.h"

namespace stuv::tracking {
namespace {

constexpr const char* kFormat = "stuv.keyframes";
constexpr int kVersion = 1;
constexpr int kDescriptorSize = 128;
/// Keypoints of a plain object are weak: half of SIFT's usual contrast.
constexpr double kContrast = 0.02;

/// In clutter many matches that pass the usual ratio are wrong, and a set of 7 is seldom right: where so many
/// pass a stricter one, those do.
constexpr double kStrictRatio = 0.6;
constexpr std::size_t kEnoughMatches = 14;

struct Found {
  std::vector<Eigen::Vector2d> pixels;
  Raster<std::uint8_t> descriptors;
};

Found find_keypoints(const Grey& picture) {
  const cv::Mat grey(picture.height, picture.width, CV_8U, const_cast<std::uint8_t*>(picture.data.data()));
  std::vector<cv::KeyPoint> keypoints;
  cv::Mat descriptors, bytes;
  cv::SIFT::create(0, 3, kContrast)->detectAndCompute(grey, cv::noArray(), keypoints, descriptors);
  descriptors.convertTo(bytes, CV_8U);  // SIFT's are whole numbers 0..255
  Found found;
  found.descriptors = Raster<std::uint8_t>(kDescriptorSize, static_cast<int>(keypoints.size()), 1);
  for (std::size_t i = 0; i < keypoints.size(); ++i) {
    found.pixels.emplace_back(keypoints[i].pt.x, keypoints[i].pt.y);
    std::copy_n(bytes.ptr(static_cast<int>(i)), kDescriptorSize, found.descriptors.row(static_cast<int>(i)));
  }
  return found;
}

/// Depth along a ray of the camera's frame (z = 1) to the nearest triangle; Inf if it meets none.
double nearest_depth(const ObjectModel& model, const std::vector<Eigen::Vector3d>& cam,
                     const Eigen::Vector3d& ray) {
  double nearest = std::numeric_limits<double>::infinity();
  for (const auto& [i, j, k] : model.triangles) {
    Eigen::Matrix3d A;
    A << cam[i], cam[j], cam[k];
    // ray * depth = A b, b >= 0, sum b = 1
    const Eigen::Vector3d b = A.partialPivLu().solve(ray);
    if (!b.allFinite() || b.minCoeff() < 0 || !(b.sum() > 0)) continue;
    nearest = std::min(nearest, 1 / b.sum());
  }
  return nearest;
}

Json pair_json(const Eigen::Vector2d& q, const Eigen::Vector3d& x) {
  return {q.x(), q.y(), x.x(), x.y(), x.z()};
}

Image as_image(const Raster<std::uint8_t>& pixels) {
  Image image;
  image.width = pixels.width;
  image.height = pixels.height;
  image.bytes.resize(pixels.data.size());
  std::transform(pixels.data.begin(), pixels.data.end(), image.bytes.begin(),
                 [](std::uint8_t v) { return std::byte{v}; });
  return image;
}

Raster<std::uint8_t> read_bytes(const std::filesystem::path& file) {
  const Image image = read_image(file);
  if (image.channels != 1 || image.type != PixelType::u8)
    throw Error(file.string(), "is not an 8-bit picture of one channel", "teach the keyframes again");
  Raster<std::uint8_t> pixels(image.width, image.height, 1);
  std::transform(image.bytes.begin(), image.bytes.end(), pixels.data.begin(),
                 [](std::byte b) { return static_cast<std::uint8_t>(b); });
  return pixels;
}

Keyframe read_keyframe(const std::filesystem::path& folder, const Json& json) {
  Keyframe keyframe;
  keyframe.name = json.at("name").get<std::string>();
  keyframe.cam_from_object = pose_from_json(json.at("cam_from_object"));
  keyframe.picture = read_bytes(folder / (keyframe.name + ".png"));
  for (const Json& k : json.at("keypoints")) {
    keyframe.pixels.emplace_back(k.at(0).get<double>(), k.at(1).get<double>());
    keyframe.points.emplace_back(k.at(2).get<double>(), k.at(3).get<double>(), k.at(4).get<double>());
  }
  if (!keyframe.points.empty())
    keyframe.descriptors = read_bytes(folder / (keyframe.name + ".descriptors.png"));
  if (keyframe.descriptors.height != static_cast<int>(keyframe.points.size()) ||
      (!keyframe.points.empty() && keyframe.descriptors.width != kDescriptorSize))
    throw Error((folder / (keyframe.name + ".descriptors.png")).string(),
                "does not hold a row for each keypoint", "teach the keyframes again");
  return keyframe;
}

/// Pose by EPnP from points and directions; false if it fails or lies behind the camera.
bool epnp(const std::vector<cv::Point3d>& points, const std::vector<cv::Point2d>& rays, Pose& pose) {
  cv::Mat r, t, R;
  try {
    if (!cv::solvePnP(points, rays, cv::Matx33d::eye(), cv::noArray(), r, t, false, cv::SOLVEPNP_EPNP))
      return false;
    cv::Rodrigues(r, R);
  } catch (const cv::Exception&) {  // a degenerate set
    return false;
  }
  for (int i = 0; i < 3; ++i) {
    pose.t[i] = t.at<double>(i);
    for (int j = 0; j < 3; ++j) pose.R(i, j) = R.at<double>(i, j);
  }
  return pose.R.allFinite() && pose.t.allFinite();
}

}  // namespace

Keyframe teach_keyframe(const std::string& name, const Grey& picture, const ObjectModel& model,
                        const Camera& camera, const Pose& cam_from_object) {
  Keyframe keyframe{name, cam_from_object, picture, {}, {}, {}};
  const Found found = find_keypoints(picture);
  std::vector<Eigen::Vector3d> cam;
  for (const Eigen::Vector3d& v : model.vertices) cam.push_back(cam_from_object * v);
  const std::vector<Eigen::Vector3d> rays = unproject(camera, found.pixels);
  keyframe.descriptors.width = kDescriptorSize;
  for (std::size_t i = 0; i < rays.size(); ++i) {
    if (!(rays[i].z() > 0)) continue;
    const Eigen::Vector3d ray = rays[i] / rays[i].z();
    const double depth = nearest_depth(model, cam, ray);
    if (!std::isfinite(depth)) continue;
    keyframe.pixels.push_back(found.pixels[i]);
    keyframe.points.push_back(cam_from_object.inverse() * (depth * ray));
    const std::uint8_t* row = found.descriptors.row(static_cast<int>(i));
    keyframe.descriptors.data.insert(keyframe.descriptors.data.end(), row, row + kDescriptorSize);
    ++keyframe.descriptors.height;
  }
  return keyframe;
}

void write_keyframes(const std::filesystem::path& folder, const std::vector<Keyframe>& keyframes) {
  Json list = Json::array();
  for (const Keyframe& k : keyframes) {
    Json points = Json::array();
    for (std::size_t i = 0; i < k.points.size(); ++i) points.push_back(pair_json(k.pixels[i], k.points[i]));
    list.push_back(
        {{"name", k.name}, {"cam_from_object", to_json(k.cam_from_object)}, {"keypoints", points}});
    write_image(folder / (k.name + ".png"), as_image(k.picture));
    if (!k.points.empty()) write_image(folder / (k.name + ".descriptors.png"), as_image(k.descriptors));
  }
  write_json(folder / "keyframes.json", {{"format", kFormat}, {"version", kVersion}, {"keyframes", list}});
}

std::vector<Keyframe> read_keyframes(const std::filesystem::path& folder) {
  const std::filesystem::path file = folder / "keyframes.json";
  const Json json = read_manifest(file, kFormat, kVersion);
  std::vector<Keyframe> keyframes;
  try {
    for (const Json& k : json.at("keyframes")) keyframes.push_back(read_keyframe(folder, k));
  } catch (const Json::exception& e) {
    throw Error(file.string(), fmt::format("is damaged ({})", e.what()), "teach the keyframes again");
  }
  return keyframes;
}

struct KeypointMatcher::Index {
  std::vector<Eigen::Vector3d> points;
  cv::Mat descriptors;
  mutable cv::flann::Index tree;
};

KeypointMatcher::KeypointMatcher(const std::vector<Keyframe>& keyframes) {
  for (const Keyframe& k : keyframes) {
    if (k.points.size() < 2) continue;
    Index index;
    index.points = k.points;
    cv::Mat(k.descriptors.height, k.descriptors.width, CV_8U,
            const_cast<std::uint8_t*>(k.descriptors.data.data()))
        .convertTo(index.descriptors, CV_32F);
    indices_.push_back(std::move(index));
  }
  for (Index& index : indices_) {
    cv::setRNGSeed(1);  // FLANN draws the dimensions its trees split along
    index.tree.build(index.descriptors, cv::flann::KDTreeIndexParams(4));
  }
}

KeypointMatcher::~KeypointMatcher() = default;

std::vector<PointMatch> KeypointMatcher::match(const Grey& frame, double ratio) const {
  const Found found = find_keypoints(frame);
  if (found.pixels.empty()) return {};
  cv::Mat query, indices, squares;
  cv::Mat(found.descriptors.height, found.descriptors.width, CV_8U,
          const_cast<std::uint8_t*>(found.descriptors.data.data()))
      .convertTo(query, CV_32F);
  struct Best {
    float square;
    float part;  ///< of the squared distance to the second nearest
    PointMatch match;
  };
  std::map<std::pair<double, double>, Best> best;  // by pixel: SIFT gives a place several orientations
  for (const Index& index : indices_) {
    index.tree.knnSearch(query, indices, squares, 2, cv::flann::SearchParams(128));
    for (int i = 0; i < query.rows; ++i) {
      const float first = squares.at<float>(i, 0), second = squares.at<float>(i, 1);
      if (!(first < ratio * ratio * second)) continue;
      const Eigen::Vector2d& q = found.pixels[i];
      const Best candidate{first, first / second, {index.points[indices.at<int>(i, 0)], q, 1}};
      const auto [at, is_new] = best.try_emplace({q.x(), q.y()}, candidate);
      if (!is_new && first < at->second.square) at->second = candidate;
    }
  }
  std::map<std::tuple<double, double, double>, Best> by_place;
  for (const auto& [pixel, candidate] : best) {
    const Eigen::Vector3d& x = candidate.match.x;
    const auto [at, is_new] = by_place.try_emplace({x.x(), x.y(), x.z()}, candidate);
    if (!is_new && candidate.square < at->second.square) at->second = candidate;
  }
  std::vector<PointMatch> matches;
  for (const double strict : {kStrictRatio, ratio}) {
    matches.clear();
    for (const auto& [place, candidate] : by_place)
      if (candidate.part < strict * strict) matches.push_back(candidate.match);
    if (matches.size() >= kEnoughMatches) break;
  }
  return matches;
}

std::vector<Hypothesis> draw_hypotheses(const std::vector<PointMatch>& matches, const Lens& lens,
                                        std::uint64_t seed, const HypothesisOptions& options) {
  if (static_cast<int>(matches.size()) < options.least_matches) return {};
  std::vector<Eigen::Vector2d> pixels;
  for (const PointMatch& m : matches) pixels.push_back(m.q);
  const std::vector<Eigen::Vector3d> rays = unproject(lens.camera(), pixels);
  std::vector<int> order(matches.size());
  std::mt19937_64 random(seed);
  std::vector<Hypothesis> hypotheses;
  for (int tries = 0; tries < 10 * options.count && static_cast<int>(hypotheses.size()) < options.count;
       ++tries) {
    for (std::size_t i = 0; i < order.size(); ++i) order[i] = static_cast<int>(i);
    std::vector<cv::Point3d> points;
    std::vector<cv::Point2d> directions;
    for (int k = 0; k < options.drawn; ++k) {
      std::swap(order[k], order[k + static_cast<int>(random() % (order.size() - k))]);
      const PointMatch& m = matches[order[k]];
      points.emplace_back(m.x.x(), m.x.y(), m.x.z());
      directions.emplace_back(rays[order[k]].x() / rays[order[k]].z(),
                              rays[order[k]].y() / rays[order[k]].z());
    }
    Hypothesis h;
    if (!epnp(points, directions, h.cam_from_object)) continue;
    int inliers = 0;
    bool in_front = true;
    const int left = static_cast<int>(matches.size()) - options.drawn;
    for (std::size_t k = 0; k < order.size(); ++k) {
      Eigen::Vector2d q;
      const PointMatch& m = matches[order[k]];
      const bool seen = lens.project(h.cam_from_object * m.x, q);
      if (static_cast<int>(k) < options.drawn)
        in_front = in_front && seen;
      else
        inliers += seen && (q - m.q).norm() < options.inlier_px ? 1 : 0;
    }
    if (!in_front) continue;
    h.log_weight = -options.lambda_c * (left - inliers) / left;
    hypotheses.push_back(h);
  }
  return hypotheses;
}

}  // namespace stuv::tracking
