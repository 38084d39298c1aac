#pragma once

#include <vector>

#include "calib/tracking/lens.h"
#include "calib/tracking/object_model.h"
#include "calib/tracking/se3.h"

namespace stuv::tracking {

/// An edge of the model with the planes of the faces that meet in it: what tells whether it is the outline.
struct OutlineEdge {
  struct Plane {
    Eigen::Vector3d n, at;
  };
  Eigen::Vector3d a, b;
  std::vector<Plane> faces;  ///< one or two
};
std::vector<OutlineEdge> outline_edges(const ObjectModel& model);

/// The object's outline in the picture of one pose: the edges that part a face seen from the front from one
/// seen from behind, or that belong to one face only. On one side of them the picture shows something else,
/// be it the background or another part of the object. Between its ends an edge is taken as straight in the
/// picture. Parts that other faces hide are not known to be hidden.
class Outline {
 public:
  Outline(const std::vector<OutlineEdge>& edges, const Lens& lens, const Pose& cam_from_object);
  /// Whether a pixel is at most `distance_px` away from it.
  bool is_near(const Eigen::Vector2d& q, double distance_px) const;

 private:
  struct Segment {
    Eigen::Vector2d from, along;
    double per_length2;  ///< 1 / |along|^2
  };
  std::vector<Segment> segments_;
};

}  // namespace stuv::tracking
