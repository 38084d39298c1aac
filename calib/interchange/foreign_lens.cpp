#include "calib/interchange/foreign_lens.h"

#include <ceres/ceres.h>
#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <functional>

#include "core/error.h"
extern "C" {
#include <mrcal/mrcal.h>
}

namespace stuv {
namespace {

/// Places all over the picture, out to its edges, `columns` of them in a row.
std::vector<Eigen::Vector2d> places(int width, int height, int columns) {
  const int rows = std::max(2, columns * height / width);
  std::vector<Eigen::Vector2d> pixels;
  for (int y = 0; y < rows; ++y)
    for (int x = 0; x < columns; ++x)
      pixels.emplace_back((width - 1.0) * x / (columns - 1), (height - 1.0) * y / (rows - 1));
  return pixels;
}

constexpr int kFitColumns = 31, kTestColumns = 53;  // no place of one is a place of the other but the edges

/// Pixels of a camera with their rays; those that its lens cannot invert are left out.
struct Samples {
  std::vector<Eigen::Vector2d> pixels;
  std::vector<Eigen::Vector3d> rays;
};

Samples samples_of(const Camera& camera, int columns) {
  Samples s;
  const std::vector<Eigen::Vector2d> all = places(camera.width, camera.height, columns);
  const std::vector<Eigen::Vector3d> rays = unproject(camera, all);
  for (std::size_t i = 0; i < all.size(); ++i)
    if (rays[i].allFinite()) s.pixels.push_back(all[i]), s.rays.push_back(rays[i]);
  return s;
}

using Projection = std::function<std::vector<Eigen::Vector2d>(const std::vector<double>& parameters,
                                                              const std::vector<Eigen::Vector3d>& rays)>;

double worst_error(const Projection& project_rays, const std::vector<double>& parameters, const Samples& s) {
  const std::vector<Eigen::Vector2d> pixels = project_rays(parameters, s.rays);
  double worst = 0;
  for (std::size_t i = 0; i < pixels.size(); ++i) {
    const double error = (pixels[i] - s.pixels[i]).norm();
    worst = std::isfinite(error) ? std::max(worst, error) : std::numeric_limits<double>::infinity();
  }
  return worst;
}

struct AllResiduals {
  const Projection* project_rays;
  const Samples* samples;
  std::size_t count;

  bool operator()(double const* const* parameters, double* residuals) const {
    const std::vector<Eigen::Vector2d> pixels =
        (*project_rays)({parameters[0], parameters[0] + count}, samples->rays);
    for (std::size_t i = 0; i < pixels.size(); ++i) {
      const Eigen::Vector2d r = pixels[i] - samples->pixels[i];
      if (!r.allFinite()) return false;
      residuals[2 * i] = r.x();
      residuals[2 * i + 1] = r.y();
    }
    return true;
  }
};

/// Least squares over the samples, from `parameters`.
void fit(const Projection& project_rays, const Samples& s, std::vector<double>& parameters) {
  auto* cost = new ceres::DynamicNumericDiffCostFunction<AllResiduals, ceres::CENTRAL>(
      new AllResiduals{&project_rays, &s, parameters.size()});
  cost->AddParameterBlock(static_cast<int>(parameters.size()));
  cost->SetNumResiduals(2 * static_cast<int>(s.pixels.size()));
  ceres::Problem problem;
  problem.AddResidualBlock(cost, nullptr, parameters.data());
  ceres::Solver::Options options;
  options.linear_solver_type = ceres::DENSE_QR;
  options.max_num_iterations = 200;
  options.function_tolerance = 1e-14;
  options.parameter_tolerance = 1e-12;
  options.logging_type = ceres::SILENT;
  options.num_threads = 1;
  ceres::Solver::Summary summary;
  ceres::Solve(options, &problem, &summary);
}

std::vector<double> core_of(const Camera& camera) {
  return {camera.intrinsics.begin(), camera.intrinsics.begin() + 4};
}

std::size_t parameter_count(const std::string& lens_model) {
  mrcal_lensmodel_t lens;
  mrcal_lensmodel_from_name(&lens, lens_model.c_str());
  return static_cast<std::size_t>(mrcal_lensmodel_num_params(&lens));
}

std::vector<Eigen::Vector2d> project_fisheye(const std::vector<double>& parameters,
                                             const std::vector<Eigen::Vector3d>& rays) {
  std::vector<Eigen::Vector2d> pixels;
  for (const Eigen::Vector3d& ray : rays) pixels.push_back(project(FisheyeLens{parameters}, ray));
  return pixels;
}

/// Name and length of the OpenCV models that are one another's beginnings.
constexpr std::pair<const char*, std::size_t> kNested[] = {{"LENSMODEL_PINHOLE", 4},
                                                           {"LENSMODEL_OPENCV4", 8},
                                                           {"LENSMODEL_OPENCV5", 9},
                                                           {"LENSMODEL_OPENCV8", 12},
                                                           {"LENSMODEL_OPENCV12", 16}};

std::optional<std::size_t> nested_length(const std::string& model) {
  for (const auto& [name, length] : kNested)
    if (model == name) return length;
  return std::nullopt;
}

/// The camera in another of OpenCV's models, if no parameter that is not 0 is lost.
std::optional<Camera> exactly(const Camera& camera, const std::string& model) {
  if (camera.lens_model == model) return camera;
  const auto from = nested_length(camera.lens_model), to = nested_length(model);
  if (!from || !to) return std::nullopt;
  for (std::size_t k = *to; k < *from; ++k)
    if (camera.intrinsics[k] != 0) return std::nullopt;
  Camera result = camera;
  result.lens_model = model;
  result.intrinsics.resize(*to, 0);
  return result;
}

[[noreturn]] void refuse(const Camera& camera, const std::string& format, const std::string& model,
                         double worst_px, double most_px) {
  throw Error(fmt::format("camera {}", camera.name),
              fmt::format("{} has no {}; the nearest {} is off by up to {:.3g} px, more than {:g}", format,
                          camera.lens_model, model, worst_px, most_px),
              "choose another format, or accept the error with --fit-px");
}

}  // namespace

Eigen::Vector2d project(const FisheyeLens& lens, const Eigen::Vector3d& direction) {
  const std::vector<double>& p = lens.parameters;
  const double r = direction.head<2>().norm(), theta = std::atan2(r, direction.z()), t2 = theta * theta;
  const double theta_d = theta * (1 + t2 * (p[4] + t2 * (p[5] + t2 * (p[6] + t2 * p[7]))));
  const double scale = r > 0 ? theta_d / r : 0;
  return {p[0] * scale * direction.x() + p[2], p[1] * scale * direction.y() + p[3]};
}

std::optional<Eigen::Vector3d> unproject(const FisheyeLens& lens, const Eigen::Vector2d& pixel) {
  const std::vector<double>& p = lens.parameters;
  const Eigen::Vector2d m((pixel.x() - p[2]) / p[0], (pixel.y() - p[3]) / p[1]);
  const double theta_d = m.norm();
  if (theta_d == 0) return Eigen::Vector3d(0, 0, 1);
  double theta = std::min(theta_d, 3.0);
  for (int i = 0; i < 50; ++i) {
    const double t2 = theta * theta;
    const double value = theta * (1 + t2 * (p[4] + t2 * (p[5] + t2 * (p[6] + t2 * p[7])))) - theta_d;
    const double slope = 1 + t2 * (3 * p[4] + t2 * (5 * p[5] + t2 * (7 * p[6] + t2 * 9 * p[7])));
    const double step = value / slope;
    theta -= step;
    if (!(std::abs(theta) < M_PI)) return std::nullopt;
    if (std::abs(step) < 1e-15) break;
  }
  const Eigen::Vector3d ray(std::sin(theta) * m.x() / theta_d, std::sin(theta) * m.y() / theta_d,
                            std::cos(theta));
  if (theta < 0 || !((project(lens, ray) - pixel).norm() < 1e-6)) return std::nullopt;
  return ray;
}

Camera fit_model(const Camera& camera, const std::string& lens_model, double& worst_px) {
  Camera result = camera;
  result.lens_model = lens_model;
  result.intrinsics = core_of(camera);
  result.intrinsics.resize(parameter_count(lens_model), 0);
  const Projection project_rays = [&](const std::vector<double>& parameters,
                                      const std::vector<Eigen::Vector3d>& rays) {
    Camera trial = result;
    trial.intrinsics = parameters;
    return project(trial, rays);
  };
  std::vector<double> parameters = result.intrinsics;
  fit(project_rays, samples_of(camera, kFitColumns), parameters);
  worst_px = worst_error(project_rays, parameters, samples_of(camera, kTestColumns));
  result.intrinsics = parameters;
  return result;
}

FisheyeLens fit_fisheye(const Camera& camera, double& worst_px) {
  std::vector<double> parameters = core_of(camera);
  parameters.resize(8, 0);
  fit(project_fisheye, samples_of(camera, kFitColumns), parameters);
  worst_px = worst_error(project_fisheye, parameters, samples_of(camera, kTestColumns));
  return {parameters};
}

double fit_centred_pinhole(const Camera& camera, double& worst_px) {
  const Eigen::Vector2d middle(0.5 * (camera.width - 1), 0.5 * (camera.height - 1));
  const Projection project_rays = [&](const std::vector<double>& f,
                                      const std::vector<Eigen::Vector3d>& rays) {
    std::vector<Eigen::Vector2d> pixels;
    for (const Eigen::Vector3d& ray : rays) pixels.emplace_back(f[0] * ray.hnormalized() + middle);
    return pixels;
  };
  std::vector<double> f = {0.5 * (camera.intrinsics[0] + camera.intrinsics[1])};
  const Samples exact = samples_of(camera, kTestColumns);
  worst_px = worst_error(project_rays, f, exact);
  if (worst_px < 1e-9) return f[0];  // it is one already
  fit(project_rays, samples_of(camera, kFitColumns), f);
  worst_px = worst_error(project_rays, f, exact);
  return f[0];
}

Camera splined_from_fisheye(const FisheyeLens& lens, int width, int height, double& worst_px) {
  const auto sample = [&](int columns) {
    Samples s;
    for (const Eigen::Vector2d& pixel : places(width, height, columns))
      if (const auto ray = unproject(lens, pixel)) s.pixels.push_back(pixel), s.rays.push_back(*ray);
    return s;
  };
  // The knots span the picture and a little more: u = 2 tan(theta / 2) along the direction of (x, y).
  const Samples s = sample(kTestColumns);
  Eigen::Vector2d most = Eigen::Vector2d::Zero();
  for (const Eigen::Vector3d& ray : s.rays)
    most = most.cwiseMax((2 / (1 + ray.z()) * ray.head<2>()).cwiseAbs());
  constexpr int kColumns = 24;
  const double fov_x_deg = std::ceil(1.15 * 4 * std::atan(most.x() / 2) * 180 / M_PI);
  const int rows = std::max(6, static_cast<int>(std::ceil(kColumns * most.y() / most.x())) + 2);
  Camera camera;
  camera.width = width;
  camera.height = height;
  camera.lens_model = fmt::format("LENSMODEL_SPLINED_STEREOGRAPHIC_order=3_Nx={}_Ny={}_fov_x_deg={:.0f}",
                                  kColumns, rows, std::min(fov_x_deg, 340.0));
  camera.intrinsics.assign(lens.parameters.begin(), lens.parameters.begin() + 4);
  const std::size_t count = parameter_count(camera.lens_model), n = s.rays.size();
  camera.intrinsics.resize(count, 0);

  // Pixels are linear in the control points: one step of least squares. Those outside the picture are held at
  // 0 by a ridge that moves no pixel by anything to speak of.
  mrcal_lensmodel_t model;
  mrcal_lensmodel_from_name(&model, camera.lens_model.c_str());
  std::vector<Eigen::Vector2d> pixels(n);
  Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor> J(2 * n, count);
  if (!mrcal_project(reinterpret_cast<mrcal_point2_t*>(pixels.data()), nullptr, J.data(),
                     reinterpret_cast<const mrcal_point3_t*>(s.rays.data()), static_cast<int>(n), &model,
                     camera.intrinsics.data()))
    throw Error(camera.lens_model, "cannot project", "report this");
  Eigen::VectorXd r(2 * n);
  for (std::size_t i = 0; i < n; ++i)
    r.segment<2>(2 * static_cast<Eigen::Index>(i)) = s.pixels[i] - pixels[i];
  const Eigen::MatrixXd control = J.rightCols(static_cast<Eigen::Index>(count) - 4);
  Eigen::MatrixXd N = control.transpose() * control;
  N.diagonal().array() += 1e-10 * N.diagonal().maxCoeff();
  const Eigen::VectorXd d = N.ldlt().solve(control.transpose() * r);
  for (std::size_t k = 4; k < count; ++k) camera.intrinsics[k] = d[static_cast<Eigen::Index>(k) - 4];
  const Projection project_rays = [&](const std::vector<double>&, const std::vector<Eigen::Vector3d>& rays) {
    return project(camera, rays);
  };
  worst_px = worst_error(project_rays, {}, sample(kTestColumns + 18));
  return camera;
}

Camera expressed(const Camera& camera, std::span<const std::string> models, const std::string& format,
                 LensFits& fits) {
  for (const std::string& model : models)
    if (const auto exact = exactly(camera, model)) return *exact;
  double worst_px = 0;
  const Camera fitted = fit_model(camera, models.back(), worst_px);
  if (!(worst_px <= fits.most_px)) refuse(camera, format, models.back(), worst_px, fits.most_px);
  fits.made.push_back({camera.name, camera.lens_model, models.back(), worst_px});
  return fitted;
}

ExpressedLens expressed_or_fisheye(const Camera& camera, std::span<const std::string> models,
                                   const std::string& format, LensFits& fits) {
  for (const std::string& model : models)
    if (const auto exact = exactly(camera, model)) return {*exact, std::nullopt};
  double worst_px = 0, fisheye_px = 0;
  const Camera fitted = fit_model(camera, models.back(), worst_px);
  if (worst_px <= fits.most_px) {
    fits.made.push_back({camera.name, camera.lens_model, models.back(), worst_px});
    return {fitted, std::nullopt};
  }
  const FisheyeLens fisheye = fit_fisheye(camera, fisheye_px);
  if (!(fisheye_px <= fits.most_px)) {
    if (worst_px <= fisheye_px) refuse(camera, format, models.back(), worst_px, fits.most_px);
    refuse(camera, format, "fisheye (equidistant)", fisheye_px, fits.most_px);
  }
  fits.made.push_back({camera.name, camera.lens_model, "fisheye (equidistant)", fisheye_px});
  Camera core = camera;
  std::copy_n(fisheye.parameters.begin(), 4, core.intrinsics.begin());
  return {core, fisheye};
}

Camera camera_of(const FisheyeLens& lens, const std::string& name, int width, int height,
                 const std::string& where, LensFits& fits) {
  double worst_px = 0;
  Camera camera = splined_from_fisheye(lens, width, height, worst_px);
  camera.name = name;
  if (!(worst_px <= fits.most_px))
    throw Error(
        where,
        fmt::format("its fisheye lens is met by mrcal's splined model to {:.3g} px only, more than {:g}",
                    worst_px, fits.most_px),
        "accept the error with --fit-px");
  fits.made.push_back({name, "fisheye (equidistant)", camera.lens_model, worst_px});
  return camera;
}

}  // namespace stuv
