#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "calib/tracking/measurement.h"
#include "calib/tracking/object_model.h"
#include "core/progress.h"

namespace stuv::tracking {

/// A picture of the object at a known pose, with the keypoints that lie on its faces.
struct Keyframe {
  std::string name;
  Pose cam_from_object;
  Grey picture;
  std::vector<Eigen::Vector2d> pixels;  ///< where each keypoint is seen
  std::vector<Eigen::Vector3d> points;  ///< and its place on the object [m]
  std::vector<double> sizes_px;         ///< SIFT's scale and direction of each [rad]; empty: not kept
  std::vector<double> directions;
  Raster<std::uint8_t> descriptors;  ///< SIFT, a row each, 128 wide
};

/// Finds keypoints (SIFT) in a picture of the object and puts them on its faces: the nearest face that the
/// pixel's ray meets. Keypoints beside the object are left out.
Keyframe teach_keyframe(const std::string& name, const Grey& picture, const ObjectModel& model,
                        const Camera& camera, const Pose& cam_from_object);

/// A folder: keyframes.json (poses, keypoints in 2D and 3D), NAME.png the picture, NAME.descriptors.png a row
/// a keypoint. write_keyframes needs the folder to exist; read_keyframes throws Error naming what is damaged.
void write_keyframes(const std::filesystem::path& folder, const std::vector<Keyframe>& keyframes);
std::vector<Keyframe> read_keyframes(const std::filesystem::path& folder);

/// A keypoint of the frame that is one of a keyframe, and how that keyframe's picture lies in the frame if it
/// is: about `taught`, grown by `scale` and turned by `turn` [rad, clockwise].
struct KeypointMatch {
  PointMatch point;
  int keyframe = -1;
  Eigen::Vector2d taught = Eigen::Vector2d::Zero();
  double scale = 0, turn = 0;  ///< scale 0: not known
};

/// Keypoints of a frame that match keyframes: approximate nearest neighbours by best-bin-first search in a
/// kd-tree for each keyframe (FLANN), kept if nearer than `ratio` times the second (Lowe, IJCV 2004). A
/// keypoint of the frame that matches several keyframes counts once, with the best; so does a place of the
/// object, and only if no other keypoint of the frame is nearly as like it (clutter that repeats itself).
class KeypointMatcher {
 public:
  explicit KeypointMatcher(const std::vector<Keyframe>& keyframes);
  ~KeypointMatcher();
  KeypointMatcher(const KeypointMatcher&) = delete;
  KeypointMatcher& operator=(const KeypointMatcher&) = delete;
  std::vector<KeypointMatch> match(const Grey& frame, double ratio = 0.8) const;

 private:
  struct Index;
  std::vector<Index> indices_;
};

struct Hypothesis {
  Pose cam_from_object;
  double log_weight = 0;
};

struct HypothesisOptions {
  int count = 100;
  int least_matches = 9, drawn = 7;
  double lambda_c = 10;
  double inlier_px = 6;
};

/// Equations 5 and 6: `count` poses by EPnP from random sets of `drawn` matches, no RANSAC; each weighs
/// exp(-lambda_c (c - c_i) / c), c_i of the c matches left over being inliers. Every second set is drawn
/// among matches that agree with its first on how their keyframe lies in the frame (Lowe's consistency of
/// place, scale and turn), where enough do: with many wrong matches, seven right ones are seldom drawn
/// otherwise. Sets whose pose is not in front of the camera are drawn again, at most ten times as often as
/// wanted; so fewer may come back, and none with fewer than `least_matches`. The same seed draws the same
/// sets.
std::vector<Hypothesis> draw_hypotheses(const std::vector<KeypointMatch>& matches, const Lens& lens,
                                        std::uint64_t seed, const HypothesisOptions& options = {});

}  // namespace stuv::tracking
