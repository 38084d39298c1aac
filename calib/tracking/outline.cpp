#include "calib/tracking/outline.h"

#include <algorithm>

namespace stuv::tracking {

std::vector<OutlineEdge> outline_edges(const ObjectModel& model) {
  std::vector<OutlineEdge> edges;
  for (const ObjectModel::Edge& e : model.edges) {
    OutlineEdge edge{model.vertices[e.a], model.vertices[e.b], {}};
    for (const int face : e.faces)
      if (face >= 0) edge.faces.push_back({model.face_normals[face], model.face_points[face]});
    if (!edge.faces.empty()) edges.push_back(edge);
  }
  return edges;
}

Outline::Outline(const std::vector<OutlineEdge>& edges, const Lens& lens, const Pose& cam_from_object) {
  const Eigen::Vector3d eye = cam_from_object.centre();
  const auto from_front = [&](const OutlineEdge::Plane& face) { return face.n.dot(eye - face.at) > 0; };
  Eigen::Vector2d a, b;
  for (const OutlineEdge& e : edges) {
    if (e.faces.size() == 2 && from_front(e.faces[0]) == from_front(e.faces[1])) continue;
    if (!lens.project(cam_from_object * e.a, a) || !lens.project(cam_from_object * e.b, b)) continue;
    const double length2 = (b - a).squaredNorm();
    segments_.push_back({a, b - a, length2 > 0 ? 1 / length2 : 0});
  }
}

bool Outline::is_near(const Eigen::Vector2d& q, double distance_px) const {
  return std::any_of(segments_.begin(), segments_.end(), [&](const Segment& s) {
    // Most are far from the whole line.
    const Eigen::Vector2d d = q - s.from;
    const double across = s.along.x() * d.y() - s.along.y() * d.x();
    if (across * across * s.per_length2 > distance_px * distance_px) return false;
    const double t = std::clamp(s.along.dot(d) * s.per_length2, 0.0, 1.0);
    return (d - t * s.along).squaredNorm() <= distance_px * distance_px;
  });
}

}  // namespace stuv::tracking
