#include <limits>
#include <numbers>

#include "calib/tracking/keyframes.h"
#include "calib/tracking/moving_rig.h"
#include "calib/tracking/particle_filter.h"
#include "calib/tracking/report.h"
#include "calib/tracking/sequence.h"
#include "calib/tracking/surface_view.h"
#include "calib/tracking/texture.h"
#include "calib/tracking/tracker.h"
#include "core/error.h"
#include "tests/support/support.h"
#include "tests/support/tracking_scenes.h"

using namespace stuv;
using namespace stuv::tracking;
using namespace stuv::test;

namespace {

constexpr double kInf = std::numeric_limits<double>::infinity();

Twist twist_of(const Eigen::Vector3d& v, const Eigen::Vector3d& w) {
  Twist t;
  t << v, w;
  return t;
}

double angle_between(const Pose& a, const Pose& b) { return tracking::log(a * b.inverse()).tail<3>().norm(); }

/// The power series of exp, as a reference.
Eigen::Matrix4d series_exp(const Twist& twist) {
  Eigen::Matrix4d A = Eigen::Matrix4d::Zero();
  A.topLeftCorner<3, 3>() = cross_matrix(twist.tail<3>());
  A.topRightCorner<3, 1>() = twist.head<3>();
  Eigen::Matrix4d sum = Eigen::Matrix4d::Identity(), term = sum;
  for (int k = 1; k < 60; ++k) {
    term = term * A / k;
    sum += term;
  }
  return sum;
}

struct Bench {
  TempFolder folder;
  Camera camera = plain_camera(320, 240, 350);
  Scene scene;
  std::vector<Keyframe> keyframes;

  explicit Bench(const std::string& obj = box_obj(0.12, 0.09, 0.07), double scale = 1) {
    scene.model = model_of(obj, folder / "model.obj");
    scene.texture = 0.45;
    scene.cell = 0.014 * scale;
    scene.reach = 0.12 * scale;
    scene.floor_z = 0.036 * scale;
    for (const double turn : {0.1, 0.5}) {
      const Pose pose = view_of(0.45 * scale, turn, 0.4);
      keyframes.push_back(teach_keyframe("k", photograph(scene, camera, {pose}), scene.model, camera, pose));
    }
  }
  Grey look(const Pose& pose, const Disc& disc = {}, int seed = 1) const {
    return photograph(scene, camera, {pose}, disc, 4, seed);
  }
  Tracker tracker(const TrackerOptions& options = {}) const {
    return {scene.model, camera, keyframes, options};
  }
};

SurfaceView taught_surface(const Bench& bench, const Keyframe& k, const tracking::Lens& lens) {
  const ImageF rays = rays_of(bench.camera);
  const TexturedView view{k.picture, k.cam_from_object,
                          render_depth(bench.scene.model, lens, rays, k.cam_from_object, 1e-3)};
  return surface_view(view, bench.scene.model, rays, 1200);
}

/// Visible parts longer than the slack.
int long_parts(const ObjectModel& model, const Pose& pose) {
  int parts = 0;
  for (const VisibleSegment& s : visible_edges(model, pose, 1e-3)) parts += s.t1 - s.t0 > 0.01 ? 1 : 0;
  return parts;
}

Pose path(double i, double scale = 1) {
  return view_of(0.45 * scale, 0.15 + 0.02 * i, 0.4 + 0.005 * i, 0, 0.002 * i * scale, 0);
}

}  // namespace

TEST_CASE("tracking: the brightness of a taught view tells how alike a pose looks, and leads to it") {
  const Bench bench;
  const tracking::Lens lens(bench.camera);
  const Keyframe& k = bench.keyframes[0];
  const SurfaceView surface = taught_surface(bench, k, lens);
  CHECK(surface.points.size() > 300);
  CHECK(surface.points.size() <= 1200);
  CHECK(surface.faces >= 2);
  // Another pose, darker and with less contrast: the exposure has changed.
  const Pose truth = k.cam_from_object * tracking::exp(twist_of({0.004, -0.003, 0.01}, {0.05, 0.1, -0.04}));
  Grey frame = bench.look(truth, {}, 5);
  for (auto& value : frame.data) value = static_cast<std::uint8_t>(0.7 * value + 15);
  const SmoothPyramid pyramid = smooth_pyramid(frame);
  const auto at = [&](const Pose& pose) { return likeness(surface, pyramid, 0, lens, pose, 1200); };
  const double px = truth.t.z() / bench.camera.intrinsics[0];
  const Pose start = truth * tracking::exp(twist_of({7 * px, -5 * px, 0.004}, {0.03, -0.02, 0.03}));
  CHECK(at(truth).fit > 0.9);
  CHECK(at(truth).print > 0.9);
  CHECK(at(start).fit < at(truth).fit - 0.2);
  const SurfaceView* const views[] = {&surface};
  const Twist spread = twist_of(Eigen::Vector3d::Constant(30 * px), Eigen::Vector3d::Constant(0.3));
  const Alignment found = align(views, pyramid, 2, lens, start, spread);
  REQUIRE(found.converged);
  const Twist error = tracking::log(found.cam_from_object.inverse() * truth);
  INFO(error.transpose());
  CHECK((found.cam_from_object.t - truth.t).head<2>().norm() < 0.5 * px);
  CHECK(angle_between(found.cam_from_object, truth) < 0.01);
  CHECK(error.dot(found.information * error) < 6 * 9);  // three sigma in each of six directions

  // Nothing to see, or nothing in the picture: no likeness, and no pose out of nothing.
  Grey flat = frame;
  std::fill(flat.data.begin(), flat.data.end(), std::uint8_t{90});
  const SmoothPyramid nothing = smooth_pyramid(flat);
  const Likeness of_nothing = likeness(surface, nothing, 0, lens, truth, 1200);
  CHECK(of_nothing.fit < at(truth).fit - 0.2);
  CHECK_FALSE(of_nothing.whole > 0.3);
  CHECK_FALSE(of_nothing.print > 0.3);
  const Alignment stays = align(views, nothing, 2, lens, start, spread);
  CHECK((stays.cam_from_object.t - start.t).norm() < 30 * px);
  Pose aside = truth;
  aside.t.x() += 10;
  CHECK(std::isnan(at(aside).fit));
  CHECK_FALSE(align(views, pyramid, 2, lens, aside, spread).converged);
}

TEST_CASE("tracking: the outline of a box is where a face seen meets one not seen, and nothing else") {
  const Bench bench;
  const tracking::Lens lens(bench.camera);
  const std::vector<OutlineEdge> edges = outline_edges(bench.scene.model);
  CHECK(edges.size() == 12);
  for (const double turn : {0.0, 0.3, -0.4}) {
    const Pose pose = view_of(0.45, turn, 0.4);
    const Outline outline(edges, lens, pose);
    // Against the plain definition: the rim of what the pixels' rays hit.
    const DepthPatch patch = render_depth(bench.scene.model, lens, rays_of(bench.camera), pose, 1e-3);
    for (int y = 2; y + 2 < patch.depth.height; y += 3)
      for (int x = 2; x + 2 < patch.depth.width; x += 3) {
        int hit = 0;
        for (int dy = -2; dy <= 2; ++dy)
          for (int dx = -2; dx <= 2; ++dx) hit += std::isfinite(patch.depth.at(x + dx, y + dy)) ? 1 : 0;
        const Eigen::Vector2d q(x + patch.x0, y + patch.y0);
        if (hit > 0 && hit < 25) CHECK(outline.is_near(q, 4));
        if (hit == 25) CHECK_FALSE(outline.is_near(q, 1));
      }
  }
}

TEST_CASE("tracking: a side that turns away does not lend the background's brightness to the object") {
  Bench bench;
  bench.scene.cluttered = true;
  const tracking::Lens lens(bench.camera);
  const SurfaceView surface = taught_surface(bench, bench.keyframes[0], lens);
  // Ever less of the box's sides is seen, until only its front is.
  for (const double turn : {0.3, 0.2, 0.1, 0.0}) {
    const Pose pose = view_of(0.45, turn, turn);
    const Likeness found = likeness(surface, smooth_pyramid(bench.look(pose)), 0, lens, pose, 1200);
    INFO("turned by " << turn);
    CHECK(found.print > 0.97);
  }
}

TEST_CASE(
    "tracking: the untaught sides of a plain object are to be plain, so the background is none of them") {
  Bench bench;
  bench.scene.texture = 0;
  bench.scene.cluttered = true;
  const tracking::Lens lens(bench.camera);
  const ImageF rays = rays_of(bench.camera);
  const Pose taught = view_of(0.45, 0, 0);
  const TexturedView view{bench.look(taught), taught,
                          render_depth(bench.scene.model, lens, rays, taught, 1e-3)};
  SurfaceView surface = surface_view(view, bench.scene.model, rays, 1200);
  REQUIRE(surface.faces == 1);
  CHECK(is_plain(surface));
  // Turned about an edge of the front: this stays where the front is, and a side would show beside it, where
  // the background is.
  const Pose turn = tracking::exp(twist_of({0, 0, 0}, {0, -0.35, 0}));
  const Eigen::Vector3d edge(-0.06, 0, -0.035);
  const Pose wrong = taught * Pose{turn.R, edge - turn.R * edge};
  const SmoothPyramid picture = smooth_pyramid(bench.look(taught));
  const double before = likeness(surface, picture, 0, lens, wrong, 1200).fit;
  add_unseen_faces(bench.scene.model, surface);
  CHECK(surface.unseen_faces == 5);
  CHECK(likeness(surface, picture, 0, lens, wrong, 1200).fit < before - 0.1);
  CHECK(likeness(surface, picture, 0, lens, taught, 1200).fit > 0.9);
  // Where the side is really seen it is like any plain side.
  CHECK(likeness(surface, smooth_pyramid(bench.look(wrong)), 0, lens, wrong, 1200).fit > 0.9);
  CHECK_FALSE(is_plain(
      surface_view({bench.keyframes[0].picture, bench.keyframes[0].cam_from_object,
                    render_depth(bench.scene.model, lens, rays, bench.keyframes[0].cam_from_object, 1e-3)},
                   bench.scene.model, rays, 1200)));
}

TEST_CASE("tracking: exp and log are inverse, also near 0 and near pi, and match the power series") {
  for (const double angle :
       {0.0, 1e-12, 1e-8, 1e-5, 9.99e-4, 1.001e-3, 0.1, 1.0, 3.0, 3.1415, std::numbers::pi - 1e-9}) {
    for (const Eigen::Vector3d& axis :
         {Eigen::Vector3d(1, 0, 0), Eigen::Vector3d(0, -1, 0), Eigen::Vector3d(1, 2, -3)}) {
      const Twist t = twist_of({0.3, -2, 1}, angle * axis.normalized());
      const Pose pose = tracking::exp(t);
      const Eigen::Matrix4d reference = series_exp(t);
      CHECK((pose.R - reference.topLeftCorner<3, 3>()).norm() < 1e-12);
      CHECK((pose.t - reference.topRightCorner<3, 1>()).norm() < 1e-11);
      CHECK((tracking::log(pose) - t).norm() < 1e-7 * (1 + angle));
    }
  }
}

TEST_CASE("tracking: log at exactly pi gives a rotation by pi") {
  const Pose half{Eigen::Vector3d(1, -1, -1).asDiagonal(), {1, 2, 3}};
  const Pose again = tracking::exp(tracking::log(half));
  CHECK((again.R - half.R).norm() < 1e-9);
  CHECK((again.t - half.t).norm() < 1e-9);
}

TEST_CASE("tracking: the mean of rotations spread evenly about one is that one") {
  const Pose middle = tracking::exp(twist_of({1, 2, 3}, {0.4, -1, 2}));
  std::vector<Pose> poses;
  for (const double angle : {-0.5, 0.5})
    for (int k = 0; k < 3; ++k)
      poses.push_back(middle * tracking::exp(twist_of({0, 0, 0}, angle * Eigen::Vector3d::Unit(k))));
  const Pose m = tracking::mean(poses, std::vector<double>(poses.size(), 1.0));
  CHECK((m.R - middle.R).norm() < 1e-12);
  CHECK(m.R.determinant() == Approx(1));
  CHECK(tracking::mean({}, {}).R.isIdentity());
  CHECK(tracking::mean(poses, std::vector<double>(poses.size(), 0.0)).t.isZero());
}

TEST_CASE("tracking: weights that all underflow keep their ratios; no weight at all is evenness") {
  std::vector<Particle> particles(3);
  particles[0].log_weight = -100000;
  particles[1].log_weight = -100000 - std::log(3.0);
  particles[2].log_weight = -kInf;
  const std::vector<double> w = normalised_weights(particles);
  CHECK(w[0] == Approx(0.75));
  CHECK(w[1] == Approx(0.25));
  CHECK(w[2] == 0);
  CHECK(effective_number(w) == Approx(1 / (0.75 * 0.75 + 0.25 * 0.25)));
  for (Particle& p : particles) p.log_weight = std::numeric_limits<double>::quiet_NaN();
  for (const double v : normalised_weights(particles)) CHECK(v == Approx(1.0 / 3));
  CHECK(normalised_weights({}).empty());
}

TEST_CASE("tracking: systematic resampling draws each particle its share, never one of weight 0") {
  std::vector<Particle> particles(4);
  for (int i = 0; i < 4; ++i) particles[i].pose.t.x() = i;
  const std::vector<double> weights = {0, 0.5, 0.3, 0.2};
  for (const double offset : {0.0, 0.3, 0.999}) {
    std::vector<int> drawn(4, 0);
    for (const Particle& p : resample(particles, weights, 1000, offset))
      ++drawn[static_cast<int>(p.pose.t.x())];
    CHECK(drawn[0] == 0);
    CHECK(std::abs(drawn[1] - 500) <= 1);
    CHECK(std::abs(drawn[2] - 300) <= 1);
    CHECK(std::abs(drawn[3] - 200) <= 1);
  }
  CHECK(resample({}, {}, 5, 0.5).empty());
}

TEST_CASE("tracking: a particle without noise moves by its velocity; the velocity follows equation 4") {
  const Twist step = twist_of({0.1, 0, 0}, {0, 0.2, 0});
  const Pose first = tracking::exp(twist_of({0, 1, 5}, {0.3, 0, 0})), second = first * tracking::exp(step);
  Particle p;
  p.pose = second;
  p.velocity = velocity(0.5, first, second);
  CHECK((p.velocity - 0.5 * step).norm() < 1e-12);
  CHECK((propagate(p, Twist::Zero()).t - (second * tracking::exp(0.5 * step)).t).norm() < 1e-12);
  CHECK(velocity(0, first, second).isZero());
}

TEST_CASE("tracking: a box shows nine of its twelve edges, a floor behind it what the box leaves") {
  const TempFolder folder;
  const ObjectModel box = model_of(box_obj(1, 1, 1), folder / "box.obj");
  CHECK(box.edges.size() == 12);
  CHECK(long_parts(box, view_of(5, 0.5, 0.5)) == 9);
  CHECK(long_parts(box, view_of(5, 0, 0)) == 4);
  // A line behind the box, seen from straight ahead: the middle is hidden.
  const ObjectModel line = model_of(box_obj(1, 1, 1) + "v -3 0 2\nv 3 0 2\nl 9 10\n", folder / "line.obj");
  double hidden_from = 0, hidden_to = 0;
  int parts = 0;
  for (const VisibleSegment& s : visible_edges(line, view_of(5, 0, 0), 1e-3)) {
    if (line.edges[s.edge].a != 8) continue;
    (parts == 0 ? hidden_from : hidden_to) = parts == 0 ? s.t1 : s.t0;
    ++parts;
  }
  CHECK(parts == 2);
  // The front face, half a side at depth 4.5, casts a shadow of 0.5 / 4.5 * 7 on z = 2.
  CHECK(-3 + 6 * hidden_from == Approx(-0.5 / 4.5 * 7));
  CHECK(-3 + 6 * hidden_to == Approx(0.5 / 4.5 * 7));
}

TEST_CASE("tracking: faces of any shape are cut into triangles of their area; a cylinder shows its outline") {
  const TempFolder folder;
  const ObjectModel arrow =
      model_of("v 0 0 0\nv 2 0 0\nv 2 2 0\nv 1 0.5 0\nv 0 2 0\nf 1 2 3 4 5\n", folder / "a.obj");
  double area = 0;
  for (const auto& [i, j, k] : arrow.triangles)
    area += 0.5 * (arrow.vertices[j] - arrow.vertices[i]).cross(arrow.vertices[k] - arrow.vertices[i]).norm();
  CHECK(area == Approx(2.5));
  const ObjectModel cylinder = model_of(cylinder_obj(1, 2, 48), folder / "c.obj");
  int upright = 0;
  for (const VisibleSegment& s : visible_edges(cylinder, view_of(9, 0.3, 0.4), 1e-3))
    upright +=
        cylinder.vertices[cylinder.edges[s.edge].a].y() != cylinder.vertices[cylinder.edges[s.edge].b].y()
            ? 1
            : 0;
  CHECK(upright == 2);
}

TEST_CASE("tracking: damaged models name file and line") {
  const TempFolder folder;
  for (const char* const text :
       {"v 0 0\n", "v 0 0 nan\n", "v 0 0 inf\n", "v 0 0 0\nf 1 2 3\n", "v 0 0 0\nv 1 0 0\nl 1\n",
        "v 0 0 0\nv 1 0 0\nl 1 x\n", "v 0 0 0\nv 1 0 0\nl 1 -5\n"}) {
    std::ofstream(folder / "bad.obj") << text;
    CHECK_THROWS_WITH(read_obj(folder / "bad.obj"), Catch::Contains("bad.obj:"));
  }
  for (const char* const text : {"", "v 0 0 0\nv 1 1 1\n", "v 1 1 1\nv 1 1 1\nv 1 1 1\nf 1 2 3\n"}) {
    std::ofstream(folder / "bad.obj") << text;
    CHECK_THROWS_WITH(read_obj(folder / "bad.obj"), Catch::Contains("no edge"));
  }
}

TEST_CASE("tracking: edges are found to a tenth of a pixel along the normal, of the right direction only") {
  Grey picture(80, 60, 1);
  for (int y = 0; y < 60; ++y)
    for (int x = 0; x < 80; ++x)
      picture.at(x, y) = x < 40 ? 50 : x == 40 ? 100 : 150;  // half a pixel: edge at 40
  const GradientPicture g = gradient_of(picture, 1, 3);
  const EdgeHypotheses found = search_edges(g, {33.3, 30}, {1, 0}, 12, 0.9);
  REQUIRE(found.count == 1);
  CHECK(found.distance[0] == Approx(6.7).margin(0.1));
  CHECK(found.strength[0] > 0);
  CHECK(search_edges(g, {33.3, 30}, {0, 1}, 12, 0.9).count == 0);
  CHECK(search_edges(g, {10, 30}, {1, 0}, 12, 0.9).count == 0);
  CHECK(search_edges(g, {-500, 1e9}, {1, 0}, 12, 0.9).count == 0);
}

TEST_CASE("tracking: the derivative of refinement agrees with finite differences, through a distorted lens") {
  Camera camera = plain_camera(320, 240, 350);
  camera.lens_model = "LENSMODEL_OPENCV4";
  camera.intrinsics.insert(camera.intrinsics.end(), {-0.1, 0.03, 0.001, -0.002});
  const tracking::Lens lens(camera);
  const Eigen::Vector3d x(0.1, -0.2, 1.3);
  Eigen::Vector2d q, moved;
  Eigen::Matrix<double, 2, 3> J;
  REQUIRE(lens.project(x, q, &J));
  for (int k = 0; k < 3; ++k) {
    REQUIRE(lens.project(x + 1e-6 * Eigen::Vector3d::Unit(k), moved));
    CHECK(((moved - q) / 1e-6 - J.col(k)).norm() < 1e-2);
  }
  CHECK_FALSE(lens.project({0, 0, -1}, q));
  CHECK_FALSE(lens.project({100, 0, 1}, q));
  CHECK_FALSE(lens.project({std::nan(""), 0, 1}, q));
}

TEST_CASE("tracking: keypoint poses come with wrong matches among the right, the same for one seed") {
  const tracking::Lens lens(plain_camera(640, 480, 700));
  const Pose truth = view_of(0.5, 0.4, 0.3);
  std::vector<KeypointMatch> matches;
  for (int i = 0; i < 40; ++i) {
    const Eigen::Vector3d x(0.1 * hashed(i, 1, 0) - 0.05, 0.1 * hashed(i, 2, 0) - 0.05,
                            0.1 * hashed(i, 3, 0) - 0.05);
    Eigen::Vector2d q;
    REQUIRE(lens.project(truth * x, q));
    if (i % 5 == 0) q = {640 * hashed(i, 4, 0), 480 * hashed(i, 5, 0)};
    KeypointMatch m;
    m.point = {x, q, 1};
    matches.push_back(m);
  }
  const std::vector<Hypothesis> drawn = draw_hypotheses(matches, lens, 7),
                                again = draw_hypotheses(matches, lens, 7);
  REQUIRE(drawn.size() > 50);
  const auto best = std::max_element(
      drawn.begin(), drawn.end(), [](const auto& a, const auto& b) { return a.log_weight < b.log_weight; });
  CHECK((best->cam_from_object.t - truth.t).norm() < 0.01);
  CHECK(again.front().cam_from_object.t == drawn.front().cam_from_object.t);
  matches.resize(8);
  CHECK(draw_hypotheses(matches, lens, 7).empty());
  // One point nine times: nothing to draw a pose from, but no failure either.
  CHECK_NOTHROW(draw_hypotheses(std::vector<KeypointMatch>(9, matches[1]), lens, 7));
}

TEST_CASE(
    "tracking: finds a box without a start, follows it to a millimetre, the same for any number of threads") {
  const Bench bench;
  TrackerOptions one;
  one.threads = 1;
  Tracker a = bench.tracker(), b = bench.tracker(one);
  for (int i = 0; i < 6; ++i) {
    const Grey frame = bench.look(path(i), {}, i);
    const TrackedFrame f = a.track(frame), g = b.track(frame);
    INFO("frame " << i << " has pose " << f.has_pose << ", texture " << f.texture_points << ", correlation "
                  << f.correlation << ", matched " << f.edges.matched << " of " << f.edges.visible
                  << ", keypoints " << bench.keyframes[0].points.size());
    CHECK_FALSE(f.lost);
    CHECK((f.cam_from_object.t - path(i).t).norm() < 0.001);
    CHECK(angle_between(f.cam_from_object, path(i)) < 0.01);
    CHECK(f.cam_from_object.t == g.cam_from_object.t);
    CHECK(f.n_eff == g.n_eff);
    CHECK(f.covariance.allFinite());
  }
}

TEST_CASE("tracking: an object of 1 mm and one of 100 m are tracked alike") {
  for (const double scale : {1.0 / 120, 100 / 0.12}) {
    const Bench bench(box_obj(0.12 * scale, 0.09 * scale, 0.07 * scale), scale);
    Tracker tracker = bench.tracker();
    for (int i = 0; i < 3; ++i) {
      const TrackedFrame f = tracker.track(bench.look(path(i, scale), {}, i));
      CHECK_FALSE(f.lost);
      CHECK((f.cam_from_object.t - path(i, scale).t).norm() < 0.002 * scale);
    }
  }
}

TEST_CASE("tracking: a jump, an empty picture, an occlusion are noticed, and the object found again") {
  const Bench bench;
  Tracker tracker = bench.tracker();
  const Grey empty(320, 240, 1, 64);
  const auto good = [&](const TrackedFrame& f, const Pose& truth) {
    return !f.lost && (f.cam_from_object.t - truth.t).norm() < 0.003 &&
           angle_between(f.cam_from_object, truth) < 0.02;
  };
  CHECK(good(tracker.track(bench.look(path(0))), path(0)));
  Pose jumped = path(1);
  jumped.t.x() += 0.05;
  jumped.t.z() += 0.2;
  bool back = false;
  for (int i = 0; i < 4; ++i) back = good(tracker.track(bench.look(jumped, {}, i)), jumped);
  CHECK(back);
  for (int i = 0; i < 3; ++i) CHECK(tracker.track(empty).lost);
  const Disc disc{{160, 120}, 90};
  for (int i = 0; i < 3; ++i) CHECK(tracker.track(bench.look(path(2), disc, i)).lost);
  for (int i = 0; i < 4; ++i) back = good(tracker.track(bench.look(path(3), {}, i)), path(3));
  CHECK(back);
}

TEST_CASE("tracking: one particle and 5000; a wrong size; nothing to start from") {
  const Bench bench;
  for (const int count : {1, 5000}) {
    TrackerOptions options;
    options.particles = count;
    Tracker tracker = bench.tracker(options);
    tracker.start(path(0));
    const TrackedFrame f = tracker.track(bench.look(path(0.3)));
    CHECK(f.particles == count);
    CHECK((f.cam_from_object.t - path(0.3).t).norm() < 0.002);
  }
  Tracker blind(bench.scene.model, bench.camera, {}, {});
  CHECK_FALSE(blind.track(bench.look(path(0))).has_pose);
  CHECK_THROWS_AS(blind.track(Grey(100, 100, 1)), Error);
}

TEST_CASE("tracking: the turn of a plain cylinder about its axis is reported as not known") {
  Bench bench(cylinder_obj(0.04, 0.1, 160));
  bench.scene.texture = 0;
  Tracker tracker(bench.scene.model, bench.camera, {}, {});
  const Pose pose = view_of(0.45, 0.2, 0.4);
  tracker.start(pose);
  const TrackedFrame f = tracker.track(bench.look(pose));
  // The axis is y of the object. What is left of information are the sides of the polygon that it is.
  CHECK(std::sqrt(f.covariance(4, 4)) > 0.3);
  CHECK(f.covariance(4, 4) > 3 * f.covariance(3, 3));
  CHECK(f.covariance(4, 4) > 3 * f.covariance(5, 5));
}

TEST_CASE("tracking: lattices are chosen from sweeps that are even, crowded, or a row") {
  std::vector<Pose> grid, crowded, row, none;
  for (int i = 0; i < 20; ++i)
    grid.push_back(
        {Eigen::Matrix3d::Identity(), {-(i % 5) * 0.03 - 0.002 * hashed(i, 0, 0), -(i / 5) * 0.03, 0}});
  for (int i = 0; i < 200; ++i)
    crowded.push_back(
        {Eigen::Matrix3d::Identity(), {-(i % 50) * 0.003, -(i / 50) * 0.03 - 0.001 * hashed(i, 1, 0), 0}});
  for (int i = 0; i < 7; ++i) row.push_back({Eigen::Matrix3d::Identity(), {-i * 0.05, 0.0005 * i, 0}});
  const LatticeChoice a = choose_lattice(grid), b = choose_lattice(crowded), c = choose_lattice(row);
  CHECK((a.rows == 4 && a.cols == 5 && a.frames.size() == 20));
  CHECK((b.rows == 4 && b.frames.size() > 50));
  CHECK((c.rows == 1 && c.cols == 7));
  CHECK(choose_lattice(none).frames.empty());
}

TEST_CASE("tracking: trajectories survive writing and reading; damaged ones name the line") {
  const TempFolder folder;
  const std::vector<TimedPose> poses = {{1, path(0)}, {2.5, path(3)}};
  std::ofstream(folder / "p.txt") << trajectory_text(poses);
  const std::vector<TimedPose> read = read_trajectory(folder / "p.txt");
  REQUIRE(read.size() == 2);
  CHECK(read[1].time == 2.5);
  CHECK((read[1].cam_from_object.R - path(3).R).norm() < 1e-7);
  for (const char* const text : {"1 0 0 0 0 0 0\n", "1 0 0 0 0 0 0 2\n", "1 0 0 nan 0 0 0 1\n",
                                 "1 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 1\n"}) {
    std::ofstream(folder / "p.txt") << text;
    CHECK_THROWS_WITH(read_trajectory(folder / "p.txt"), Catch::Contains("p.txt:"));
  }
}

TEST_CASE("stuv track: the castle, from taught frames to poses, within the judged bounds") {
  STUV_NEED_SHARED_DATA(data);
  const TempFolder folder;
  const std::string castle = (data / "castle").string();
  const std::string common = "track '" + castle + "/Images/Image_{frame}.png' --model " + castle +
                             "/castle.obj --camera 640x480,700,700,320,240 ";
  const std::string poses = "'" + castle + "/CameraPose/Camera_{frame}.txt'";
  const std::string keys = (folder / "keys").string();
  REQUIRE(run_stuv(common + "--teach " + poses + " --frames 1,14,27 -o " + keys).exit_code == 0);
  const std::string json = (folder / "t.json").string();
  REQUIRE(run_stuv(common + "--keyframes " + keys + " --truth " + poses + " -o " +
                   (folder / "p.txt").string() + " --overlay " + (folder / "ov").string() + " --plots " +
                   (folder / "p.html").string() + " --json " + json)
              .exit_code == 0);
  const Json result = read_json(json);
  CHECK(result["frames_lost"] == 0);
  CHECK(result["error"]["rms_translation_m"].get<double>() < 0.0015);
  CHECK(result["error"]["rms_rotation_rad"].get<double>() < 0.8 * std::numbers::pi / 180);
  CHECK(read_trajectory(folder / "p.txt").size() == 40);
  CHECK(std::filesystem::exists(folder / "ov" / "overlay_0040.png"));
}

TEST_CASE("stuv track: wrong use and bad input end in one line") {
  const TempFolder folder;
  std::ofstream(folder / "m.obj") << box_obj(1, 1, 1);
  const std::string frames =
      "track '" + (folder / "f_{frame}.png").string() + "' --model " + (folder / "m.obj").string();
  const std::string out = " -o " + (folder / "p.txt").string();
  for (const auto& [arguments, code] : std::vector<std::pair<std::string, int>>{
           {frames + " --camera 64x48,50,50,32,24" + out, 2},
           {frames + " --camera 64x48,50,50 --keyframes k" + out, 2},
           {frames + " --camera 64x48,50,50,32,24 --keyframes k" + out, 1},
           {frames + " --camera none.cameramodel --keyframes k" + out, 1}}) {
    const ProgramResult result = run_stuv(arguments);
    CHECK(result.exit_code == code);
    CHECK(line_count(result.err) == 1);
  }
}
