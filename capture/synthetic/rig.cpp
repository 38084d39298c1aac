#include "capture/synthetic/rig.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "capture/synthetic/random.h"

namespace stuv::synthetic {
namespace {

/// Which of a camera's properties a random number is for.
enum Property : std::uint64_t {
  kPosition = 0,
  kDirection = 3,
  kFocal = 6,
  kPrincipalPoint = 7,
  kDistortion = 9,
  kGain = 13,
  kVignetting,
  kTimeSkew,
  kColourGain,
  kOffset = kColourGain + 3
};

std::string name_of_place(int row, int col) { return fmt::format("r{}c{}", row, col); }

/// Draws the properties of the camera in one place of the lattice.
class Draw {
 public:
  Draw(std::uint64_t seed, int row, int col)
      : seed_(hash({seed, 0x716, static_cast<std::uint64_t>(row), static_cast<std::uint64_t>(col)})) {}
  double operator()(std::uint64_t property, double sigma) const {
    return sigma * gaussian(hash({seed_, property}));
  }
  Eigen::Vector3d vector(std::uint64_t property, const Eigen::Vector3d& sigma) const {
    return {(*this)(property, sigma.x()), (*this)(property + 1, sigma.y()), (*this)(property + 2, sigma.z())};
  }

 private:
  std::uint64_t seed_;
};

Eigen::Vector2d lattice_origin(const RigOptions& options) {
  return {-0.5 * (options.cols - 1) * options.spacing_m[0], -0.5 * (options.rows - 1) * options.spacing_m[1]};
}

Camera make_camera(const RigOptions& options, int row, int col, const Eigen::Vector3d& off_lattice_m) {
  const JitterOptions& jitter = options.jitter;
  const Draw draw(options.seed, row, col);
  Camera camera;
  camera.name = name_of_place(row, col);
  camera.lens_model = "LENSMODEL_OPENCV4";
  camera.width = options.width;
  camera.height = options.height;
  const double focal = options.focal_px * (1 + draw(kFocal, jitter.focal_relative));
  camera.intrinsics = {focal, focal,
                       0.5 * (options.width - 1) + draw(kPrincipalPoint, jitter.principal_point_px),
                       0.5 * (options.height - 1) + draw(kPrincipalPoint + 1, jitter.principal_point_px)};
  for (std::size_t k = 0; k < 4; ++k)
    camera.intrinsics.push_back(options.distortion[k] + draw(kDistortion + k, jitter.distortion[k]));
  const Eigen::Vector2d lattice =
      lattice_origin(options) + Eigen::Vector2d(col * options.spacing_m[0], row * options.spacing_m[1]);
  const Eigen::Vector3d centre = Eigen::Vector3d(lattice.x(), lattice.y(), 0) + off_lattice_m;
  camera.cam_from_rig.R =
      rotation_from_vector(draw.vector(kDirection, Eigen::Vector3d::Constant(jitter.direction_rad)));
  camera.cam_from_rig.t = -(camera.cam_from_rig.R * centre);
  return camera;
}

double rms_off_plane(const Rig& rig) {
  double sum = 0;
  for (const RigCamera& camera : rig.cameras) sum += camera.off_lattice_m.z() * camera.off_lattice_m.z();
  return std::sqrt(sum / static_cast<double>(rig.cameras.size()));
}

std::string problem_of(const JitterOptions& jitter) {
  const auto negative = [](double value) { return !(value >= 0 && std::isfinite(value)); };
  if (std::any_of(jitter.position_m.begin(), jitter.position_m.end(), negative))
    return "jitter.position_m must be 0 or more";
  if (std::any_of(jitter.distortion.begin(), jitter.distortion.end(), negative))
    return "jitter.distortion must be 0 or more";
  for (const auto& [name, value] : {std::pair{"direction_rad", jitter.direction_rad},
                                    {"focal_relative", jitter.focal_relative},
                                    {"principal_point_px", jitter.principal_point_px},
                                    {"gain_relative", jitter.gain_relative},
                                    {"colour_gain_relative", jitter.colour_gain_relative},
                                    {"offset", jitter.offset},
                                    {"vignetting", jitter.vignetting},
                                    {"time_skew_ns", jitter.time_skew_ns}})
    if (negative(value)) return fmt::format("jitter.{} is {}, but must be 0 or more", name, value);
  return "";
}

}  // namespace

std::string problem_of(const RigOptions& options) {
  if (options.rows < 1 || options.cols < 1 || options.rows > 1000 || options.cols > 1000)
    return fmt::format("rows x cols is {}x{}, but each must lie in 1..1000", options.rows, options.cols);
  for (const double spacing : options.spacing_m)
    if (!(spacing > 0 && std::isfinite(spacing)))
      return fmt::format("spacing_m is {}, but must be above 0", spacing);
  if (options.width < 16 || options.height < 16 || options.width > 20000 || options.height > 20000)
    return fmt::format("width x height is {}x{}, but each must lie in 16..20000", options.width,
                       options.height);
  if (!(options.focal_px >= 0.25 * options.width && std::isfinite(options.focal_px)))
    return fmt::format("focal_px is {}, but must be at least a quarter of the width", options.focal_px);
  for (const double k : options.distortion)
    if (!std::isfinite(k)) return "distortion must be finite";
  if (!(options.vignetting >= 0 && options.vignetting < 1))
    return fmt::format("vignetting is {}, but must lie in 0..1", options.vignetting);
  if (!(std::abs(options.offset) <= 0.5))
    return fmt::format("offset is {}, but must lie in -0.5..0.5", options.offset);
  for (const std::string& name : options.missing) {
    int row = -1, col = -1, end = 0;
    if (std::sscanf(name.c_str(), "r%dc%d%n", &row, &col, &end) != 2 ||
        end != static_cast<int>(name.size()) || row < 0 || col < 0 || row >= options.rows ||
        col >= options.cols)
      return fmt::format("missing names '{}', but places are named r0c0 to {}", name,
                         name_of_place(options.rows - 1, options.cols - 1));
  }
  if (static_cast<int>(options.missing.size()) >= options.rows * options.cols)
    return "missing leaves no camera";
  return problem_of(options.jitter);
}

TrueRig make_rig(const RigOptions& options) {
  if (const std::string problem = problem_of(options); !problem.empty()) throw std::invalid_argument(problem);
  TrueRig result;
  Rig& rig = result.rig;
  rig.rows = options.rows;
  rig.cols = options.cols;
  rig.lattice_origin_m = lattice_origin(options);
  rig.s_step_m = {options.cols > 1 ? options.spacing_m[0] : 0, 0};
  rig.t_step_m = {0, options.rows > 1 ? options.spacing_m[1] : 0};
  const JitterOptions& jitter = options.jitter;
  for (int row = 0; row < options.rows; ++row)
    for (int col = 0; col < options.cols; ++col) {
      const std::string name = name_of_place(row, col);
      if (std::find(options.missing.begin(), options.missing.end(), name) != options.missing.end()) continue;
      const Draw draw(options.seed, row, col);
      RigCamera camera;
      camera.row = row;
      camera.col = col;
      camera.off_lattice_m = draw.vector(
          kPosition, Eigen::Vector3d(jitter.position_m[0], jitter.position_m[1], jitter.position_m[2]));
      camera.camera = make_camera(options, row, col, camera.off_lattice_m);
      rig.cameras.push_back(std::move(camera));
      result.gain.push_back(std::max(0.05, 1 + draw(kGain, jitter.gain_relative)));
      std::array<double, 3> colour;
      for (std::size_t c = 0; c < 3; ++c)
        colour[c] = std::max(0.05, 1 + draw(kColourGain + c, jitter.colour_gain_relative));
      result.colour_gain.push_back(colour);
      result.offset.push_back(std::clamp(options.offset + draw(kOffset, jitter.offset), -0.5, 0.5));
      result.vignetting.push_back(
          std::clamp(options.vignetting + draw(kVignetting, jitter.vignetting), 0.0, 0.95));
      result.time_skew_ns.push_back(std::llround(draw(kTimeSkew, jitter.time_skew_ns)));
    }
  rig.rms_off_plane_m = rms_off_plane(rig);
  rig.produced_by = {{"source", "synthetic"}, {"seed", options.seed}};
  return result;
}

}  // namespace stuv::synthetic
