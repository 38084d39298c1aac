#pragma once

#include <array>
#include <cstdint>

#include "capture/synthetic/scene.h"
#include "core/camera.h"
#include "core/image.h"

namespace stuv::synthetic {

struct TruePicture {
  ImageF colour;  ///< linear light, three channels
  ImageF depth;   ///< Z along the camera's axis [m] at the pixel's centre; Inf where nothing is
};

/// What a perfect sensor behind the camera's lens sees at a moment: any camera, of the rig or a novel one.
///
/// A pixel is the mean of four samples, one in each quarter, and of sixteen where these differ (edges, thin
/// things, fine texture). Sample places are the same in every call.
TruePicture render_picture(const Scene& scene, const Camera& camera, std::int64_t time_ns = 0);

/// From light to pictures.
struct SensorOptions {
  double gamma = 2.2;          ///< stored value = light^(1 / gamma)
  double full_well_e = 20000;  ///< electrons at light 1; the shot noise is their root; 0: none
  double read_noise_e = 8;     ///< electrons rms
};

/// "" if the options can be used, else the value and the constraint it breaks.
std::string problem_of(const SensorOptions& options);

/// One camera at one moment.
struct Exposure {
  double gain = 1;         ///< factor on the light
  double vignetting = 0;   ///< loss in the corners: light * (1 - vignetting r^2), r = 1 in the corner
  std::uint64_t seed = 0;  ///< of the noise: a number of its own for every picture
  std::array<double, 3> colour_gain = {1, 1, 1};  ///< factor on each channel's light
  double offset = 0;                              ///< added to stored values, 0..1
};

/// Stored values of light without any noise, 0..1.
ImageF encode(const ImageF& light, const SensorOptions& sensor);

/// The 8-bit picture: gains, vignetting, shot and read noise, gamma, offset. One channel of light gives
/// `channels` equal ones with independent noise.
Image expose(const ImageF& light, int channels, const SensorOptions& sensor, const Exposure& exposure);

}  // namespace stuv::synthetic
