#pragma once

#include <optional>
#include <span>
#include <string>
#include <vector>

#include "calib/interchange/camera_list.h"

namespace stuv {

// Lenses that mrcal does not have, and the nearest of those that it has, or that a format has.

/// Kannala and Brandt's lens in OpenCV's form (cv::fisheye), also Kalibr's "equidistant", COLMAP's and
/// nerfstudio's OPENCV_FISHEYE:
///
///   theta = angle from the axis, theta_d = theta (1 + k1 theta^2 + k2 theta^4 + k3 theta^6 + k4 theta^8),
///   q = (cx + fx theta_d cos phi, cy + fy theta_d sin phi),  phi: direction of (x, y)
///
/// Parameters: fx, fy, cx, cy, k1, k2, k3, k4; pixels as in core/camera.h.
struct FisheyeLens {
  std::vector<double> parameters = std::vector<double>(8, 0);
};
Eigen::Vector2d project(const FisheyeLens& lens, const Eigen::Vector3d& direction);
/// By Newton's method on theta; nothing where theta_d is not reached below 180 degrees.
std::optional<Eigen::Vector3d> unproject(const FisheyeLens& lens, const Eigen::Vector2d& pixel);

/// Camera of mrcal's splined stereographic model for a fisheye lens: control points by linear least squares
/// of the pixels over the picture. worst_px is measured between the fitted places.
Camera splined_from_fisheye(const FisheyeLens& lens, int width, int height, double& worst_px);

/// Fits. Each takes pixels over the picture and their rays from `camera` and minimises the distance of their
/// projections through the new lens; worst_px is measured on a finer grid of places.
FisheyeLens fit_fisheye(const Camera& camera, double& worst_px);
/// Of one of mrcal's models that has the core parameters fx, fy, cx, cy first, such as LENSMODEL_OPENCV8.
Camera fit_model(const Camera& camera, const std::string& lens_model, double& worst_px);
/// One focal length, principal point in the middle, no distortion.
double fit_centred_pinhole(const Camera& camera, double& worst_px);

/// `camera` in one of the `models`, the first that holds it exactly; else fitted to the last. Noted in
/// `fits`; throws Error naming the camera, the format and the error if that is beyond fits.most_px.
Camera expressed(const Camera& camera, std::span<const std::string> models, const std::string& format,
                 LensFits& fits);

/// What a format does with a lens: one of the OpenCV models, or a fisheye.
struct ExpressedLens {
  Camera camera;                       ///< with fx, fy, cx, cy in any case
  std::optional<FisheyeLens> fisheye;  ///< instead of camera's lens
};
/// As expressed(), and where the last model is beyond fits.most_px a fisheye lens is tried.
ExpressedLens expressed_or_fisheye(const Camera& camera, std::span<const std::string> models,
                                   const std::string& format, LensFits& fits);

/// Camera for a file's fisheye lens, as splined_from_fisheye does it; noted in `fits`, refused as there.
Camera camera_of(const FisheyeLens& lens, const std::string& name, int width, int height,
                 const std::string& where, LensFits& fits);

}  // namespace stuv
