#pragma once

#include <cstdint>
#include <limits>
#include <string>
#include <vector>

#include <Eigen/Dense>

namespace stuv::synthetic {

struct SceneOptions {
  enum class Kind {
    room,  ///< the whole scene
    wall   ///< only its back wall: a plane z = wall_m of the rig's frame, lit evenly
  };
  Kind kind = Kind::room;
  double wall_m = 3.6;            ///< distance of the back wall from the camera plane
  double ball_speed_m_per_s = 1;  ///< of the moving ball, along s
};

/// "" if the options can be used, else the value and the constraint it breaks.
std::string problem_of(const SceneOptions& options);

/// A ray in the rig's frame, and the angle between neighbouring samples [rad], by which textures are
/// band-limited.
struct Ray {
  Eigen::Vector3d origin, direction;  ///< direction of unit length
  double footprint_rad = 0;
};

struct Shade {
  Eigen::Vector3f colour = Eigen::Vector3f::Zero();  ///< linear light, about 0..1
  double distance_m = std::numeric_limits<double>::infinity();
  int object = -1;  ///< what was hit; neighbouring samples of different objects have an edge between them
};

/// A room with things at depths from 1.1 m to the back wall: brick, plaster, planks, a painting, crates,
/// marble; a glossy and a mirroring sphere, whose highlights move with the viewpoint; a plant, a wire fence
/// and a lamp on its cable, a few millimetres thin; a ball that flies along s. One lamp that casts shadows.
class Scene {
 public:
  explicit Scene(const SceneOptions& options = {});

  /// Light along a ray at a moment of the ball's flight.
  Shade trace(const Ray& ray, std::int64_t time_ns) const;

  /// Of the moving ball, in the rig's frame.
  Eigen::Vector3d ball_centre(std::int64_t time_ns) const;
  static constexpr double kBallRadius_m = 0.085;

 private:
  friend class Tracer;
  struct Sphere {
    Eigen::Vector3d centre;
    double radius;
    int object;
  };
  struct Capsule {
    Eigen::Vector3d a, axis;  ///< one end, and the way to the other
    double radius;
    int object;
  };
  /// Flattened sphere: x^T Q x = 1 around the centre.
  struct Ellipsoid {
    Eigen::Vector3d centre;
    Eigen::Matrix3d to_unit;
    int object;
  };
  struct Box {
    Eigen::Vector3d centre, half;
    Eigen::Matrix3d box_from_rig;
    int object;
  };
  /// Thin things stand in groups with a box around each, which most rays miss.
  struct Group {
    std::vector<Capsule> capsules;
    std::vector<Ellipsoid> ellipsoids;
    Eigen::AlignedBox3d bounds;

    void add(const Capsule& capsule);
    void add(const Ellipsoid& ellipsoid);
  };

  /// Groups that stand together: a fence, a plant.
  struct Cluster {
    std::vector<Group> groups;
    Eigen::AlignedBox3d bounds;

    void add(const Group& group);
  };

  static void add_stalk(Cluster& plant, int number, const Eigen::Vector3d& foot);
  void add_fence();
  void add_plant();
  void add_single(const Capsule& capsule);
  void add_lamp();

  SceneOptions options_;
  std::vector<Sphere> spheres_;
  std::vector<Box> boxes_;
  std::vector<Cluster> clusters_;
};

}  // namespace stuv::synthetic
