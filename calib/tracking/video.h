#pragma once

#include <filesystem>
#include <memory>

#include "core/image.h"

namespace stuv::tracking {

/// By its extension (mp4, avi, mkv, mov, webm, mpg, mpeg, m4v), whatever its case.
bool is_video_name(const std::filesystem::path& file);

/// The frames of a video file (OpenCV's FFmpeg back end), numbered from 0, as 8-bit RGB.
class VideoReader {
 public:
  /// Counts the frames by going through them: what the container says may be wrong. Throws Error if the file
  /// cannot be read as a video or holds no frame.
  explicit VideoReader(const std::filesystem::path& file);
  ~VideoReader();
  int count() const;
  double fps() const;  ///< 30 if the file does not say
  /// Cheap where frames are asked for in order. Throws Error if the frame cannot be decoded.
  Image read(int frame);

 private:
  struct State;
  std::unique_ptr<State> state_;
};

/// A video of equal pictures, H.264 if this FFmpeg can encode it, else MPEG-4. The extension chooses the
/// container. Throws Error if it cannot be written, or if a picture is not 8-bit RGB of the first one's size.
class VideoWriter {
 public:
  VideoWriter(const std::filesystem::path& file, double fps);
  ~VideoWriter();
  void add(const Image& picture);
  /// Finishes the file; nothing may be added after.
  void close();

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace stuv::tracking
