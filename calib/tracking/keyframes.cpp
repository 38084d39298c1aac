#include "calib/tracking/keyframes.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <numbers>
#include <opencv2/calib3d.hpp>
#include <opencv2/features2d.hpp>
#include <opencv2/flann.hpp>
#include <optional>
#include <random>

#include "core/error.h"
#include "core/image_io.h"
#include "core/json.h"
#include "core/parallel.h"

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

/// A second keypoint of the frame this near in likeness (distances' ratio) makes a match ambiguous, unless it
/// is the same place.
constexpr double kRivalRatio = 0.9, kSamePlace_px = 3;

/// When two matches agree on how their keyframe lies in the frame: scales within a factor, turns, and places
/// within a part of their distance and some pixels. A turn of the object out of the picture changes all
/// three.
constexpr double kScaleFactor = 1.7, kTurn_rad = 0.6, kPlacePart = 0.25, kPlace_px = 6;

struct Found {
  std::vector<Eigen::Vector2d> pixels;
  std::vector<double> sizes_px, directions;
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
    found.sizes_px.push_back(keypoints[i].size);
    found.directions.push_back(keypoints[i].angle * std::numbers::pi / 180);
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

Json keypoint_json(const Keyframe& k, std::size_t i) {
  const Eigen::Vector2d& q = k.pixels[i];
  const Eigen::Vector3d& x = k.points[i];
  Json json = {q.x(), q.y(), x.x(), x.y(), x.z()};
  if (!k.sizes_px.empty()) json.insert(json.end(), {k.sizes_px[i], k.directions[i]});
  return json;
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
    if (k.size() < 7) continue;
    keyframe.sizes_px.push_back(k.at(5).get<double>());
    keyframe.directions.push_back(k.at(6).get<double>());
  }
  if (keyframe.sizes_px.size() != keyframe.points.size()) keyframe.sizes_px.clear();
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
  Keyframe keyframe{name, cam_from_object, picture, {}, {}, {}, {}, {}};
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
    keyframe.sizes_px.push_back(found.sizes_px[i]);
    keyframe.directions.push_back(found.directions[i]);
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
    for (std::size_t i = 0; i < k.points.size(); ++i) points.push_back(keypoint_json(k, i));
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
  const Keyframe* keyframe = nullptr;
  int number = 0;
  cv::Mat descriptors;
  mutable cv::flann::Index tree;
};

KeypointMatcher::KeypointMatcher(const std::vector<Keyframe>& keyframes) {
  for (std::size_t i = 0; i < keyframes.size(); ++i) {
    const Keyframe& k = keyframes[i];
    if (k.points.size() < 2) continue;
    Index index;
    index.keyframe = &k;
    index.number = static_cast<int>(i);
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

namespace {

struct Candidate {
  double square = 0;  ///< distance of the descriptors
  double part = 0;    ///< of the distance to the second nearest
  KeypointMatch match;
};

KeypointMatch match_of(const Found& found, int i, const Keyframe& k, int number, int j) {
  KeypointMatch m;
  m.point = {k.points[j], found.pixels[i], 1};
  m.keyframe = number;
  m.taught = k.pixels[j];
  if (k.sizes_px.empty() || !(k.sizes_px[j] > 0)) return m;
  m.scale = found.sizes_px[i] / k.sizes_px[j];
  m.turn = found.directions[i] - k.directions[j];
  return m;
}

/// Of all candidates for one place of the object the best, if no other is nearly as good.
std::vector<Candidate> unrivalled(const std::vector<Candidate>& candidates) {
  std::map<std::tuple<double, double, double>, std::vector<const Candidate*>> by_place;
  for (const Candidate& c : candidates) {
    const Eigen::Vector3d& x = c.match.point.x;
    by_place[{x.x(), x.y(), x.z()}].push_back(&c);
  }
  std::vector<Candidate> kept;
  for (const auto& [place, rivals] : by_place) {
    const Candidate& best = **std::min_element(
        rivals.begin(), rivals.end(), [](const auto* a, const auto* b) { return a->square < b->square; });
    const bool ambiguous = std::any_of(rivals.begin(), rivals.end(), [&](const Candidate* c) {
      return (c->match.point.q - best.match.point.q).norm() > kSamePlace_px &&
             best.square > kRivalRatio * kRivalRatio * c->square;
    });
    if (!ambiguous) kept.push_back(best);
  }
  return kept;
}

}  // namespace

std::vector<KeypointMatch> KeypointMatcher::match(const Grey& frame, double ratio) const {
  if (indices_.empty()) return {};
  const Found found = find_keypoints(frame);
  if (found.pixels.empty()) return {};
  cv::Mat query, indices, squares;
  cv::Mat(found.descriptors.height, found.descriptors.width, CV_8U,
          const_cast<std::uint8_t*>(found.descriptors.data.data()))
      .convertTo(query, CV_32F);
  // By pixel: SIFT gives a place several orientations.
  std::map<std::pair<double, double>, Candidate> best;
  for (const Index& index : indices_) {
    index.tree.knnSearch(query, indices, squares, 2, cv::flann::SearchParams(128));
    for (int i = 0; i < query.rows; ++i) {
      const double first = squares.at<float>(i, 0), second = squares.at<float>(i, 1);
      const Eigen::Vector2d& q = found.pixels[i];
      const Candidate candidate{first, second > 0 ? std::sqrt(first / second) : 1,
                                match_of(found, i, *index.keyframe, index.number, indices.at<int>(i, 0))};
      const auto [at, is_new] = best.try_emplace({q.x(), q.y()}, candidate);
      if (!is_new && first < at->second.square) at->second = candidate;
    }
  }
  std::vector<Candidate> candidates;
  for (const auto& [pixel, candidate] : best) candidates.push_back(candidate);
  candidates = unrivalled(candidates);
  std::vector<KeypointMatch> matches;
  for (const double strict : {kStrictRatio, ratio}) {
    matches.clear();
    for (const Candidate& c : candidates)
      if (c.part < strict) matches.push_back(c.match);
    if (matches.size() >= kEnoughMatches) break;
  }
  return matches;
}

namespace {

bool agree(const KeypointMatch& a, const KeypointMatch& b) {
  if (a.keyframe != b.keyframe || !(a.scale > 0) || !(b.scale > 0)) return false;
  if (a.scale > kScaleFactor * b.scale || b.scale > kScaleFactor * a.scale) return false;
  if (std::abs(std::remainder(a.turn - b.turn, 2 * std::numbers::pi)) > kTurn_rad) return false;
  const Eigen::Vector2d step = a.scale * (Eigen::Rotation2Dd(a.turn) * (b.taught - a.taught));
  return (a.point.q + step - b.point.q).norm() < kPlace_px + kPlacePart * step.norm();
}

/// Draws sets of matches, by index.
class SetDrawer {
 public:
  SetDrawer(const std::vector<KeypointMatch>& matches, int drawn, std::uint64_t seed)
      : drawn_(drawn), random_(seed), all_(matches.size()) {
    for (std::size_t i = 0; i < matches.size(); ++i) {
      all_[i] = static_cast<int>(i);
      std::vector<int> friends;
      for (std::size_t j = 0; j < matches.size(); ++j)
        if (j != i && agree(matches[i], matches[j])) friends.push_back(static_cast<int>(j));
      if (static_cast<int>(friends.size()) + 1 < drawn) continue;
      // As often as it has friends.
      for (std::size_t k = 0; k < friends.size(); ++k) firsts_.push_back(static_cast<int>(i));
      friends_[static_cast<int>(i)] = std::move(friends);
    }
  }

  /// The first `drawn` of the answer are the set, the others the rest.
  std::vector<int> draw() {
    std::vector<int> order = all_;
    if (!firsts_.empty() && random_() % 2 == 0) {
      const int first = firsts_[random_() % firsts_.size()];
      const std::vector<int> set = friends_.at(first);
      order = {first};
      order.insert(order.end(), set.begin(), set.end());
      shuffle(order, 1);
      std::vector<bool> in(all_.size(), false);
      for (const int i : order) in[i] = true;
      for (const int i : all_)
        if (!in[i]) order.push_back(i);
      return order;
    }
    shuffle(order, 0);
    return order;
  }

 private:
  /// Places `from` .. `drawn` at random among what is there.
  void shuffle(std::vector<int>& order, int from) {
    for (int k = from; k < drawn_; ++k)
      std::swap(order[k], order[k + static_cast<int>(random_() % (order.size() - k))]);
  }

  int drawn_;
  std::mt19937_64 random_;
  std::vector<int> all_, firsts_;
  std::map<int, std::vector<int>> friends_;
};

/// The pose of the first `drawn` matches of an order, weighed by equation 5 on the others.
std::optional<Hypothesis> hypothesis_of(const std::vector<KeypointMatch>& matches,
                                        const std::vector<Eigen::Vector3d>& rays,
                                        const std::vector<int>& order, const Lens& lens,
                                        const HypothesisOptions& options) {
  std::vector<cv::Point3d> points;
  std::vector<cv::Point2d> directions;
  for (int k = 0; k < options.drawn; ++k) {
    const Eigen::Vector3d &x = matches[order[k]].point.x, &ray = rays[order[k]];
    points.emplace_back(x.x(), x.y(), x.z());
    directions.emplace_back(ray.x() / ray.z(), ray.y() / ray.z());
  }
  Hypothesis h;
  if (!epnp(points, directions, h.cam_from_object)) return {};
  int inliers = 0;
  for (int k = 0; k < static_cast<int>(order.size()); ++k) {
    Eigen::Vector2d q;
    const PointMatch& m = matches[order[k]].point;
    const bool seen = lens.project(h.cam_from_object * m.x, q);
    if (k < options.drawn && !seen) return {};
    if (k >= options.drawn && seen && (q - m.q).norm() < options.inlier_px) ++inliers;
  }
  const int left = static_cast<int>(matches.size()) - options.drawn;
  h.log_weight = -options.lambda_c * (left - inliers) / left;
  return h;
}

}  // namespace

std::vector<Hypothesis> draw_hypotheses(const std::vector<KeypointMatch>& matches, const Lens& lens,
                                        std::uint64_t seed, const HypothesisOptions& options) {
  if (static_cast<int>(matches.size()) < options.least_matches) return {};
  std::vector<Eigen::Vector2d> pixels;
  for (const KeypointMatch& m : matches) pixels.push_back(m.point.q);
  const std::vector<Eigen::Vector3d> rays = unproject(lens.camera(), pixels);
  SetDrawer drawer(matches, options.drawn, seed);
  std::vector<Hypothesis> hypotheses;
  // As many sets at a time as poses are wanted: drawn one after the other, solved side by side.
  for (int tries = 0; tries < 10 && static_cast<int>(hypotheses.size()) < options.count; ++tries) {
    std::vector<std::vector<int>> orders(static_cast<std::size_t>(options.count));
    for (std::vector<int>& order : orders) order = drawer.draw();
    std::vector<std::optional<Hypothesis>> solved(orders.size());
    parallel_for(options.count,
                 [&](int i) { solved[i] = hypothesis_of(matches, rays, orders[i], lens, options); });
    for (const auto& h : solved)
      if (h && static_cast<int>(hypotheses.size()) < options.count) hypotheses.push_back(*h);
  }
  return hypotheses;
}

}  // namespace stuv::tracking
