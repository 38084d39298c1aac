#pragma once

#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "calib/tracking/edge_search.h"
#include "calib/tracking/video.h"
#include "core/camera.h"
#include "core/image.h"
#include "core/pose.h"

namespace stuv::tracking {

/// One picture of a sequence. `time` is what stands in the file's name for {frame} if that is a number, else
/// the place in the sequence, from 0; so it is the number in a video.
struct SequenceFrame {
  std::string name;
  std::filesystem::path file;
  double time = 0;
  int in_video = -1;  ///< number of the frame if `file` is a video
};

/// Sets `time` of each from its name, or from its place if a name is no number.
void number_frames(std::vector<SequenceFrame>& frames);

/// The files that match a path with {frame} in its last part, in natural order; or, if `source` has none and
/// is a video by its extension, its frames. Throws Error if it is neither, or if there is no match.
std::vector<SequenceFrame> find_frames(const std::string& source);

/// Reads the pictures of a sequence; frames of a video cheaply if they are asked for in order.
class FrameReader {
 public:
  FrameReader();
  ~FrameReader();
  /// Throws Error if the picture cannot be read or its size is not the camera's.
  Image read(const SequenceFrame& frame, const Camera& camera);

 private:
  std::filesystem::path open_;  ///< which video
  std::unique_ptr<VideoReader> video_;
};

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
