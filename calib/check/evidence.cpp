#include "calib/check/evidence.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <map>
#include <mutex>
#include <numeric>
#include <set>
#include <tuple>

#include "calib/two_view/estimate.h"
#include "calib/two_view/match_pictures.h"
#include "core/image_io.h"
#include "core/median.h"
#include "core/parallel.h"

namespace stuv {
namespace {

constexpr double kDark = 0.03;           // mean level below which a picture without features counts as black
constexpr double kFewOfUsual = 1 / 3.0;  // matches; below it other explanations are tried
constexpr int kMostOthers = 12;          // cameras that one is matched with when its neighbours say nothing

Image flipped(const Image& image) {
  Image out = image;
  const std::size_t pixel = image.channels * bytes_per_sample(image.type);
  for (int y = 0; y < image.height; ++y)
    for (int x = 0; x < image.width; ++x) {
      const std::size_t row = static_cast<std::size_t>(y) * image.width;
      std::memcpy(&out.bytes[(row + image.width - 1 - x) * pixel], &image.bytes[(row + x) * pixel], pixel);
    }
  return out;
}

double mean_level(const Image& image) {
  const ImageF pixels = to_float(image);
  double sum = 0;
  for (const float v : pixels.data) sum += v;
  return sum / static_cast<double>(std::max<std::size_t>(1, pixels.data.size()));
}

/// A picture's features, and where they are in ideal pixels of their camera.
struct Seen {
  Features features, ideal;
};

Seen features_of(const Image& picture, const Camera& camera, int most) {
  const Features all = detect_features(picture, most);
  const std::vector<Eigen::Vector3d> rays = unproject(camera, all.points_px);
  std::vector<int> kept;  // a plane of ideal pixels has no room for rays from the side
  for (std::size_t i = 0; i < rays.size(); ++i)
    if (rays[i].allFinite() && rays[i].z() > 0.1) kept.push_back(static_cast<int>(i));
  Seen seen;
  const int width = all.descriptors.width;
  seen.features.descriptors = Raster<float>(width, static_cast<int>(kept.size()), 1);
  for (std::size_t k = 0; k < kept.size(); ++k) {
    seen.features.points_px.push_back(all.points_px[kept[k]]);
    seen.ideal.points_px.emplace_back(camera.intrinsics[0] * rays[kept[k]].hnormalized());
    std::copy_n(all.descriptors.row(kept[k]), width, seen.features.descriptors.row(static_cast<int>(k)));
  }
  return seen;
}

class Search {
 public:
  Search(const Recording& recording, const FrameSet& set, const Rig& rig, const EvidenceOptions& options,
         const Reporter& reporter)
      : recording_(recording), set_(set), rig_(rig), options_(options), reporter_(reporter) {
    out_.cameras.resize(rig.cameras.size());
    seen_.resize(rig.cameras.size());
  }

  SceneEvidence run() {
    look();
    match(neighbour_pairs());
    const int usual = usual_matches();
    for (int c = 0; c < count(); ++c)
      if (out_.cameras[c].present && most_matches(c) < kFewOfUsual * usual) explain(c, usual);
    for (auto& [key, matches] : pairs_)
      if (static_cast<int>(matches.size()) >= options_.least_matches)
        out_.pairs.push_back({key.first, key.second, std::move(matches)});
    out_.tracks = tracks_of(out_.pairs);
    return std::move(out_);
  }

 private:
  int count() const { return static_cast<int>(rig_.cameras.size()); }

  void look() {
    std::size_t done = 0;
    std::mutex mutex;
    parallel_for(count(), [&](int c) {
      look_at(c);
      const std::lock_guard lock(mutex);
      reporter_.at("finding features", ++done, rig_.cameras.size());
    });
  }

  std::filesystem::path file_of(int c) const {
    const int index = recording_.camera_index(rig_.cameras[c].camera.name);
    if (index < 0 || set_.frames[index].status != FrameStatus::ok) return {};
    return set_.frames[index].file;
  }

  void look_at(int c) {
    const Camera& camera = rig_.cameras[c].camera;
    SceneSight& sight = out_.cameras[c];
    const std::filesystem::path file = file_of(c);
    if (file.empty()) {
      sight.problem = recording_.camera_index(camera.name) < 0
                          ? "is not in the recording"
                          : fmt::format("has no picture in set {}", set_.name);
      return;
    }
    const Image picture = read_image(file);
    sight.level = mean_level(picture);
    if (picture.width != camera.width || picture.height != camera.height) {
      sight.problem = fmt::format("its picture is {}x{}, the rig knows it at {}x{}", picture.width,
                                  picture.height, camera.width, camera.height);
      return;
    }
    seen_[c] = features_of(picture, camera, options_.most_features);
    sight.features = static_cast<int>(seen_[c].features.points_px.size());
    sight.present = sight.features >= options_.least_matches;
    if (!sight.present)
      sight.problem =
          sight.level < kDark ? "its picture is black" : "its picture shows nothing: covered or out of focus";
  }

  std::vector<std::pair<int, int>> neighbour_pairs() const {
    std::set<std::pair<int, int>> pairs;
    for (int a = 0; a < count(); ++a) {
      std::vector<std::pair<double, int>> others;
      const Eigen::Vector3d centre = rig_.cameras[a].camera.cam_from_rig.centre();
      for (int b = 0; b < count(); ++b)
        if (b != a) others.emplace_back((rig_.cameras[b].camera.cam_from_rig.centre() - centre).norm(), b);
      std::sort(others.begin(), others.end());
      others.resize(std::min<std::size_t>(others.size(), options_.neighbours));
      for (const auto& [distance, b] : others) pairs.emplace(std::min(a, b), std::max(a, b));
    }
    return {pairs.begin(), pairs.end()};
  }

  /// Of features that match and agree with a geometry of two views, in pixels.
  Matches verified(const Seen& a, const Seen& b) const {
    const std::vector<std::pair<int, int>> indices = match_feature_indices(a.features, b.features);
    Matches ideal;
    for (const auto& [i, j] : indices) ideal.push_back({a.ideal.points_px[i], b.ideal.points_px[j]});
    TwoViewOptions two_view;
    two_view.seed = options_.seed;
    two_view.gold_standard = false;
    const TwoViewEstimate estimate = estimate_two_view(ideal, two_view);
    Matches good;
    for (std::size_t k = 0; k < indices.size(); ++k)
      if (estimate.inlier[k])
        good.push_back({a.features.points_px[indices[k].first], b.features.points_px[indices[k].second]});
    return good;
  }

  void match(const std::vector<std::pair<int, int>>& pairs) {
    std::vector<Matches> found(pairs.size());
    std::size_t done = 0;
    std::mutex mutex;
    parallel_for(static_cast<int>(pairs.size()), [&](int p) {
      const auto [a, b] = pairs[p];
      if (out_.cameras[a].present && out_.cameras[b].present) found[p] = verified(seen_[a], seen_[b]);
      const std::lock_guard lock(mutex);
      reporter_.at("matching pairs", ++done, pairs.size());
    });
    for (std::size_t p = 0; p < pairs.size(); ++p) pairs_[pairs[p]] = std::move(found[p]);
  }

  int most_matches(int c) const {
    std::size_t most = 0;
    for (const auto& [pair, matches] : pairs_)
      if (pair.first == c || pair.second == c) most = std::max(most, matches.size());
    return static_cast<int>(most);
  }

  int usual_matches() const {
    std::vector<int> each;
    for (int c = 0; c < count(); ++c)
      if (out_.cameras[c].present) each.push_back(most_matches(c));
    return median(std::move(each));
  }

  /// A camera that finds little: with its picture flipped, or elsewhere in the rig.
  void explain(int c, int usual) {
    std::vector<std::pair<int, int>> near, all;
    for (const auto& [pair, matches] : pairs_)
      if (pair.first == c || pair.second == c) near.push_back(pair);
    const int before = most_matches(c);
    const Seen straight = seen_[c];
    const std::map<std::pair<int, int>, Matches> straight_pairs = pairs_;
    seen_[c] = features_of(flipped(read_image(file_of(c))), rig_.cameras[c].camera, options_.most_features);
    match(near);
    if (most_matches(c) > std::max(2 * before, options_.least_matches)) {
      out_.cameras[c].mirrored = true;
      return;
    }
    seen_[c] = straight;
    pairs_ = straight_pairs;
    if (before >= std::max(options_.least_matches, usual / 10)) return;
    for (int k = 0; k < std::min(kMostOthers, count()); ++k) {
      const int other = k * count() / std::min(kMostOthers, count());
      const std::pair<int, int> pair(std::min(c, other), std::max(c, other));
      if (other != c && pairs_.count(pair) == 0) all.push_back(pair);
    }
    match(all);
  }

  const Recording& recording_;
  const FrameSet& set_;
  const Rig& rig_;
  const EvidenceOptions& options_;
  const Reporter& reporter_;
  std::vector<Seen> seen_;
  std::map<std::pair<int, int>, Matches> pairs_;
  SceneEvidence out_;
};

/// Sets of numbers that belong together, joined pair by pair.
class Groups {
 public:
  int add() {
    leader_.push_back(static_cast<int>(leader_.size()));
    return leader_.back();
  }
  int leader(int i) const {
    while (leader_[i] != i) i = leader_[i];
    return i;
  }
  void join(int i, int j) {
    i = leader(i), j = leader(j);
    leader_[std::max(i, j)] = std::min(i, j);
  }

 private:
  std::vector<int> leader_;
};

}  // namespace

std::vector<SceneTrack> tracks_of(const std::vector<ScenePair>& pairs) {
  std::map<std::tuple<int, double, double>, int> feature;  // camera, x, y
  Groups groups;
  const auto number = [&](int camera, const Eigen::Vector2d& at) {
    const auto [entry, fresh] = feature.try_emplace({camera, at.x(), at.y()}, 0);
    if (fresh) entry->second = groups.add();
    return entry->second;
  };
  for (const ScenePair& pair : pairs)
    for (const Match& m : pair.matches) groups.join(number(pair.a, m.a), number(pair.b, m.b));
  std::map<int, SceneTrack> tracks;
  for (const auto& [key, i] : feature) {
    SceneTrack& track = tracks[groups.leader(i)];
    track.camera.push_back(std::get<0>(key));  // in ascending order
    track.at_px.emplace_back(std::get<1>(key), std::get<2>(key));
  }
  std::vector<SceneTrack> good;
  for (auto& [leader, track] : tracks)
    if (std::adjacent_find(track.camera.begin(), track.camera.end()) == track.camera.end())
      good.push_back(std::move(track));
  return good;
}

SceneEvidence find_evidence(const Recording& recording, const FrameSet& set, const Rig& rig,
                            const EvidenceOptions& options, const Reporter& reporter) {
  return Search(recording, set, rig, options, reporter).run();
}

}  // namespace stuv
