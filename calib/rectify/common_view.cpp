#include "calib/rectify/common_view.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "core/error.h"
#include "core/median.h"
#include "core/parallel.h"

namespace stuv {
namespace {

using Box = Eigen::AlignedBox2d;      ///< of directions, as (X, Y) on the plane Z = 1 of the rig's axes
constexpr double kMostSlope = 3.732;  ///< tan 75 degrees

/// Where a pixel of the camera looks, kept within what a plane can show.
std::vector<Eigen::Vector2d> slopes(const Camera& camera, const std::vector<Eigen::Vector2d>& pixels) {
  std::vector<Eigen::Vector2d> result;
  for (const Eigen::Vector3d& ray : unproject(camera, pixels)) {
    const Eigen::Vector3d r = camera.cam_from_rig.R.transpose() * ray;
    const double z = std::max(r.z(), 1e-6);
    result.push_back((r.head<2>() / z).cwiseMax(-kMostSlope).cwiseMin(kMostSlope));
  }
  return result;
}

/// Middle of the field of view of one camera.
Eigen::Vector2d field_centre(const Camera& camera) {
  const double right = camera.width - 1, bottom = camera.height - 1;
  const auto s =
      slopes(camera, {{0, 0.5 * bottom}, {right, 0.5 * bottom}, {0.5 * right, 0}, {0.5 * right, bottom}});
  // A camera that lies on its side has its left and right above and below.
  const auto middle = [&](int axis) {
    const double across = 0.5 * (s[0][axis] + s[1][axis]), down = 0.5 * (s[2][axis] + s[3][axis]);
    return std::abs(s[0][axis] - s[1][axis]) > std::abs(s[2][axis] - s[3][axis]) ? across : down;
  };
  return {middle(0), middle(1)};
}

/// Bounds of what a camera sees.
Box field_box(const Camera& camera) {
  constexpr int kSide = 32;
  std::vector<Eigen::Vector2d> border;
  for (int i = 0; i <= kSide; ++i) {
    const double x = (camera.width - 1) * i / double(kSide), y = (camera.height - 1) * i / double(kSide);
    border.insert(border.end(), {{x, 0}, {x, camera.height - 1.0}, {0, y}, {camera.width - 1.0, y}});
  }
  Box box;
  for (const Eigen::Vector2d& s : slopes(camera, border)) box.extend(s);
  return box;
}

/// Which of the directions a camera sees. The way back from its own pixel tells folds of the lens model
/// apart.
std::vector<char> sees(const Camera& camera, const std::vector<Eigen::Vector2d>& directions) {
  std::vector<Eigen::Vector3d> rays;
  for (const Eigen::Vector2d& d : directions)
    rays.push_back((camera.cam_from_rig.R * Eigen::Vector3d(d.x(), d.y(), 1)).normalized());
  const std::vector<Eigen::Vector2d> q = project(camera, rays);
  std::vector<Eigen::Vector2d> inside;
  std::vector<std::size_t> which;
  for (std::size_t i = 0; i < q.size(); ++i)
    if (q[i].x() >= 0 && q[i].y() >= 0 && q[i].x() <= camera.width - 1 && q[i].y() <= camera.height - 1) {
      inside.push_back(q[i]);
      which.push_back(i);
    }
  std::vector<char> seen(directions.size(), 0);
  const std::vector<Eigen::Vector3d> back = unproject(camera, inside);
  for (std::size_t k = 0; k < which.size(); ++k) seen[which[k]] = (back[k] - rays[which[k]]).norm() < 1e-3;
  return seen;
}

struct Fields {
  std::vector<const Camera*> cameras;
  Box all;
  /// Directions on a kNodes x kNodes grid over `all` that each camera sees.
  static constexpr int kNodes = 161;
  std::vector<std::vector<char>> seen;

  Eigen::Vector2d node(int x, int y) const {
    return all.min() + all.sizes().cwiseProduct(Eigen::Vector2d(x, y)) / (kNodes - 1);
  }
};

Fields fields_of(const std::vector<const Camera*>& cameras) {
  Fields f{cameras, {}, std::vector<std::vector<char>>(cameras.size())};
  for (const Camera* camera : cameras) f.all.extend(field_box(*camera));
  std::vector<Eigen::Vector2d> nodes;
  for (int y = 0; y < Fields::kNodes; ++y)
    for (int x = 0; x < Fields::kNodes; ++x) nodes.push_back(f.node(x, y));
  parallel_for(static_cast<int>(cameras.size()), [&](int i) { f.seen[i] = sees(*cameras[i], nodes); });
  return f;
}

bool overlap(const std::vector<char>& a, const std::vector<char>& b) {
  for (std::size_t i = 0; i < a.size(); ++i)
    if (a[i] != 0 && b[i] != 0) return true;
  return false;
}

[[noreturn]] void fail_without_common(const Fields& f) {
  constexpr const char* kRemedy = "use --field mean, or leave a camera out";
  for (std::size_t a = 0; a < f.seen.size(); ++a)
    for (std::size_t b = a + 1; b < f.seen.size(); ++b)
      if (!overlap(f.seen[a], f.seen[b]))
        throw Error("rig",
                    fmt::format("cameras {} and {} have no field of view in common", f.cameras[a]->name,
                                f.cameras[b]->name),
                    kRemedy);
  std::string names;
  for (const Camera* camera : f.cameras) names += (names.empty() ? "" : ", ") + camera->name;
  throw Error("rig", fmt::format("no direction is in the pictures of all of {}", names), kRemedy);
}

/// The largest rectangle of nodes that are all set: for every row, the nodes set above each column are a
/// histogram, and its largest rectangle is found with a stack of rising columns.
std::optional<Eigen::AlignedBox2i> largest_rectangle(const std::vector<char>& set, int n) {
  std::vector<int> height(n + 1, 0);
  std::optional<Eigen::AlignedBox2i> best;
  int best_area = 0;
  for (int y = 0; y < n; ++y) {
    for (int x = 0; x < n; ++x) height[x] = set[y * n + x] != 0 ? height[x] + 1 : 0;
    std::vector<int> rising;
    for (int x = 0; x <= n; ++x) {
      while (!rising.empty() && height[rising.back()] >= height[x]) {
        const int h = height[rising.back()];
        rising.pop_back();
        const int left = rising.empty() ? 0 : rising.back() + 1;
        // Nodes bound cells: one less on each side.
        if (const int area = (h - 1) * (x - left - 1); area > best_area) {
          best_area = area;
          best = Eigen::AlignedBox2i(Eigen::Vector2i(left, y - h + 1), Eigen::Vector2i(x - 1, y));
        }
      }
      rising.push_back(x);
    }
  }
  return best;
}

bool all_see_border(const Fields& f, const Box& box) {
  constexpr int kSide = 128;
  std::vector<Eigen::Vector2d> border;
  for (int i = 0; i <= kSide; ++i) {
    const Eigen::Vector2d at = box.min() + box.sizes() * (i / double(kSide));
    border.insert(
        border.end(),
        {{at.x(), box.min().y()}, {at.x(), box.max().y()}, {box.min().x(), at.y()}, {box.max().x(), at.y()}});
  }
  for (const Camera* camera : f.cameras)
    for (const char seen : sees(*camera, border))
      if (seen == 0) return false;
  return true;
}

/// The largest rectangle in all fields: among the grid's nodes, then its sides moved out by ever smaller
/// steps.
Box common_box(const Fields& f) {
  std::vector<char> common(f.seen[0].size(), 1);
  for (const std::vector<char>& seen : f.seen)
    for (std::size_t i = 0; i < seen.size(); ++i) common[i] = common[i] != 0 && seen[i] != 0 ? 1 : 0;
  const auto nodes = largest_rectangle(common, Fields::kNodes);
  if (!nodes) fail_without_common(f);
  Box box(f.node(nodes->min().x(), nodes->min().y()), f.node(nodes->max().x(), nodes->max().y()));
  const Eigen::Vector2d spacing = f.all.sizes() / (Fields::kNodes - 1);
  for (double part = 0.5; part > 1e-3; part /= 2)
    for (int side = 0; side < 4; ++side) {
      Box larger = box;
      const int axis = side % 2;
      if (side < 2)
        larger.min()[axis] -= part * spacing[axis];
      else
        larger.max()[axis] += part * spacing[axis];
      if (all_see_border(f, larger)) box = larger;
    }
  return box;
}

std::vector<const Camera*> determined_cameras(const Rig& rig) {
  constexpr double kCos60 = 0.5;
  std::vector<const Camera*> cameras;
  for (const RigCamera& rc : rig.cameras) {
    if (!rc.determined) continue;
    if (rc.camera.cam_from_rig.R(2, 2) <= kCos60)
      throw Error("rig", fmt::format("camera {} looks away from the plane's normal", rc.camera.name),
                  "calibrate again, or leave that camera out");
    cameras.push_back(&rc.camera);
  }
  if (cameras.empty()) throw Error("rig", "no camera of the rig is determined", "calibrate with more boards");
  return cameras;
}

/// Size of the first camera's picture as it stands upright in the view.
Eigen::Vector2i upright_size(const Camera& camera) {
  const Eigen::Matrix3d& R = camera.cam_from_rig.R;
  const bool on_its_side = std::abs(R(0, 1)) > std::abs(R(0, 0));
  return on_its_side ? Eigen::Vector2i(camera.height, camera.width)
                     : Eigen::Vector2i(camera.width, camera.height);
}

/// Size and principal point such that the box fills the picture, pixels' centres on its border or within.
void fit_to(const Box& box, CommonView& view) {
  const Eigen::Vector2d size_px = view.focal_px * box.sizes();
  const Eigen::Vector2d size = (size_px.array() + 1e-6).floor() + 1;
  if (size.maxCoeff() > kMostViewSize)
    throw Error("rig", fmt::format("the field of view takes {:.0f}x{:.0f} px", size.x(), size.y()),
                "use a smaller --focal-px, --size or --field mean");
  view.width = static_cast<int>(size.x());
  view.height = static_cast<int>(size.y());
}

void centre_on(const Eigen::Vector2d& direction, CommonView& view) {
  view.cx_px = 0.5 * (view.width - 1) - view.focal_px * direction.x();
  view.cy_px = 0.5 * (view.height - 1) - view.focal_px * direction.y();
}

void crop_to(const CommonViewOptions::Crop& crop, CommonView& view) {
  if (crop.x < 0 || crop.y < 0 || crop.width <= 0 || crop.height <= 0 || crop.x + crop.width > view.width ||
      crop.y + crop.height > view.height)
    throw Error(fmt::format("crop {},{},{}x{}", crop.x, crop.y, crop.width, crop.height),
                fmt::format("does not lie within the common view of {}x{} px", view.width, view.height),
                "choose a part of it, or another --field");
  view.cx_px -= crop.x;
  view.cy_px -= crop.y;
  view.width = crop.width;
  view.height = crop.height;
}

void require_seen(const std::vector<const Camera*>& cameras, const CommonView& view) {
  constexpr int kNodes = 33;
  std::vector<Eigen::Vector2d> directions;
  for (int j = 0; j < kNodes; ++j)
    for (int i = 0; i < kNodes; ++i)
      directions.emplace_back(((view.width - 1.0) * i / (kNodes - 1) - view.cx_px) / view.focal_px,
                              ((view.height - 1.0) * j / (kNodes - 1) - view.cy_px) / view.focal_px);
  for (const Camera* camera : cameras) {
    const std::vector<char> seen = sees(*camera, directions);
    if (std::find(seen.begin(), seen.end(), 1) == seen.end())
      throw Error("rig", fmt::format("camera {} sees nothing of the chosen view", camera->name),
                  "use --field all or another crop, or leave that camera out");
  }
}

}  // namespace

CommonView common_view(const Rig& rig, const CommonViewOptions& options) {
  using Field = CommonViewOptions::Field;
  const std::vector<const Camera*> cameras = determined_cameras(rig);
  std::vector<double> focals;
  Eigen::Vector2d centre = Eigen::Vector2d::Zero();
  for (const Camera* camera : cameras) {
    focals.push_back(0.5 * (camera->intrinsics[0] + camera->intrinsics[1]));
    centre += field_centre(*camera) / static_cast<double>(cameras.size());
  }
  CommonView view;
  const double natural = median(focals);
  view.focal_px = options.focal_px > 0 ? options.focal_px : natural;
  if (options.field == Field::mean) {
    const Eigen::Vector2d size = upright_size(*cameras[0]).cast<double>() * (view.focal_px / natural);
    fit_to(Box(Eigen::Vector2d(0, 0), (size.array().round() - 1).matrix() / view.focal_px), view);
  } else {
    const Fields fields = fields_of(cameras);
    const Box box = options.field == Field::common ? common_box(fields) : fields.all;
    fit_to(box, view);
    centre = box.center();
  }
  if (options.width > 0) view.width = options.width;
  if (options.height > 0) view.height = options.height;
  centre_on(centre, view);
  if (options.crop) crop_to(*options.crop, view);
  require_seen(cameras, view);
  return view;
}

}  // namespace stuv
