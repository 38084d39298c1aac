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

/// Where two edges cross, to a part of a pixel: the point that all gradients around it stand square to a ray
/// from (Foerstner and Guelch, 1987).
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

/// Covariance of refine_corner's result at `at` for white noise of deviation `noise` in the pixels.
///
/// With d_i = p_i - q, noise changes sum_i w_i g_i (g_i . d_i) by sum_i A_i dg_i, A_i = w_i (g_i d_i^T + g_i
/// . d_i I), which as a sum over pixels is sum_k n_k c_k, c half the differences of A's columns along x and
/// y; and to second order, which counts where squares are dark, by terms of variance w_i^2 (noise^2 / 2)^2
/// (d_i d_i^T + |d_i|^2 I):
///
///   C = M^-1 (noise^2 sum_k c_k c_k^T + noise^4 / 4 sum_i w_i^2 (d_i d_i^T + |d_i|^2 I)) M^-1
std::optional<Eigen::Matrix2d> corner_covariance(const CornerImage& image, const Eigen::Vector2d& at,
                                                 double radius_px, double noise);

/// Deviation of the picture's noise within `area`, from second differences that plane shading and straight
/// edges along an axis leave 0 (Immerkaer, 1996), by their median; at least that of rounding to integers.
double picture_noise(const CornerImage& image, const cv::Rect& area);

}  // namespace stuv
