#pragma once

#include <Eigen/Dense>
#include <array>
#include <filesystem>
#include <vector>

namespace stuv::tracking {

/// A known object: opaque faces and the edges that may show in a picture. Its own frame, metres.
struct ObjectModel {
  struct Edge {
    int a = 0, b = 0;                     ///< vertices
    std::array<int, 2> faces = {-1, -1};  ///< that meet here, -1: none
    bool sharp = false;                   ///< drawn from everywhere; else only where it is the outline
  };
  std::vector<Eigen::Vector3d> vertices;
  std::vector<std::array<int, 3>> triangles;
  std::vector<int> face_of_triangle;
  std::vector<Eigen::Vector3d> face_normals, face_points;
  std::vector<Edge> edges;

  /// Middle of the bounding box, and half of its diagonal [m].
  Eigen::Vector3d centre() const;
  double radius() const;
};

struct ModelOptions {
  double crease_rad = 0.35;  ///< faces that meet at a larger angle make a sharp edge
};

/// Reads v, f and l of a Wavefront OBJ; every other line is passed over.
///
/// Sharp edges are those given as l; without any, the boundary (edges of one face), creases, and edges of
/// more than two faces. An edge that is not sharp shows where it parts a face seen from the front from one
/// seen from behind (the outline of smooth surfaces). Vertices at the same place are one. Faces are polygons
/// of any shape, cut into triangles by ear clipping; faces without area are left out.
/// Throws Error with the line number: an index out of range, a number that is damaged or not finite; or if
/// there is no edge, or the object has no extent.
ObjectModel read_obj(const std::filesystem::path& file, const ModelOptions& options = {});

}  // namespace stuv::tracking
