#include "calib/rectify/rectify.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <mutex>

#include "calib/photometry/view_samples.h"
#include "calib/rectify/board_matches.h"
#include "calib/rectify/warp.h"
#include "core/error.h"
#include "core/image_io.h"
#include "core/parallel.h"

namespace stuv {
namespace {

struct Job {
  const RigCamera* camera;
  const Frame* frame;
};

std::vector<Job> jobs_of(const Recording& recording, const FrameSet& set, const Rig& rig,
                         const Reporter& reporter) {
  std::vector<Job> jobs;
  for (std::size_t i = 0; i < recording.cameras.size(); ++i) {
    const std::string& name = recording.cameras[i].name;
    const int index = rig.camera_index(name);
    if (set.frames[i].status != FrameStatus::ok) continue;
    if (index < 0) {
      reporter.warn(fmt::format("camera {} is not in the rig and is left out", name));
    } else if (!rig.cameras[index].determined) {
      reporter.warn(fmt::format("camera {} is not determined by the calibration and is left out", name));
    } else {
      jobs.push_back({&rig.cameras[index], &set.frames[i]});
    }
  }
  if (jobs.empty())
    throw Error(recording.folder.string(),
                fmt::format("set {} has no picture of a camera of this rig", set.name),
                "check --set and --rig");
  return jobs;
}

Image read_frame(const Job& job) {
  Image image = read_image(job.frame->file);
  const Camera& camera = job.camera->camera;
  if (image.width != camera.width || image.height != camera.height)
    throw Error(job.frame->file.string(),
                fmt::format("is {}x{}, but camera {} was calibrated at {}x{}", image.width, image.height,
                            camera.name, camera.width, camera.height),
                "calibrate at this size");
  return image;
}

void set_range(LightField& lf, const Rig& rig, const RectifyOptions& options) {
  // Boards are held in front of the scene: a little nearer than the nearest of them, nothing is expected.
  constexpr double kNearer = 0.95;
  const double near_m = options.near_m > 0 ? options.near_m : kNearer * rig.nearest_seen_m;
  const double far_m = options.far_m > 0 ? options.far_m : std::numeric_limits<double>::infinity();
  const bool known = near_m > 0;
  lf.d_max = known ? lf.disparity(1 / near_m) : std::nan("");
  lf.d_min = known ? lf.disparity(1 / far_m) : std::nan("");
}

View view_of(const RigCamera& rc, const CommonView& common) {
  const Eigen::Vector3d centre = rc.camera.cam_from_rig.centre();
  return {rc.camera.name,  "views/" + rc.camera.name + ".tif",
          ViewRole::input, rc.row,
          rc.col,          centre.x(),
          centre.y(),      centre.z(),
          common.cx_px,    common.cy_px};
}

LightField empty_light_field(const Rig& rig, const CommonView& common, const Image& first) {
  LightField lf;
  lf.width = common.width;
  lf.height = common.height;
  lf.channels = first.channels;
  lf.type = first.type;
  lf.rows = rig.rows;
  lf.cols = rig.cols;
  lf.metric = true;
  lf.focal_px = common.focal_px;
  lf.cx0_px = common.cx_px;
  lf.cy0_px = common.cy_px;
  return lf;
}

/// What is done to every picture of the set.
class Rectifier {
 public:
  Rectifier(std::vector<Job> jobs, const CommonView& common, const Reporter& reporter)
      : jobs_(std::move(jobs)), common_(common), reporter_(reporter) {}

  const std::vector<Job>& jobs() const { return jobs_; }

  /// Calls f(index, picture, its map) for all jobs, in parallel.
  template <class F>
  void for_each(const char* stage, const F& f) {
    std::size_t done = 0;
    std::mutex mutex;
    parallel_for(static_cast<int>(jobs_.size()), [&](int i) {
      f(i, read_frame(jobs_[i]), LensMap(jobs_[i].camera->camera, common_));
      const std::lock_guard lock(mutex);
      reporter_.at(stage, ++done, jobs_.size());
    });
  }

 private:
  std::vector<Job> jobs_;
  CommonView common_;
  const Reporter& reporter_;
};

/// Of views with those up to `reach` places on.
std::vector<ViewMatch> match_neighbours(const LightField& lf, const std::vector<GreyView>& grey, int reach,
                                        int most_features, const Reporter& reporter) {
  const std::vector<std::pair<int, int>> pairs = neighbours(lf, reach);
  std::vector<std::vector<ViewMatch>> found(pairs.size());
  std::size_t done = 0;
  std::mutex mutex;
  parallel_for(static_cast<int>(pairs.size()), [&](int i) {
    const auto [a, b] = pairs[i];
    found[i] = match_views(lf, a, b, grey[a], grey[b], most_features);
    const std::lock_guard lock(mutex);
    reporter.at("matching neighbours", ++done, pairs.size());
  });
  std::vector<ViewMatch> all;
  for (const auto& list : found) all.insert(all.end(), list.begin(), list.end());
  return all;
}

/// Pixel of the camera's picture that a pixel of its rectified view was made of.
Eigen::Vector2d source_pixel(const Camera& camera, const CommonView& view, const Eigen::Vector2d& q) {
  const Eigen::Vector3d ray((q.x() - view.cx_px) / view.focal_px, (q.y() - view.cy_px) / view.focal_px, 1);
  return project(camera, {(camera.cam_from_rig.R * ray).normalized()})[0];
}

/// Where each view sees which point.
using Sightings = std::vector<std::vector<std::pair<int, Eigen::Vector2d>>>;

Sightings sightings_of(const std::vector<ViewMatch>& matches, std::size_t views) {
  Sightings sightings(views);
  std::map<std::pair<int, int>, int> numbers;
  for (const ViewMatch& m : matches) {
    const auto [it, is_new] = numbers.try_emplace({m.a, m.feature}, static_cast<int>(numbers.size()));
    if (is_new) sightings[m.a].emplace_back(it->second, m.in_a);
    sightings[m.b].emplace_back(it->second, m.in_b);
  }
  return sightings;
}

/// Photometry from what neighbouring views of the set have in common.
Photometry photometry_from_views(Rectifier& rectifier, LightField lf, const CommonView& common,
                                 const Reporter& reporter) {
  // From neighbour to neighbour alone, errors add up along a row of cameras.
  constexpr int kReach = 2, kFeatures = 1000;
  const std::size_t n = rectifier.jobs().size();
  std::vector<GreyView> grey(n);
  rectifier.for_each("comparing brightness", [&](int i, const Image& picture, const LensMap& map) {
    grey[i] = grey_view(warp_to_common_view(picture, map, common));
  });
  std::vector<Camera> cameras;
  for (const Job& job : rectifier.jobs()) {
    lf.views.push_back(view_of(*job.camera, common));
    cameras.push_back(job.camera->camera);
  }
  const Sightings sightings = sightings_of(match_neighbours(lf, grey, kReach, kFeatures, reporter), n);
  grey.clear();
  std::vector<std::vector<PhotometricSample>> found(n);
  rectifier.for_each("comparing brightness", [&](int i, const Image& picture, const LensMap&) {
    const double white = white_level(picture);
    for (const auto& [point, q] : sightings[i]) {
      const Eigen::Vector2d pixel = source_pixel(cameras[i], common, q);
      if (const auto value = stored_around(picture, white, pixel))
        found[i].push_back({i, point, pixel, *value});
    }
  });
  std::vector<PhotometricSample> samples;
  for (const auto& list : found) samples.insert(samples.end(), list.begin(), list.end());
  return estimate_photometry(samples, cameras, lf.channels, "views");
}

double missing_fraction(const Image& image) {
  if (image.mask.empty()) return 0;
  const auto missing = std::count(image.mask.data.begin(), image.mask.data.end(), 0);
  return static_cast<double>(missing) / static_cast<double>(image.mask.data.size());
}

std::optional<Photometry> choose_photometry(Rectifier& rectifier, const LightField& lf,
                                            const CommonView& common, const RectifyOptions& options,
                                            const Reporter& reporter) {
  if (!options.equalise) return std::nullopt;
  const auto& of_rig = options.rig_photometry;
  const bool known = of_rig && std::any_of(of_rig->cameras.begin(), of_rig->cameras.end(),
                                           [](const CameraPhotometry& c) { return c.determined; });
  if (known && of_rig->channels == lf.channels) return of_rig;
  if (known)
    reporter.warn(fmt::format("the rig's photometry is of {} channels, the pictures have {}: compared anew",
                              of_rig->channels, lf.channels));
  return photometry_from_views(rectifier, lf, common, reporter);
}

Alignment alignment_by_features(const LightField& lf, const std::vector<GreyView>& grey,
                                const Reporter& reporter) {
  return alignment_of(lf, match_neighbours(lf, grey, 1, 500, reporter), "features");
}

/// Warps and writes all pictures; views that see nothing are left out of the light field.
void write_views(Rectifier& rectifier, const CommonView& common, Rectified& result,
                 std::vector<GreyView>* grey) {
  LightField& lf = result.light_field;
  const std::size_t n = rectifier.jobs().size();
  std::vector<RectifiedView> views(n);
  std::vector<GreyView> all_grey(n);
  rectifier.for_each("rectifying", [&](int i, const Image& picture, const LensMap& map) {
    const View view = view_of(*rectifier.jobs()[i].camera, common);
    const Image warped = warp_to_common_view(picture, map, common,
                                             result.photometry ? result.photometry->of(view.name) : nullptr);
    views[i] = {view.name, missing_fraction(warped), full_fraction(picture)};
    if (views[i].missing_fraction == 1) return;
    write_view(lf, view, warped);
    if (grey != nullptr) all_grey[i] = grey_view(warped);
  });
  for (std::size_t i = 0; i < n; ++i) {
    if (views[i].missing_fraction == 1) continue;
    lf.views.push_back(view_of(*rectifier.jobs()[i].camera, common));
    result.views.push_back(views[i]);
    if (grey != nullptr) grey->push_back(std::move(all_grey[i]));
  }
}

void report_blind(const Rectifier& rectifier, const Rectified& result, const Reporter& reporter) {
  std::string names;
  for (const Job& job : rectifier.jobs()) {
    const std::string& name = job.camera->camera.name;
    if (result.light_field.view_index(name) >= 0) continue;
    reporter.warn(fmt::format("camera {} sees nothing of the common view and is left out", name));
    names += (names.empty() ? "" : ", ") + name;
  }
  if (result.light_field.views.empty())
    throw Error("rig", fmt::format("cameras {} see nothing of the chosen view", names),
                "use --field all or another crop");
}

Json photometry_json(const Photometry& p) {
  Json cameras = Json::array();
  for (const CameraPhotometry& c : p.cameras)
    if (!c.reasons.empty()) cameras.push_back({{"name", c.camera}, {"reasons", c.reasons}});
  return {{"source", p.source},
          {"points", p.points},
          {"spread_before", p.spread_before},
          {"spread_after", p.spread_after},
          {"notes", p.notes},
          {"not_determined", cameras}};
}

}  // namespace

Json report_of(const Rectified& r) {
  Json views = Json::array();
  for (const RectifiedView& v : r.views)
    views.push_back({{"name", v.name},
                     {"missing_fraction", v.missing_fraction},
                     {"full_fraction", v.full_fraction},
                     {"equalised", r.photometry && r.photometry->of(v.name) != nullptr}});
  return {{"photometry", r.photometry ? photometry_json(*r.photometry) : Json(nullptr)},
          {"vertical_disparity", r.alignment.points > 0 ? to_json(r.alignment) : Json(nullptr)},
          {"views", views}};
}

Rectified rectify(const Recording& recording, const FrameSet& set, const Rig& rig,
                  const std::filesystem::path& folder, const RectifyOptions& options,
                  const Reporter& reporter) {
  const CommonView common = common_view(rig, options.view);
  Rectifier rectifier(jobs_of(recording, set, rig, reporter), common, reporter);
  Rectified result;
  LightField& lf = result.light_field;
  lf = empty_light_field(rig, common, read_frame(rectifier.jobs()[0]));
  lf.folder = folder;
  set_range(lf, rig, options);
  result.photometry = choose_photometry(rectifier, lf, common, options, reporter);
  std::vector<GreyView> grey;
  write_views(rectifier, common, result, options.measure_alignment ? &grey : nullptr);
  report_blind(rectifier, result, reporter);
  if (options.measure_alignment) {
    result.alignment = alignment_of(lf, board_matches(recording, set, rig, common, lf), "board");
    if (result.alignment.points == 0) result.alignment = alignment_by_features(lf, grey, reporter);
  }
  lf.produced_by = {{"command", "rectify"},
                    {"stuv", STUV_VERSION},
                    {"recording", recording.folder.filename().string()},
                    {"set", set.name},
                    {"photometry", result.photometry ? Json(result.photometry->source) : Json(nullptr)}};
  write_manifest(lf);
  write_json(folder / "report.json", report_of(result));
  if (result.photometry && result.photometry->source == "views") write_photometry(folder, *result.photometry);
  return result;
}

}  // namespace stuv
