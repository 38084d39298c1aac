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

struct RefinedCorner {
  Eigen::Vector2d at_px;
  /// Of at_px for picture noise of deviation 1 in every pixel; a coordinate's mean deviation is
  /// sqrt(trace / 2).
  Eigen::Matrix2d unit_covariance;
};

/// Where two edges cross, to a part of a pixel: the point that all gradients around it stand square to a ray
/// from (Foerstner and Guelch, 1987).
///
///   q = argmin sum_i w_i (g_i . (p_i - q))^2 = M^-1 sum_i w_i g_i g_i^T p_i,   M = sum_i w_i g_i g_i^T
///
/// p_i: pixels within radius_px of q, g_i: gradients, w_i = exp(-|p_i - q|^2 / (2 (radius/2)^2)). On a
/// crossing of four squares both sides of each edge count alike, so that blur does not move it.
///
/// Noise n_k in the pixels moves it by M^-1 sum_k n_k c_k, where c is minus the divergence of the field
/// w_i g_i (p_i - q)^T, so its covariance is M^-1 (sum_k c_k c_k^T) M^-1 for noise of deviation 1.
///
/// Nothing if the window leaves the picture, the point moves more than most_shift_px from `start`, or the
/// window has no two directions of edges.
std::optional<RefinedCorner> refine_corner(const CornerImage& image, const Eigen::Vector2d& start,
                                           double radius_px, double most_shift_px);

/// Covariance as of refine_corner, at a point that is not moved.
std::optional<Eigen::Matrix2d> unit_covariance(const CornerImage& image, const Eigen::Vector2d& at,
                                               double radius_px);

/// Deviation of the picture's noise within `area`, from second differences that plane shading and straight
/// edges along an axis leave 0 (Immerkaer, 1996), by their median; at least that of rounding to integers.
double picture_noise(const CornerImage& image, const cv::Rect& area);

}  // namespace stuv
