#include "capture/synthetic/scene.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "capture/synthetic/random.h"
#include "capture/synthetic/texture.h"

namespace stuv::synthetic {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

enum Object {
  kFloor,
  kWall,
  kCeiling,
  kCrate,
  kMarble,
  kGlossy,
  kMirror,
  kPillar,
  kPot,
  kStalk,
  kLeaf,
  kPost,
  kWire,
  kCable,
  kGlobe,
  kBall
};

constexpr double kFloorY = 0.55, kCeilingY = -1.9;
constexpr double kFar = 1e9, kNear = 1e-6;
const Vector3d kLamp(-1.3, -1.7, 0.4);
const Vector3d kBallStart(0.12, -0.28, 1.9);

// The painting's place on the wall.
constexpr double kPaintingX = 0.35, kPaintingY = -0.95, kPaintingWidth = 0.95, kPaintingHeight = 0.62;
constexpr double kFrame = 0.035;

struct Hit {
  double distance = kFar;
  Vector3d point, normal;
  int object = -1;
};

/// Distance to a sphere around `to_centre` seen from the ray's origin, or kFar.
double sphere_distance(const Vector3d& to_centre, double radius, const Vector3d& direction) {
  const double b = to_centre.dot(direction), c = to_centre.squaredNorm() - radius * radius;
  const double d = b * b - c;
  if (d < 0) return kFar;
  const double near = b - std::sqrt(d);
  return near > kNear ? near : kFar;
}

/// Distance to a capsule: a cylinder from a to a + axis, closed by two half spheres.
double capsule_distance(const Vector3d& from_a, const Vector3d& axis, double radius,
                        const Vector3d& direction) {
  const double aa = axis.squaredNorm(), ad = axis.dot(direction), ao = axis.dot(from_a);
  const double od = from_a.dot(direction), oo = from_a.squaredNorm();
  const double a = aa - ad * ad, b = aa * od - ao * ad, c = aa * oo - ao * ao - radius * radius * aa;
  const double h = b * b - a * c;
  if (h < 0 || a <= 0) return kFar;
  const double side = (-b - std::sqrt(h)) / a, y = ao + side * ad;
  if (y > 0 && y < aa) return side > kNear ? side : kFar;
  return sphere_distance(y <= 0 ? Vector3d(-from_a) : Vector3d(axis - from_a), radius, direction);
}

/// Whether a ray passes through a box nearer than `limit`.
bool meets(const Eigen::AlignedBox3d& box, const Vector3d& origin, const Vector3d& inverse, double limit) {
  const Vector3d a = (box.min() - origin).cwiseProduct(inverse),
                 b = (box.max() - origin).cwiseProduct(inverse);
  const double enter = a.cwiseMin(b).maxCoeff(), leave = a.cwiseMax(b).minCoeff();
  return enter <= leave && leave > 0 && enter < limit;
}

/// Light that comes from outside of everything: a bright ceiling window for reflections.
Colour surroundings(const Vector3d& direction) {
  const auto up = static_cast<float>(-direction.y());
  return Colour(0.20F, 0.21F, 0.23F) + std::max(up, 0.0F) * Colour(0.35F, 0.38F, 0.42F);
}

}  // namespace

/// One ray's way through the scene.
class Tracer {
 public:
  Tracer(const Scene& scene, std::int64_t time_ns) : scene_(scene), ball_(scene.ball_centre(time_ns)) {}

  Hit nearest(const Vector3d& origin, const Vector3d& direction) const {
    Hit hit;
    hit_planes(origin, direction, hit);
    if (scene_.options_.kind == SceneOptions::Kind::wall) return hit;
    hit_solids(origin, direction, hit);
    return hit;
  }

  Colour light(const Hit& hit, const Vector3d& direction, double step, int bounces) const {
    if (hit.object < 0) return surroundings(direction);
    if (hit.object == kGlobe)
      return Colour(0.95F, 0.90F, 0.75F) * static_cast<float>(0.75 - 0.25 * hit.normal.dot(direction));
    Colour surface = texture(hit, step);
    if (scene_.options_.kind == SceneOptions::Kind::wall) return surface;
    Colour sum = surface.cwiseProduct(incoming(hit));
    const float gloss = gloss_of(hit.object);
    if (gloss > 0) sum += reflected(hit, direction, step, bounces, gloss);
    return sum;
  }

 private:
  void hit_planes(const Vector3d& origin, const Vector3d& direction, Hit& hit) const {
    const auto plane = [&](int axis, double at, double normal, int object) {
      const double distance = (at - origin[axis]) / direction[axis];
      if (!(distance > kNear) || distance >= hit.distance) return;
      hit.distance = distance;
      hit.point = origin + distance * direction;
      hit.normal = normal * Vector3d::Unit(axis);
      hit.object = object;
    };
    if (direction.z() > 0) plane(2, scene_.options_.wall_m, -1, kWall);
    if (scene_.options_.kind == SceneOptions::Kind::wall) return;
    if (direction.y() > 0) plane(1, kFloorY, -1, kFloor);
    if (direction.y() < 0) plane(1, kCeilingY, 1, kCeiling);
  }

  void hit_sphere(const Vector3d& origin, const Vector3d& direction, const Vector3d& centre, double radius,
                  int object, Hit& hit) const {
    const double distance = sphere_distance(centre - origin, radius, direction);
    if (distance >= hit.distance) return;
    hit.distance = distance;
    hit.point = origin + distance * direction;
    hit.normal = (hit.point - centre) / radius;
    hit.object = object;
  }

  void hit_box(const Vector3d& origin, const Vector3d& direction, const Scene::Box& box, Hit& hit) const {
    const Vector3d o = box.box_from_rig * (origin - box.centre), d = box.box_from_rig * direction;
    double enter = -kFar, leave = kFar;
    int face = 0;
    for (int axis = 0; axis < 3; ++axis) {
      const double side = d[axis] > 0 ? 1 : -1;
      const double a = (-side * box.half[axis] - o[axis]) / d[axis],
                   b = (side * box.half[axis] - o[axis]) / d[axis];
      if (a > enter) {
        enter = a;
        face = axis;
      }
      leave = std::min(leave, b);
    }
    if (!(enter < leave) || enter <= kNear || enter >= hit.distance) return;
    hit.distance = enter;
    hit.point = origin + enter * direction;
    hit.normal = box.box_from_rig.transpose() * (d[face] > 0 ? -1.0 : 1.0) * Vector3d::Unit(face);
    hit.object = box.object;
  }

  void hit_capsule(const Vector3d& origin, const Vector3d& direction, const Scene::Capsule& capsule,
                   Hit& hit) const {
    const double distance = capsule_distance(origin - capsule.a, capsule.axis, capsule.radius, direction);
    if (distance >= hit.distance) return;
    hit.distance = distance;
    hit.point = origin + distance * direction;
    const Vector3d from_a = hit.point - capsule.a;
    const double along = std::clamp(from_a.dot(capsule.axis) / capsule.axis.squaredNorm(), 0.0, 1.0);
    hit.normal = (from_a - along * capsule.axis) / capsule.radius;
    hit.object = capsule.object;
  }

  void hit_ellipsoid(const Vector3d& origin, const Vector3d& direction, const Scene::Ellipsoid& e,
                     Hit& hit) const {
    const Vector3d o = e.to_unit * (origin - e.centre);
    Vector3d d = e.to_unit * direction;
    const double scale = d.norm();
    d /= scale;
    const double distance = sphere_distance(-o, 1, d) / scale;
    if (distance >= hit.distance) return;
    hit.distance = distance;
    hit.point = origin + distance * direction;
    hit.normal = (e.to_unit.transpose() * (o + distance * scale * d)).normalized();
    hit.object = e.object;
  }

  void hit_group(const Vector3d& origin, const Vector3d& direction, const Scene::Group& group,
                 Hit& hit) const {
    for (const Scene::Capsule& capsule : group.capsules) hit_capsule(origin, direction, capsule, hit);
    for (const Scene::Ellipsoid& leaf : group.ellipsoids) hit_ellipsoid(origin, direction, leaf, hit);
  }

  void hit_solids(const Vector3d& origin, const Vector3d& direction, Hit& hit) const {
    hit_sphere(origin, direction, ball_, Scene::kBallRadius_m, kBall, hit);
    for (const Scene::Sphere& s : scene_.spheres_)
      hit_sphere(origin, direction, s.centre, s.radius, s.object, hit);
    for (const Scene::Box& box : scene_.boxes_) hit_box(origin, direction, box, hit);
    const Vector3d inverse = direction.cwiseInverse();
    for (const Scene::Cluster& cluster : scene_.clusters_) {
      if (!meets(cluster.bounds, origin, inverse, hit.distance)) continue;
      for (const Scene::Group& group : cluster.groups)
        if (meets(group.bounds, origin, inverse, hit.distance)) hit_group(origin, direction, group, hit);
    }
  }

  Colour wall(const Vector3d& p, double step) const {
    const double x = (p.x() - kPaintingX) / kPaintingWidth, y = (p.y() - kPaintingY) / kPaintingHeight;
    if (x > 0 && x < 1 && y > 0 && y < 1) return painting(x, y, step / kPaintingWidth);
    if (p.x() > kPaintingX - kFrame && p.x() < kPaintingX + kPaintingWidth + kFrame &&
        p.y() > kPaintingY - kFrame && p.y() < kPaintingY + kPaintingHeight + kFrame)
      return {0.05F, 0.035F, 0.025F};
    return p.x() < -0.55 ? plaster(p.x(), p.y(), step) : bricks(p.x(), p.y(), step);
  }

  Colour texture(const Hit& hit, double step) const {
    const Vector3d& p = hit.point;
    switch (hit.object) {
      case kFloor:
        return planks(p.x(), p.z(), step);
      case kWall:
        return wall(p, step);
      case kCrate: {
        const Scene::Box* box = &scene_.boxes_.front();
        for (const Scene::Box& other : scene_.boxes_)
          if ((p - other.centre).squaredNorm() < (p - box->centre).squaredNorm()) box = &other;
        const Vector3d local = box->box_from_rig * (p - box->centre) * (0.23 / box->half.x());
        const Vector3d n = (box->box_from_rig * hit.normal).cwiseAbs();
        const double a = n.x() > 0.5 ? local.z() : local.x(), b = n.y() > 0.5 ? local.z() : local.y();
        return crate(a, b, local, step);
      }
      case kMarble:
        return marble(p, step);
      case kPillar:
        return fabric(p.y(), 0.13 * std::atan2(hit.normal.z(), hit.normal.x()), step);
      case kBall:
        return striped_ball(hit.normal, step / Scene::kBallRadius_m);
      case kGlossy:
        return {0.52F, 0.03F, 0.03F};
      case kMirror:
        return {0.04F, 0.04F, 0.045F};
      case kPot:
        return {0.45F, 0.20F, 0.11F};
      case kStalk:
        return {0.16F, 0.28F, 0.07F};
      case kLeaf:
        return Colour(0.10F, 0.33F, 0.07F) + Colour(0.12F, 0.10F, 0.0F) * static_cast<float>(hit.normal.x());
      case kPost:
        return {0.20F, 0.13F, 0.08F};
      case kWire:
        return {0.42F, 0.44F, 0.46F};
      case kCable:
        return {0.03F, 0.03F, 0.03F};
      default:
        return {0.70F, 0.69F, 0.66F};
    }
  }

  static float gloss_of(int object) {
    switch (object) {
      case kGlossy:
        return 0.06F;
      case kMirror:
        return 0.75F;
      case kMarble:
      case kPot:
      case kBall:
        return 0.03F;
      default:
        return 0;
    }
  }

  /// The lamp's light, if nothing stands between, and what comes from everywhere.
  Colour incoming(const Hit& hit) const {
    const auto up = static_cast<float>(-hit.normal.y());
    Colour sum = Colour(0.30F, 0.31F, 0.34F) * (0.8F + 0.2F * up);
    const Vector3d to_lamp = kLamp - hit.point;
    const double distance = to_lamp.norm(), cosine = hit.normal.dot(to_lamp) / distance;
    if (cosine > 0 && lamp_visible(hit, to_lamp / distance, distance))
      sum += Colour(1.0F, 0.93F, 0.82F) * static_cast<float>(cosine * 9.5 / (3 + distance * distance));
    return sum;
  }

  bool lamp_visible(const Hit& hit, const Vector3d& direction, double distance) const {
    Hit blocker;
    blocker.distance = distance;
    hit_solids(hit.point + 1e-4 * hit.normal, direction, blocker);
    return blocker.object < 0 || blocker.object == kGlobe;
  }

  /// The mirror image (one bounce; Schlick's Fresnel term) and the lamp's highlight (Phong's lobe).
  Colour reflected(const Hit& hit, const Vector3d& direction, double step, int bounces, float gloss) const {
    const double cosine = std::max(0.0, -direction.dot(hit.normal));
    const float fresnel = gloss + (1 - gloss) * static_cast<float>(std::pow(1 - cosine, 5));
    const Vector3d mirrored = direction - 2 * direction.dot(hit.normal) * hit.normal;
    Colour sum = Colour::Zero();
    if (bounces > 0) {
      const Vector3d origin = hit.point + 1e-4 * hit.normal;
      // Convex mirrors spread rays.
      sum = fresnel * light(nearest(origin, mirrored), mirrored, 6 * step, bounces - 1);
    }
    const Vector3d to_lamp = (kLamp - hit.point).normalized();
    const double lobe = std::max(0.0, mirrored.dot(to_lamp));
    return sum + Colour::Constant(static_cast<float>(1.2 * std::pow(lobe, 120)) * (0.3F + gloss));
  }

  const Scene& scene_;
  Vector3d ball_;
};

void Scene::Group::add(const Capsule& capsule) {
  const Vector3d around = Vector3d::Constant(capsule.radius);
  for (const Vector3d& end : {capsule.a, Vector3d(capsule.a + capsule.axis)})
    bounds.extend(end - around).extend(end + around);
  capsules.push_back(capsule);
}

void Scene::Group::add(const Ellipsoid& ellipsoid) {
  // The farthest point along an axis e lies at |A^-T e|, where A maps to the unit sphere.
  const Matrix3d to_rig = ellipsoid.to_unit.inverse();
  const Vector3d around = to_rig.rowwise().norm();
  bounds.extend(ellipsoid.centre - around).extend(ellipsoid.centre + around);
  ellipsoids.push_back(ellipsoid);
}

void Scene::Cluster::add(const Group& group) {
  bounds.extend(group.bounds);
  groups.push_back(group);
}

void Scene::add_fence() {
  Cluster fence;
  constexpr double left = 0.30, right = 0.94, top = -0.02, z = 1.25;
  const auto bar = [&](const Vector3d& a, const Vector3d& b, double radius, int object) {
    Group group;
    group.add(Capsule{a, b - a, radius, object});
    fence.add(group);
  };
  for (const double x : {left, right}) bar({x, top - 0.06, z}, {x, kFloorY, z}, 0.014, kPost);
  constexpr int uprights = 12;
  for (int i = 1; i < uprights; ++i) {
    const double x = left + (right - left) * i / uprights;
    bar({x, top, z}, {x, kFloorY - 0.05, z}, 0.0022, kWire);
  }
  for (int i = 0; i < 5; ++i) bar({left, top + 0.13 * i, z}, {right, top + 0.13 * i, z}, 0.0022, kWire);
  clusters_.push_back(std::move(fence));
}

void Scene::add_stalk(Cluster& plant, int number, const Vector3d& foot) {
  const auto draw = [&](int key) {
    return 2 * uniform(hash({0x97A47, static_cast<std::uint64_t>(number), static_cast<std::uint64_t>(key)})) -
           1;
  };
  const double azimuth = 2.4 * number + 0.3 * draw(0), lean = 0.10 + 0.09 * (1 + draw(1));
  const double height = 0.42 + 0.12 * draw(2);
  const Vector3d side(std::cos(azimuth), 0, std::sin(azimuth));
  const auto at = [&](double u) { return Vector3d(foot + side * lean * u * u - Vector3d(0, height * u, 0)); };
  Group stalk;
  constexpr int pieces = 4;
  for (int i = 0; i < pieces; ++i) {
    const Vector3d a = at(1.0 * i / pieces), b = at((i + 1.0) / pieces);
    stalk.add(Capsule{a, b - a, 0.0035, kStalk});
  }
  plant.add(stalk);
  for (int leaf = 0; leaf < 3; ++leaf) {
    const double u = 0.45 + 0.27 * leaf, turn = azimuth + 2.1 * leaf + draw(5 + leaf);
    const Vector3d out = Vector3d(std::cos(turn), 0.25 - 0.5 * u, std::sin(turn)).normalized();
    const Vector3d flat = Vector3d(0.3 * draw(9 + leaf), -1, 0.3).cross(out).normalized();
    Matrix3d axes;  // rows: along the leaf, across it, through it
    axes << out.transpose(), flat.transpose(), out.cross(flat).transpose();
    const Vector3d size(0.062, 0.021, 0.003);
    Group group;
    group.add(Ellipsoid{at(u) + 0.058 * out, size.cwiseInverse().asDiagonal() * axes, kLeaf});
    plant.add(group);
  }
}

void Scene::add_plant() {
  const Vector3d foot(-0.52, 0.36, 1.45);
  spheres_.push_back({foot + Vector3d(0, 0.09, 0), 0.115, kPot});
  Cluster plant;
  for (int stalk = 0; stalk < 9; ++stalk) add_stalk(plant, stalk, foot);
  clusters_.push_back(std::move(plant));
}

void Scene::add_single(const Capsule& capsule) {
  Group group;
  group.add(capsule);
  clusters_.emplace_back().add(group);
}

void Scene::add_lamp() {
  const Vector3d globe(-0.32, -0.52, 2.3);
  add_single(Capsule{globe, {0, kCeilingY - globe.y(), 0}, 0.004, kCable});
  spheres_.push_back({globe, 0.085, kGlobe});
}

Vector3d Scene::ball_centre(std::int64_t time_ns) const {
  return kBallStart + Vector3d(options_.ball_speed_m_per_s * 1e-9 * static_cast<double>(time_ns), 0, 0);
}

std::string problem_of(const SceneOptions& options) {
  if (!(options.wall_m >= 0.1 && std::isfinite(options.wall_m)))
    return fmt::format("wall_m is {}, but must be at least 0.1", options.wall_m);
  if (options.kind == SceneOptions::Kind::room && options.wall_m < 3)
    return fmt::format("wall_m is {}, but a room needs at least 3", options.wall_m);
  if (!std::isfinite(options.ball_speed_m_per_s)) return "ball_speed_m_per_s must be finite";
  return "";
}

Scene::Scene(const SceneOptions& options) : options_(options) {
  const auto turned = [](double angle) {
    return Matrix3d(Eigen::AngleAxisd(angle, Vector3d::UnitY()).toRotationMatrix());
  };
  boxes_.push_back({{0.92, kFloorY - 0.23, 2.55}, Vector3d::Constant(0.23), turned(0.5), kCrate});
  boxes_.push_back({{0.38, kFloorY - 0.15, 2.95}, Vector3d::Constant(0.15), turned(-0.3), kCrate});
  spheres_.push_back({{0.92, kFloorY - 0.46 - 0.14, 2.55}, 0.14, kMarble});
  spheres_.push_back({{-0.10, kFloorY - 0.19, 1.85}, 0.19, kGlossy});
  spheres_.push_back({{0.26, kFloorY - 0.10, 1.62}, 0.10, kMirror});
  add_single(Capsule{{-1.05, -2.2, 2.7}, {0, 3.2, 0}, 0.13, kPillar});
  add_fence();
  add_plant();
  add_lamp();
}

Shade Scene::trace(const Ray& ray, std::int64_t time_ns) const {
  const Tracer tracer(*this, time_ns);
  const Hit hit = tracer.nearest(ray.origin, ray.direction);
  if (hit.object < 0) return {surroundings(ray.direction), std::numeric_limits<double>::infinity(), -1};
  // Seen at a slant, samples lie farther apart; half of that keeps the other direction sharp.
  const double slant = std::max(0.15, std::abs(hit.normal.dot(ray.direction)));
  const double step = ray.footprint_rad * hit.distance / std::sqrt(slant);
  return {tracer.light(hit, ray.direction, step, 1), hit.distance, hit.object};
}

}  // namespace stuv::synthetic
