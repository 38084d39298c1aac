#pragma once

#include <Eigen/Dense>
#include <opencv2/core.hpp>
#include <optional>

namespace stuv {

/// Luma of a picture with its gradients, what corners are refined in. Values in 0..255.
struct CornerImage {
  cv::Mat grey;                    ///< CV_8U, for detectors
  cv::Mat luma;                    ///< CV_32F
  cv::Mat gradient_x, gradient_y;  ///< CV_32F, central differences
};

/// Where two edges cross, to about a tenth of a pixel: the point that all gradients around it stand square to
/// a ray from (Foerstner and Guelch, 1987).
///
///   q = argmin sum_i w_i (g_i . (p_i - q))^2 = M^-1 sum_i w_i g_i g_i^T p_i,   M = sum_i w_i g_i g_i^T
///
/// p_i: pixels within radius_px of q, g_i: gradients, w_i = exp(-|p_i - q|^2 / (2 (radius/2)^2)). On a
/// crossing of four squares both sides of each edge count alike, so that blur does not move it.
///
/// Nothing if the window leaves the picture, the point moves more than most_shift_px from `start`, or the
/// window has no two directions of edges.
std::optional<Eigen::Vector2d> refine_corner(const CornerImage& image, const Eigen::Vector2d& start,
                                             double radius_px, double most_shift_px);

}  // namespace stuv
