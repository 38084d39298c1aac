#include "calib/rectify/rectify.h"

#include <fmt/format.h>

#include <cmath>

#include "calib/rectify/common_view.h"
#include "calib/rectify/warp.h"
#include "core/error.h"
#include "core/image_io.h"

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

View view_of(const RigCamera& rc, const CommonView& common) {
  const Eigen::Vector3d centre = rc.camera.cam_from_rig.centre();
  return {rc.camera.name,  "views/" + rc.camera.name + ".tif",
          ViewRole::input, rc.row,
          rc.col,          centre.x(),
          centre.y(),      centre.z(),
          common.cx_px,    common.cy_px};
}

}  // namespace

LightField rectify(const Recording& recording, const FrameSet& set, const Rig& rig,
                   const std::filesystem::path& folder, const RectifyOptions& options,
                   const Reporter& reporter) {
  const std::vector<Job> jobs = jobs_of(recording, set, rig, reporter);
  CommonView common;
  try {
    common = common_view(rig);
  } catch (const std::invalid_argument& e) {
    throw Error("rig", e.what(), "calibrate again, or leave that camera out");
  }
  LightField lf;
  for (std::size_t i = 0; i < jobs.size(); ++i) {
    const Image image = read_frame(jobs[i]);
    if (i == 0) {
      lf = empty_light_field(rig, common, image);
      lf.folder = folder;
      set_range(lf, rig, options);
      lf.produced_by = {{"command", "rectify"},
                        {"stuv", STUV_VERSION},
                        {"recording", recording.folder.filename().string()},
                        {"set", set.name}};
    }
    const View view = view_of(*jobs[i].camera, common);
    write_view(lf, view, warp_to_common_view(image, jobs[i].camera->camera, common));
    lf.views.push_back(view);
    reporter.at("rectifying", i + 1, jobs.size());
  }
  write_manifest(lf);
  return lf;
}

}  // namespace stuv
