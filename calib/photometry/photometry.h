#pragma once

#include <Eigen/Dense>
#include <array>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "core/image.h"
#include "core/json.h"

namespace stuv {

/// How one camera's stored values differ from those of the mean camera of its rig, per channel c:
///
///   stored_c = offset_c + gain_c V(rho) rig_c,   rho = (|q - centre| / corner)^2
///   V(rho) = 1 + v1 rho + v2 rho^2 + v3 rho^3,   falls monotonically from 1
///
/// Values are as they are stored, 0..1, not linearised: nobody tells us a camera's response, and none is
/// needed where it is linear or a power of the light (stored = light^(1/gamma)): a factor on the light is a
/// factor on stored values then. Rendering blends stored values as well.
struct CameraPhotometry {
  std::string camera;
  std::array<double, 3> gain = {1, 1, 1}, offset = {0, 0, 0};
  std::array<double, 3> falloff = {0, 0, 0};            ///< v1, v2, v3
  Eigen::Vector2d centre_px = Eigen::Vector2d::Zero();  ///< of the lens: its principal point
  double corner_px = 1;                                 ///< from there to the picture's farthest corner
  std::array<double, 3> gain_sigma = {0, 0, 0}, offset_sigma = {0, 0, 0};
  double corner_sigma = 0;  ///< of V(1), beside what all cameras have in common
  int samples = 0;
  /// Its gains are known. Otherwise all is left at identity.
  bool determined = false;
  /// Why it is not, or what of it was left at identity or taken from the rig's mean.
  std::vector<std::string> reasons;
};

/// Of a rig: the gains' mean over the cameras is 1 and the offsets' mean 0 in every channel.
struct Photometry {
  std::string source;  ///< "boards" or "views"
  int channels = 1;
  std::vector<CameraPhotometry> cameras;  ///< by name; those of the rig that took part
  /// Relative rms by which cameras differ about the mean of those that see a point, over the bright half of
  /// the points; NaN if there are none.
  double spread_before = 0, spread_after = 0;
  int points = 0;
  std::vector<std::string> notes;

  /// Null if the camera is unknown or not determined.
  const CameraPhotometry* of(const std::string& camera) const;
};

/// One sentence: how far cameras differed and differ, and how many are not determined.
std::string summary_of(const Photometry& photometry);

/// V(rho) of a camera at a pixel.
double falloff_at(const CameraPhotometry& camera, const Eigen::Vector2d& pixel);
/// What the rig's mean camera would have stored.
double corrected(const CameraPhotometry& camera, int channel, const Eigen::Vector2d& pixel, double stored);

/// The value, 0..1, at which a picture's pixels are full: 1, or less for 10, 12 or 14 bits stored in 16,
/// which show in the largest value; infinity for float pictures.
double white_level(const Image& image);
/// Part of the pixels with a channel at that value.
double full_fraction(const Image& image);

/// FOLDER/photometry.json; nothing if there is none. Throws Error if it is damaged.
std::optional<Photometry> read_photometry(const std::filesystem::path& folder);
void write_photometry(const std::filesystem::path& folder, const Photometry& photometry);

}  // namespace stuv
