#pragma once

#include <Eigen/Dense>
#include <vector>

#include "core/light_field.h"
#include "core/view.h"

namespace stuv {

/// Where a ray (origin o, direction (gx, gy, 1)) crosses the camera lattice, in lattice coordinates p = (col,
/// row).
///
///   p = A (ray at z = w(p)) - e(p),   e(node c) = A (s_c, t_c) - (col_c, row_c),   w(node c) = w_c
///
/// A: affine, fitted to the cameras' (s, t) -> (col, row); e and w are bilinear over the lattice, holes
/// filled from their neighbours, clamped outside. Solved by Newton's method, so that a ray through the
/// centre of camera c, displaced and off the plane as it may be, has exactly p = (col_c, row_c). Across
/// a row (column) p.row (p.col) counts its mean spacings off it; the filters clamp that away. Distances to
/// cameras are then measured in nodes, which makes spacing local.
class LatticeChart {
 public:
  /// Newton steps at most; three or four are the rule.
  static constexpr int kIterations = 32;
  static constexpr double kLeastDeterminant = 0.05;
  /// p closer than this to whole numbers is snapped onto them.
  static constexpr double kSnap = 1e-9;

  LatticeChart(int rows, int cols, const std::vector<View>& cameras);

  Eigen::Vector2d position(const Eigen::Vector3d& o, double gx, double gy) const;
  /// w of the surface that the cameras' centres span, at a position of the lattice.
  double surface_w(const Eigen::Vector2d& p) const { return node_at(p).value.z(); }
  /// All cameras lie in the plane z = 0, so p of a viewpoint in it does not depend on direction.
  bool planar() const { return planar_; }
  /// Inside the convex hull of the present nodes, or on its boundary. Nodes of one row (column): beside their
  /// interval, at most one spacing off it. A single node: on it.
  bool inside_hull(const Eigen::Vector2d& p) const;

  int rows() const { return rows_; }
  int cols() const { return cols_; }
  /// Per node, row by row: e.x, e.y, w.
  const std::vector<Eigen::Vector3d>& nodes() const { return nodes_; }
  /// (s, t, 1) to (col, row).
  const Eigen::Matrix<double, 2, 3>& affine() const { return affine_; }

 private:
  void fit_affine(const std::vector<View>& cameras);
  void fill_nodes(const std::vector<View>& cameras);
  void build_hull(const std::vector<View>& cameras);
  struct Interpolated {
    Eigen::Vector3d value;                 ///< e.x, e.y, w
    Eigen::Matrix<double, 3, 2> gradient;  ///< along col and row
  };
  Interpolated node_at(const Eigen::Vector2d& p) const;

  int rows_ = 0, cols_ = 0;
  bool planar_ = true;
  Eigen::Matrix<double, 2, 3> affine_;
  std::vector<Eigen::Vector3d> nodes_;
  std::vector<Eigen::Vector2d> hull_;  ///< counter-clockwise
  Eigen::Vector2d low_, high_;         ///< bounding box of the present nodes
};

/// One camera's part in a filter.
struct CameraWeight {
  int camera = 0;
  double weight = 0;
};

/// The filters of figure 7 on a lattice with holes. With h the tent's half-width in nodes,
///
///   weight(node) = (1 - |col - p.col| / h)+ (1 - |row - p.row| / h)+
///
/// normal: h = 1; wide: h = 2 (the factor 1/4 cancels in the division by the sum); skipped: h = 2 over nodes
/// of even row and column. A lattice of one row has no tent along columns, and the other way round. p is
/// clamped to the lattice. A missing node hands its weight to present ones: by linear interpolation to the
/// next ones on both sides along its row and along its column (the mean of the two where both exist), so
/// along a row a tent reaches to the next present camera. Where neither axis has cameras on both sides, to
/// the nearest on one side; where there are none either, to the nearest of the lattice.
class LatticeFilter {
 public:
  LatticeFilter(int rows, int cols, const std::vector<View>& cameras, Filter filter);

  /// Weights > 0, their sum 1; replaces the contents of `out`.
  void weights(Eigen::Vector2d p, std::vector<CameraWeight>& out) const;

  int stride() const { return stride_; }
  double half_width() const { return half_width_; }
  /// Per node of the (thinned) lattice, row by row: who stands in for it.
  const std::vector<std::vector<CameraWeight>>& bridges() const { return bridges_; }
  int thinned_rows() const { return rows_; }
  int thinned_cols() const { return cols_; }

 private:
  int full_rows_ = 0, full_cols_ = 0;
  int stride_ = 1;         ///< nodes of the full lattice per node of the thinned one
  double half_width_ = 1;  ///< in thinned nodes
  int rows_ = 0, cols_ = 0;
  std::vector<std::vector<CameraWeight>> bridges_;
};

}  // namespace stuv
