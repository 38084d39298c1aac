#include "calib/tracking/object_model.h"

#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <map>
#include <sstream>
#include <tuple>

#include "core/error.h"
#include "core/files.h"

namespace stuv::tracking {
namespace {

using Polygon = std::vector<int>;

struct ObjText {
  std::vector<Eigen::Vector3d> vertices;
  std::vector<Polygon> faces, lines;
};

class ObjReader {
 public:
  explicit ObjReader(const std::filesystem::path& file) : file_(file.string()), text_(read_text(file)) {}

  ObjText read() {
    std::string line, word;
    while (std::getline(text_, line)) {
      ++line_;
      std::istringstream words(line);
      if (!(words >> word)) continue;
      if (word == "v") obj_.vertices.push_back(vertex(words));
      if (word == "f") obj_.faces.push_back(indices(words, 3));
      if (word == "l") obj_.lines.push_back(indices(words, 2));
    }
    return std::move(obj_);
  }

 private:
  [[noreturn]] void fail(const std::string& problem) const {
    throw Error(fmt::format("{}:{}", file_, line_), problem,
                "export the model as a Wavefront OBJ in metres again");
  }

  Eigen::Vector3d vertex(std::istringstream& words) const {
    Eigen::Vector3d v;
    for (int i = 0; i < 3; ++i) {
      std::string word;
      words >> word;
      const auto [end, error] = std::from_chars(word.data(), word.data() + word.size(), v[i]);
      if (error != std::errc() || end != word.data() + word.size() || !std::isfinite(v[i]))
        fail("has a vertex that is not three finite numbers");
    }
    return v;
  }

  /// "7", "7/1", "7/1/3", "7//3"; negative ones count back from the last vertex.
  Polygon indices(std::istringstream& words, std::size_t least) const {
    Polygon polygon;
    const int count = static_cast<int>(obj_.vertices.size());
    for (std::string word; words >> word;) {
      if (word[0] == '#') break;
      int index = 0;
      const auto [end, error] = std::from_chars(word.data(), word.data() + word.size(), index);
      if (error != std::errc() || (end != word.data() + word.size() && *end != '/'))
        fail("has a damaged vertex number");
      index = index < 0 ? count + index : index - 1;
      if (index < 0 || index >= count)
        fail(fmt::format("names a vertex that is not among the {} before", count));
      polygon.push_back(index);
    }
    if (polygon.size() < least) fail(fmt::format("has fewer than {} vertices", least));
    return polygon;
  }

  std::string file_;
  std::istringstream text_;
  ObjText obj_;
  int line_ = 0;
};

/// Vertices at the same place become the first of them.
void merge_vertices(ObjText& obj) {
  std::map<std::tuple<double, double, double>, int> first;
  std::vector<int> to(obj.vertices.size());
  for (std::size_t i = 0; i < obj.vertices.size(); ++i) {
    const Eigen::Vector3d& v = obj.vertices[i];
    to[i] = first.try_emplace({v.x(), v.y(), v.z()}, static_cast<int>(i)).first->second;
  }
  for (auto* polygons : {&obj.faces, &obj.lines})
    for (Polygon& polygon : *polygons) {
      for (int& v : polygon) v = to[v];
      polygon.erase(std::unique(polygon.begin(), polygon.end()), polygon.end());
      if (polygons == &obj.faces && polygon.size() > 1 && polygon.front() == polygon.back())
        polygon.pop_back();
    }
}

/// Newell's normal: its length is twice the area.
Eigen::Vector3d area_normal(const Polygon& face, const std::vector<Eigen::Vector3d>& vertices) {
  Eigen::Vector3d n = Eigen::Vector3d::Zero();
  for (std::size_t i = 0; i < face.size(); ++i)
    n += (vertices[face[i]] - vertices[face[0]])
             .cross(vertices[face[(i + 1) % face.size()]] - vertices[face[0]]);
  return n;
}

class EarClipper {
 public:
  EarClipper(const Polygon& face, const std::vector<Eigen::Vector3d>& vertices, const Eigen::Vector3d& normal)
      : rest_(face), vertices_(vertices), normal_(normal) {}

  std::vector<std::array<int, 3>> cut() {
    std::vector<std::array<int, 3>> triangles;
    while (rest_.size() > 3) {
      // A polygon that crosses itself may have no ear: any corner then does.
      std::size_t ear = 0;
      while (ear < rest_.size() && !is_ear(ear)) ++ear;
      if (ear == rest_.size()) ear = 0;
      triangles.push_back(corner(ear));
      rest_.erase(rest_.begin() + static_cast<std::ptrdiff_t>(ear));
    }
    triangles.push_back({rest_[0], rest_[1], rest_[2]});
    return triangles;
  }

 private:
  std::array<int, 3> corner(std::size_t i) const {
    return {rest_[(i + rest_.size() - 1) % rest_.size()], rest_[i], rest_[(i + 1) % rest_.size()]};
  }
  double turn(int a, int b, int c) const {
    return normal_.dot((vertices_[b] - vertices_[a]).cross(vertices_[c] - vertices_[a]));
  }
  bool is_ear(std::size_t i) const {
    const auto [a, b, c] = corner(i);
    if (turn(a, b, c) <= 0) return false;
    return std::none_of(rest_.begin(), rest_.end(), [&, a = a, b = b, c = c](int p) {
      return p != a && p != b && p != c && turn(a, b, p) >= 0 && turn(b, c, p) >= 0 && turn(c, a, p) >= 0;
    });
  }

  Polygon rest_;
  const std::vector<Eigen::Vector3d>& vertices_;
  Eigen::Vector3d normal_;
};

void add_faces(const ObjText& obj, double least_area, ObjectModel& model, std::vector<Polygon>& kept) {
  for (const Polygon& face : obj.faces) {
    if (face.size() < 3) continue;
    const Eigen::Vector3d n = area_normal(face, obj.vertices);
    if (!(n.norm() > least_area)) continue;
    for (const auto& triangle : EarClipper(face, obj.vertices, n.normalized()).cut()) {
      model.triangles.push_back(triangle);
      model.face_of_triangle.push_back(static_cast<int>(kept.size()));
    }
    model.face_normals.push_back(n.normalized());
    model.face_points.push_back(obj.vertices[face[0]]);
    kept.push_back(face);
  }
}

using EdgeFaces = std::map<std::pair<int, int>, std::vector<int>>;

EdgeFaces edges_of(const std::vector<Polygon>& faces) {
  EdgeFaces edges;
  for (std::size_t f = 0; f < faces.size(); ++f)
    for (std::size_t i = 0; i < faces[f].size(); ++i)
      edges[std::minmax(faces[f][i], faces[f][(i + 1) % faces[f].size()])].push_back(static_cast<int>(f));
  return edges;
}

/// The angle between two faces that meet in an edge; which way round a face is given does not matter where
/// both run along the edge in the same direction.
bool is_crease(const ObjectModel& model, const std::vector<Polygon>& polygons, std::pair<int, int> edge,
               int f, int g, double crease_rad) {
  const auto forwards = [&](const Polygon& p) {
    for (std::size_t i = 0; i < p.size(); ++i)
      if (p[i] == edge.first && p[(i + 1) % p.size()] == edge.second) return true;
    return false;
  };
  const double flip = forwards(polygons[f]) == forwards(polygons[g]) ? -1 : 1;
  return flip * model.face_normals[f].dot(model.face_normals[g]) < std::cos(crease_rad);
}

void add_edges(const ObjText& obj, const std::vector<Polygon>& polygons, const ModelOptions& options,
               ObjectModel& model) {
  const EdgeFaces found = edges_of(polygons);
  std::map<std::pair<int, int>, bool> given;
  for (const Polygon& line : obj.lines)
    for (std::size_t i = 0; i + 1 < line.size(); ++i) given[std::minmax(line[i], line[i + 1])] = true;
  for (const auto& [ends, faces] : found) {
    ObjectModel::Edge edge{ends.first, ends.second, {faces[0], faces.size() > 1 ? faces[1] : -1}, false};
    edge.sharp = given.empty() ? faces.size() != 2 ||
                                     is_crease(model, polygons, ends, faces[0], faces[1], options.crease_rad)
                               : given.count(ends) > 0;
    given.erase(ends);
    const bool bends = faces.size() == 2 &&
                       std::abs(model.face_normals[faces[0]].dot(model.face_normals[faces[1]])) < 1 - 1e-9;
    if (edge.sharp || bends) model.edges.push_back(edge);
  }
  for (const auto& [ends, unused] : given) model.edges.push_back({ends.first, ends.second, {-1, -1}, true});
}

Eigen::AlignedBox3d box_of(const ObjectModel& model) {
  Eigen::AlignedBox3d box;
  for (const ObjectModel::Edge& edge : model.edges) {
    box.extend(model.vertices[edge.a]);
    box.extend(model.vertices[edge.b]);
  }
  return box;
}

}  // namespace

Eigen::Vector3d ObjectModel::centre() const { return box_of(*this).center(); }
double ObjectModel::radius() const { return 0.5 * box_of(*this).diagonal().norm(); }

ObjectModel read_obj(const std::filesystem::path& file, const ModelOptions& options) {
  ObjText obj = ObjReader(file).read();
  merge_vertices(obj);
  Eigen::AlignedBox3d box;
  for (const Eigen::Vector3d& v : obj.vertices) box.extend(v);
  ObjectModel model;
  std::vector<Polygon> polygons;
  if (!obj.vertices.empty()) add_faces(obj, 1e-12 * box.diagonal().squaredNorm(), model, polygons);
  model.vertices = obj.vertices;
  add_edges(obj, polygons, options, model);
  if (model.edges.empty() || !(model.radius() > 0))
    throw Error(file.string(), "has no edge to track", "give faces (f) or lines (l) with some extent");
  return model;
}

}  // namespace stuv::tracking
