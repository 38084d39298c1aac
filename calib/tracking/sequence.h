#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "calib/tracking/edge_search.h"
#include "core/image.h"
#include "core/pose.h"

namespace stuv::tracking {

/// One picture of a sequence. `time` is what stands in the file's name for {frame} if that is a number, else
/// the place in the sequence, from 0.
struct SequenceFrame {
  std::string name;
  std::filesystem::path file;
  double time = 0;
};

/// Sets `time` of each from its name, or from its place if a name is no number.
void number_frames(std::vector<SequenceFrame>& frames);

/// The files that match a path with {frame} in its last part, in natural order. Throws Error if there is no
/// {frame} in the file's name, or no match.
std::vector<SequenceFrame> find_frames(const std::string& pattern);

/// Luma, 0 to 255.
Grey grey_of(const Image& image);

struct TimedPose {
  double time = 0;
  Pose cam_from_object;
};

/// TUM lines `t tx ty tz qx qy qz qw`, # comments. Throws Error with the line number: not eight finite
/// numbers, a quaternion far from unit length, the same time twice.
std::vector<TimedPose> read_trajectory(const std::filesystem::path& file);
std::string trajectory_text(const std::vector<TimedPose>& poses);

/// Poses of a sequence from a TUM file, or from files of one 4x4 matrix each if `source` holds {frame}.
/// Frames without a pose are none.
std::vector<std::optional<Pose>> poses_of(const std::string& source,
                                          const std::vector<SequenceFrame>& frames);

}  // namespace stuv::tracking
