#pragma once

#include <array>
#include <span>
#include <vector>

#include "calib/tracking/measurement.h"
#include "calib/tracking/outline.h"
#include "calib/tracking/texture.h"

namespace stuv::tracking {

/// A picture smoothed by a Gaussian of 1 px (level 0), and halved twice: pixel q of level 0 is q / 2^level.
struct SmoothPyramid {
  static constexpr int count = 3;
  std::array<ImageF, count> levels;
};
SmoothPyramid smooth_pyramid(const Grey& picture);
/// The same into what is there: pictures of the same size cost no new memory.
void smooth_pyramid(const Grey& picture, SmoothPyramid& out);

/// A taught view as points of the object's surface with the brightness seen there, smoothed as SmoothPyramid
/// does but over the object only: what lies behind it is not the object's.
struct SurfaceView {
  struct Point {
    Eigen::Vector3d x, n;  ///< in the object's frame; unit normal towards the taught view
    int face = 0;          ///< counts the faces of this view from 0
    std::array<float, SmoothPyramid::count> value = {};
    double area = 1;  ///< that a piece of surface there takes in the taught picture, cos / distance^2
  };
  Pose cam_from_object;
  std::vector<Point> points;  ///< in an order such that the first few are spread over all of the object
  int faces = 0;
  std::vector<int> face_of;  ///< the model's number of each face
  double spacing = 0;        ///< between points, of the object's lengths
  /// Points of faces that the view does not show, without `value`; `face` counts these faces from 0.
  std::vector<Point> unseen;
  int unseen_faces = 0;
  std::vector<OutlineEdge> edges;  ///< of the model
  double inside_px = 0;            ///< how far inside the outline points lie
};

/// At most `most` points, evenly over the part of the object that the view sees no more than 75 degrees
/// slanted, `inside_px` inside the outline: blur mixes the background in there.
SurfaceView surface_view(const TexturedView& view, const ObjectModel& model, const ImageF& rays, int most);

/// Whether the view's faces show no print: nothing but their brightness.
bool is_plain(const SurfaceView& view);

/// Fills `unseen`, about as dense as `points`, from the faces that nothing of the object can hide because all
/// of it lies behind them. For an object of which every taught view is plain: its other faces are then taken
/// to be plain as well, of a brightness that is not known. Without them a pose that lays such a face over the
/// background would be as good as one that does not.
void add_unseen_faces(const ObjectModel& model, SurfaceView& view);

/// How a picture looks where the surface's points fall: zero-mean normalised correlation with what the view
/// shows there, over the points that face the camera and lie `inside_px` (on coarser levels two and three
/// times that) inside its outline from there, too: what was well inside the object where it was taught may be
/// its rim now. A point counts by the part of its taught area in the picture that it still has.
struct Likeness {
  /// 1 - (mean square of I - a T - b) / max(var I, a^2 var T, 10^2), the gain a within 0.4 .. 2.5: a plain
  /// side is like any plain place, but not like one with a pattern. Each unseen face has a T of its own that
  /// fits. NaN: too few points.
  double fit = 0;
  double whole = 0;  ///< NaN: too few points (a third of them, or 30) or a view without contrast
  double print = 0;  ///< with each face's mean taken away, so of the print alone; NaN: plain faces
};
/// The first `most` points of the view are looked at. Points that other faces hide are not known to be
/// hidden.
Likeness likeness(const SurfaceView& view, const SmoothPyramid& picture, int level, const Lens& lens,
                  const Pose& cam_from_object, int most);

/// A pose at which the picture looks like the view.
struct Alignment {
  Pose cam_from_object;
  Matrix6 information = Matrix6::Zero();  ///< of the twist mu in X exp(mu): inverse of its covariance
  bool converged = false;
};

/// Direct alignment on brightness (Lucas and Kanade on SE(3)), from level `from` to `to`, at most 8 steps
/// each:
///
///   min over mu, a, b of sum_v sum_j w_j (I(pi(X exp(mu) x_j)) - a_v T_j - b_v)^2 + mu^T P mu
///
/// I: the picture, T_j: brightness in view v (at most kMostViews), a, b: gain and offset of its exposure, w:
/// biweight at 4.7 robust deviations, over the variance of the residuals and of the model's error. P says
/// that X is right to `spread` (standard deviations of a twist in the camera's axes), so what brightness does
/// not tell stays. Unlike corners, this bears blur. information: J^T W J over the residuals' variance, a
/// tenth of it, as neighbouring residuals go wrong together. Views of which less than a third faces the
/// camera are left out.
constexpr int kMostViews = 2;
Alignment align(std::span<const SurfaceView* const> views, const SmoothPyramid& picture, int from,
                const Lens& lens, const Pose& cam_from_object, const Twist& spread, int to = 0);

}  // namespace stuv::tracking
