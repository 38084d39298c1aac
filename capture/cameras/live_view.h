#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "capture/cameras/camera_source.h"
#include "core/image.h"

namespace stuv {

/// What a glance at a camera's picture tells. Of 0..1 over all pixels and channels.
struct Glance {
  double level = 0;    ///< mean: how it is exposed
  double clipped = 0;  ///< share of pixels with a channel at its largest value
  double sharpness =
      0;  ///< mean |horizontal difference| of luma, times 100: to compare cameras and focus settings
  bool known = false;
};

Glance glance_at(const Image& image);

/// Looks at one camera's picture of every set, in turn, so that it costs the same whatever the number of
/// cameras.
class LiveView {
 public:
  LiveView(int rows, int cols, std::vector<RecordedCamera> cameras);

  void look(const SourceSet& set);
  const Glance& glance(std::size_t camera) const { return glances_[camera]; }

  /// DIR/sheet.jpg, all cameras at their places in the grid, and DIR/index.html, which shows it and
  /// refreshes.
  void write_preview(const std::filesystem::path& folder) const;

 private:
  int rows_, cols_;
  std::vector<RecordedCamera> cameras_;
  std::vector<Glance> glances_;
  std::vector<Image> thumbnails_;  ///< 8 bit, 3 channels, kCell wide or less
  std::size_t next_ = 0;
};

}  // namespace stuv
