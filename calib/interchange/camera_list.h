#pragma once

#include <filesystem>
#include <limits>
#include <optional>
#include <string>
#include <vector>

#include "core/rig.h"

namespace stuv {

/// A camera of another tool's file, in the conventions of core/camera.h: pixel (0, 0) is the centre of the
/// top-left pixel; x right, y down, z into the scene; cam_from_rig from that file's frame.
struct ListedCamera {
  Camera camera;
  std::string picture;  ///< name of its picture, where the format has one
  /// Depths between which it sees things, where the format says [m].
  double near_m = std::numeric_limits<double>::quiet_NaN(), far_m = std::numeric_limits<double>::quiet_NaN();
};
using CameraList = std::vector<ListedCamera>;

enum class CameraFormat {
  mrcal,   ///< folder of NAME.cameramodel, or one such file
  opencv,  ///< folder of NAME.yml (.yaml, .xml, .json) of cv::FileStorage, or one such file
  kalibr,  ///< camchain.yaml
  colmap,  ///< folder with cameras.txt, images.txt, and rigs.txt, frames.txt of COLMAP 3.12 where they are
  nerfstudio,  ///< transforms.json
  llff         ///< poses_bounds.npy
};
const char* name_of(CameraFormat format);

/// How near a lens that a format cannot express came to the nearest one that it can.
struct LensFit {
  std::string camera, from, to;
  double worst_px = 0;  ///< over the picture
};

struct LensFits {
  /// A fitted lens that is off by more somewhere in the picture is refused [px].
  double most_px = 0.01;
  std::vector<LensFit> made;  ///< where a fit was needed
};

/// By a file's name and what is in it; nothing if it is none of these formats.
std::optional<CameraFormat> recognise_cameras(const std::filesystem::path& source);

/// Throws Error naming the file (and line, or key) that is wrong, or the lens that cannot be had.
CameraList read_cameras(const std::filesystem::path& source, CameraFormat format, LensFits& fits);

/// Writes into an existing folder: NAME.cameramodel, NAME.yml, camchain.yaml, COLMAP's five text files,
/// transforms.json or poses_bounds.npy; where `target` is no folder and the format is one file, that file.
/// Throws Error naming the camera whose lens the format cannot express to fits.most_px.
void write_cameras(const std::filesystem::path& target, CameraFormat format, const CameraList& cameras,
                   LensFits& fits);
/// "camchain.yaml", "transforms.json", "poses_bounds.npy"; "" of formats with several files.
std::string file_name_of(CameraFormat format);

/// The determined cameras of a rig, pictures named images/NAME.png.
CameraList cameras_of(const Rig& rig);

/// A rig from cameras: plane, lattice, rows and columns from where the cameras stand (fit_layout), so its
/// frame is the plane's and not the file's. Lengths are multiplied by `unit_m`. What no file says is not
/// known: sigmas are NaN, the covariance is empty. Throws Error naming `source` if there is no camera or two
/// of one name.
Rig rig_of(const CameraList& cameras, double unit_m, const std::string& source);

// One pair of functions a format. A `file` is a file of that format, a `folder` holds its files.
CameraList read_opencv(const std::filesystem::path& source);
void write_opencv(const std::filesystem::path& folder, const CameraList& cameras, LensFits& fits);
CameraList read_kalibr(const std::filesystem::path& file, LensFits& fits);
void write_kalibr(const std::filesystem::path& file, const CameraList& cameras, LensFits& fits);
CameraList read_colmap(const std::filesystem::path& folder, LensFits& fits);
void write_colmap(const std::filesystem::path& folder, const CameraList& cameras, LensFits& fits);
CameraList read_nerfstudio(const std::filesystem::path& file, LensFits& fits);
void write_nerfstudio(const std::filesystem::path& file, const CameraList& cameras, LensFits& fits);
CameraList read_llff(const std::filesystem::path& file);
void write_llff(const std::filesystem::path& file, const CameraList& cameras, LensFits& fits);

/// Cameras' names from their pictures' paths: the files' stems; where those are not all different, the names
/// of their folders; or else the whole paths, / as _.
std::vector<std::string> names_from_pictures(const std::vector<std::string>& paths);

/// The rotation nearest to a matrix of few digits. Throws Error (naming `where`) if it is none to 1 %.
Eigen::Matrix3d rotation_near(const Eigen::Matrix3d& matrix, const std::string& where);

}  // namespace stuv
