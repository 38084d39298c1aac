#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <iterator>

#include "calib/solve/report.h"

namespace stuv {
namespace {

std::string escaped(const std::string& text) {
  std::string out;
  for (const char c : text) {
    if (c == '<')
      out += "&lt;";
    else if (c == '&')
      out += "&amp;";
    else
      out += c;
  }
  return out;
}

/// Collects one page's text.
struct Page {
  std::string text;
  template <class... Args>
  void add(fmt::format_string<Args...> format, Args&&... args) {
    fmt::format_to(std::back_inserter(text), format, std::forward<Args>(args)...);
  }
};

std::string good_text(const Calibration& c) {
  const std::string meaning = ghosting_text(c.ghosting);
  if (meaning.empty()) return "Good: this calibration can be used.";
  return "This calibration can be used; pictures: " + meaning + ".";
}

void add_verdict(Page& page, const Calibration& c) {
  page.add("<p class='verdict {}'>{}</p>\n", c.good ? "good" : "bad", c.good ? good_text(c) : "Not good:");
  if (!c.reasons.empty()) page.add("<ul>");
  for (const std::string& reason : c.reasons) page.add("<li>{}</li>", escaped(reason));
  if (!c.reasons.empty()) page.add("</ul>\n");
  for (const std::string& note : c.notes) page.add("<p>Note: {}</p>\n", escaped(note));
  if (!c.advice.empty()) page.add("<p><b>What to record next</b></p><ol>");
  for (const std::string& next : c.advice) page.add("<li>{}</li>", escaped(next));
  if (!c.advice.empty()) page.add("</ol>\n");
  const JointSolution& s = c.solution;
  page.add(
      "<p>rms {:.3f} px over {} corners in {} views of the board; {} outliers ({:.1f} %); worst inlier "
      "{:.2f} px.",
      s.rms_px, s.inliers, c.observations.boards.size(), s.outliers,
      100.0 * s.outliers / std::max(1, s.inliers + s.outliers), s.worst_px);
  if (c.cross_validation_px)
    page.add(" Boards that were left out are predicted to {:.3f} px rms.", *c.cross_validation_px);
  if (c.validation && c.validation->left_out && std::isfinite(c.validation->left_out->predicted_px))
    page.add(" By the stated uncertainty it should be {:.3f} px.", c.validation->left_out->predicted_px);
  page.add(" The board bends by {:.2f} and {:.2f} mm.</p>\n", 1e3 * s.warp_m.x(), 1e3 * s.warp_m.y());
}

/// One sigma over 1/z: line at the worst point of the picture, dashes rms; thin: kFinePx.
void add_ghosting(Page& page, const Calibration& c) {
  const std::string meaning = ghosting_text(c.ghosting);
  if (meaning.empty()) return;
  double top = 2 * kFinePx;
  for (const Ghosting& g : c.ghosting)
    if (std::isfinite(g.worst_px)) top = std::max(top, g.worst_px);
  const double nearest = 1 / c.ghosting.front().depth_m;
  const auto at = [&](const Ghosting& g, double px) {
    return Eigen::Vector2d(560 - 500 / g.depth_m / nearest, 170 - 150 * px / top);
  };
  page.add(
      "<h2>What it means for a picture</h2><p>This calibration is {}. The cameras' pictures of one point "
      "fall this far apart, one sigma, where a picture is focused on it; line: at the worst point of the "
      "picture, "
      "dashes: rms over the picture. Boards were seen from {:.2f} to {:.2f} m.</p>\n"
      "<svg viewBox='0 0 610 200' width='610'>",
      meaning, c.rig.nearest_seen_m, c.rig.farthest_seen_m);
  const double fine = 170 - 150 * kFinePx / top;
  page.add("<path d='M60 {0:.1f}h500' stroke='#bbb'/><text x='30' y='{0:.1f}'>{1} px</text>", fine, kFinePx);
  page.add("<text x='30' y='24'>{:.2f} px</text><path d='M60 20v150h500' stroke='#333' fill='none'/>", top);
  for (const bool worst : {true, false}) {
    page.add("<polyline fill='none' stroke='#c30' {} points='", worst ? "" : "stroke-dasharray='5 4'");
    for (const Ghosting& g : c.ghosting) {
      const Eigen::Vector2d p = at(g, worst ? g.worst_px : g.rms_px);
      if (p.allFinite()) page.add("{:.1f},{:.1f} ", p.x(), p.y());
    }
    page.add("'/>");
  }
  for (std::size_t i = 0; i < c.ghosting.size(); i += i + 3 < c.ghosting.size() ? 2 : 1) {
    const Ghosting& g = c.ghosting[i];
    page.add("<text x='{:.1f}' y='190'>{}</text>", at(g, 0).x(),
             std::isfinite(g.depth_m) ? fmt::format("{:.2f} m", g.depth_m) : "&infin;");
  }
  page.add("</svg>\n");
}

/// Both steps' lengths with one standard deviation, the board's own size aside.
std::string spacing_text(const Calibration& c) {
  const auto step = [](const Eigen::Vector2d& v, double sigma) {
    return v.norm() > 0 ? fmt::format("{:.3f} &plusmn; {:.3f} mm", 1e3 * v.norm(), 1e3 * sigma)
                        : std::string("-");
  };
  return step(c.rig.s_step_m, c.lattice_sigma.s_spacing_m) + " x " +
         step(c.rig.t_step_m, c.lattice_sigma.t_spacing_m);
}

/// The ellipse of one standard deviation of a 2 x 2 covariance, `scale` px a metre, about p.
void add_ellipse(Page& page, const Eigen::Vector2d& p, const Eigen::Matrix2d& covariance, double scale) {
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix2d> eigen(covariance);
  const Eigen::Vector2d radius = scale * eigen.eigenvalues().cwiseMax(0).cwiseSqrt();
  const Eigen::Vector2d axis = eigen.eigenvectors().col(1);
  page.add(
      "<ellipse rx='{:.1f}' ry='{:.1f}' transform='translate({:.1f} {:.1f}) rotate({:.1f})' "
      "fill='#c30' fill-opacity='0.15' stroke='#c30'/>",
      radius[1], radius[0], p.x(), p.y(), std::atan2(axis.y(), axis.x()) * 180 / M_PI);
}

/// Lattice points as crosses, cameras as dots, error ellipses, remainders as lines drawn longer than they
/// are.
void add_layout(Page& page, const Calibration& c) {
  const Rig& rig = c.rig;
  Eigen::AlignedBox2d box;
  double worst = 1e-12;
  for (const RigCamera& rc : rig.cameras) {
    box.extend(Eigen::Vector2d(rig.lattice_origin_m + rc.col * rig.s_step_m + rc.row * rig.t_step_m));
    if (rc.determined) worst = std::max(worst, rc.off_lattice_m.head<2>().norm());
  }
  const double spacing = std::max({1e-6, rig.s_step_m.norm(), rig.t_step_m.norm()});
  const double width = 900, margin = 90;
  const double scale = (width - 2 * margin) / std::max(box.sizes().x(), std::max(spacing, box.sizes().y()));
  // Nothing leaves the drawing: a dot may stand a remainder outside, and its ellipse's radius further.
  const double longest = std::min(0.35 * spacing, (margin - 8) / (2 * scale));
  const double exaggerate = std::max(1.0, std::floor(longest / worst));
  const double height = 2 * margin + scale * box.sizes().y();
  double largest = 0;
  for (const RigCamera& rc : rig.cameras)
    if (rc.determined) largest = std::max(largest, rc.position_sigma_m.head<2>().maxCoeff());
  const bool ellipses = rig.centre_covariance_m2.size() > 0 && largest > 0 && std::isfinite(largest);
  const double swell = ellipses ? longest / largest : 0;
  page.add(
      "<h2>Layout</h2><p>{} x {} lattice, spacing {} (s x t), {:.2f} mm rms off the plane. "
      "Crosses: lattice. Dots: cameras as they look at the scene, remainders drawn {:.0f} times too long; "
      "colour: off the plane, red towards the scene, blue away. Hollow: not determined.",
      rig.rows, rig.cols, spacing_text(c), 1e3 * rig.rms_off_plane_m, exaggerate);
  if (ellipses)
    page.add(
        " Ellipses: one standard deviation of the place, {:.0f} times too large; the largest is {:.3f} mm.",
        swell, 1e3 * largest);
  page.add("</p>\n");
  page.add("<svg viewBox='0 0 {:.0f} {:.0f}' width='{:.0f}'>\n", width, height, width);
  const double off = std::max(1e-12, 2 * rig.rms_off_plane_m);
  Eigen::Index block = 0;
  for (const RigCamera& rc : rig.cameras) {
    const Eigen::Vector2d lattice = rig.lattice_origin_m + rc.col * rig.s_step_m + rc.row * rig.t_step_m;
    const Eigen::Vector2d p = scale * (lattice - box.min()) + Eigen::Vector2d(margin, margin);
    page.add("<path d='M{:.1f} {:.1f}h8m-4 -4v8' stroke='#999' fill='none'/>", p.x() - 4, p.y());
    const Eigen::Vector2d q =
        rc.determined ? Eigen::Vector2d(p + scale * exaggerate * rc.off_lattice_m.head<2>()) : p;
    const double w = std::clamp(rc.off_lattice_m.z() / off, -1.0, 1.0);
    const auto fade = [&](double v) { return static_cast<int>(200 * (1 - std::max(0.0, v))); };
    page.add("<path d='M{:.1f} {:.1f}L{:.1f} {:.1f}' stroke='#333'/>", p.x(), p.y(), q.x(), q.y());
    if (rc.determined && ellipses)
      add_ellipse(page, q, rig.centre_covariance_m2.block<2, 2>(3 * block, 3 * block), scale * swell);
    if (rc.determined) ++block;
    page.add("<circle cx='{:.1f}' cy='{:.1f}' r='5' stroke='#333' fill='{}'/>", q.x(), q.y(),
             rc.determined ? fmt::format("rgb({},{},{})", fade(-w), fade(std::abs(w)), fade(w)) : "none");
    page.add("<text x='{:.1f}' y='{:.1f}'>{}</text>\n", p.x(), p.y() + 28, escaped(rc.camera.name));
  }
  page.add("</svg>\n");
}

/// Histogram of x and y residuals with the Gaussian of the same deviation.
void add_histogram(Page& page, const Calibration& c) {
  constexpr int bins = 61;
  const double range = std::max(1e-9, 5 * c.solution.rms_unweighted_px);
  std::array<double, bins> count = {};
  double total = 0;
  for (const auto& board : c.solution.residuals_px)
    for (const Eigen::Vector2d& r : board)
      for (const double v : {r.x(), r.y()})
        if (std::isfinite(v) && std::abs(v) < range) {
          count[static_cast<std::size_t>((v + range) / (2 * range) * bins)] += 1;
          ++total;
        }
  if (total == 0) return;
  const double bin = 2 * range / bins;
  const double peak_gauss = total * bin / (c.solution.rms_unweighted_px * std::sqrt(2 * M_PI));
  const double top = std::max(peak_gauss, *std::max_element(count.begin(), count.end()));
  page.add(
      "<h2>Residuals</h2><p>Histogram over x and y, -{0:.2f} to {0:.2f} px; line: the Gaussian of their "
      "deviation.</p><svg viewBox='0 0 610 200' width='610'>\n",
      range);
  for (int i = 0; i < bins; ++i)
    page.add("<rect x='{}' y='{:.1f}' width='9' height='{:.1f}' fill='#69a'/>", 10 * i,
             195 - 190 * count[i] / top, 190 * count[i] / top);
  page.add("<polyline fill='none' stroke='#c30' points='");
  for (int i = 0; i < bins; ++i) {
    const double z = (-range + (i + 0.5) * bin) / c.solution.rms_unweighted_px;
    page.add("{:.1f},{:.1f} ", 10 * i + 4.5, 195 - 190 * peak_gauss * std::exp(-0.5 * z * z) / top);
  }
  page.add("'/></svg>\n");
}

/// Mean residual in cells of the picture as arrows; where no cell is drawn, no corner was seen.
void add_field(Page& page, const Calibration& c, int camera) {
  constexpr int nx = 16;
  const Eigen::Vector2d size = c.observations.size_px[camera].cast<double>();
  const int ny = std::max(1, static_cast<int>(std::lround(nx * size.y() / size.x())));
  std::vector<Eigen::Vector3d> cell(static_cast<std::size_t>(nx * ny), Eigen::Vector3d::Zero());
  for (std::size_t i = 0; i < c.observations.boards.size(); ++i) {
    if (c.observations.boards[i].camera != camera) continue;
    for (std::size_t k = 0; k < c.solution.residuals_px[i].size(); ++k) {
      const Eigen::Vector2d& r = c.solution.residuals_px[i][k];
      if (!r.allFinite()) continue;
      const Eigen::Vector2d q = c.observations.boards[i].corners_px[k].cwiseQuotient(size);
      const int x = std::clamp(static_cast<int>(q.x() * nx), 0, nx - 1);
      const int y = std::clamp(static_cast<int>(q.y() * ny), 0, ny - 1);
      cell[static_cast<std::size_t>(y * nx + x)] += Eigen::Vector3d(r.x(), r.y(), 1);
    }
  }
  constexpr double step = 14;
  const double per_px = step / std::max(1e-9, 2 * c.solution.rms_unweighted_px);
  page.add(
      "<svg viewBox='0 0 {0:.0f} {1:.0f}' width='{0:.0f}'><rect width='100%' height='100%' "
      "fill='#f4f4f4'/>",
      nx * step, ny * step);
  for (int y = 0; y < ny; ++y)
    for (int x = 0; x < nx; ++x) {
      const Eigen::Vector3d& s = cell[static_cast<std::size_t>(y * nx + x)];
      if (s.z() == 0) continue;
      const Eigen::Vector2d from((x + 0.5) * step, (y + 0.5) * step);
      Eigen::Vector2d arrow = per_px * s.head<2>() / s.z();
      if (arrow.norm() > step) arrow *= step / arrow.norm();
      page.add("<rect x='{:.0f}' y='{:.0f}' width='{}' height='{}' fill='#cde'/>", x * step, y * step, step,
               step);
      page.add("<path d='M{:.1f} {:.1f}l{:.1f} {:.1f}' stroke='#c30' stroke-width='1.5'/>", from.x(),
               from.y(), arrow.x(), arrow.y());
    }
  page.add("</svg>");
}

/// Green, yellow, red for 0.03, 0.3, 3 px, even in the logarithm.
std::string heat(double px) {
  if (!std::isfinite(px)) return "#888";
  const double w = std::clamp((std::log10(px) + 1.5) / 2, 0.0, 1.0);
  const auto channel = [](double v) { return static_cast<int>(std::lround(255 * std::clamp(v, 0.0, 1.0))); };
  return fmt::format("rgb({},{},60)", channel(2 * w), channel(0.85 * (2 - 2 * w)));
}

void add_map(Page& page, const Calibration& c, int camera) {
  constexpr double width = 224;
  const std::vector<ProjectionMap>& maps = c.cameras[camera].maps;
  if (maps.size() < 2) return;
  const ProjectionMap& map = maps[1];
  const Eigen::Vector2d size = c.observations.size_px[camera].cast<double>();
  const double sx = width / map.nx, sy = width * size.y() / size.x() / map.ny;
  page.add("<svg viewBox='0 0 {0:.0f} {1:.1f}' width='{0:.0f}'>", width, sy * map.ny);
  for (int y = 0; y < map.ny; ++y)
    for (int x = 0; x < map.nx; ++x)
      page.add("<rect x='{:.1f}' y='{:.1f}' width='{:.1f}' height='{:.1f}' fill='{}'/>", x * sx, y * sy,
               sx + 0.3, sy + 0.3, heat(map.sigma_px[static_cast<std::size_t>(y * map.nx + x)]));
  page.add("</svg>");
}

void add_camera(Page& page, const Calibration& c, int camera) {
  const CameraSummary& s = c.cameras[camera];
  page.add("<figure>");
  add_field(page, c, camera);
  page.add("<br>");
  add_map(page, c, camera);
  page.add("<figcaption>{} · {:.3f} px · {:.0f} %", escaped(c.observations.camera_names[camera]), s.rms_px,
           100 * s.coverage);
  if (s.maps.size() > 1) page.add(" · &sigma; {:.2f} to {:.2f} px", s.maps[1].centre_px, s.maps[1].worst_px);
  page.add("</figcaption></figure>\n");
}

void add_cameras(Page& page, const Calibration& c) {
  page.add(
      "<p>By camera, above: mean residual (observed minus predicted) in the cells of its picture, one cell "
      "is "
      "{:.2f} px long; blue: where boards were seen.",
      2 * c.solution.rms_unweighted_px);
  if (c.map_distances_m.size() > 1) {
    page.add(
        " Below: uncertainty of the picture of a point {:.2f} m away, one sigma in the worst direction: ",
        c.map_distances_m[1]);
    for (const double px : {0.03, 0.1, 0.3, 1.0, 3.0})
      page.add("<span class='key' style='white-space:nowrap;background:{}'>{} px</span>", heat(px), px);
  }
  page.add(
      " Caption: rms, part of the picture that corners span, uncertainty in its middle and at its "
      "worst.</p>\n");
  for (std::size_t i = 0; i < c.cameras.size(); ++i)
    if (c.cameras[i].boards > 0) add_camera(page, c, static_cast<int>(i));
}

/// Whether the uncertainty is true: what was kept apart, against what it says.
void add_validation(Page& page, const Calibration& c) {
  if (!c.validation || !c.validation->halves) return;
  const HalfData& h = *c.validation->halves;
  const auto times = [](double ratio) {
    return std::isfinite(ratio) ? fmt::format("{:.2f}", ratio) : std::string("an unknown number of");
  };
  page.add(
      "<h2>Half the data against the other half</h2><p>Lenses differ by {} times, places by {} times "
      "what independent errors of the corners would make of it. Over all solves without some of the sets: "
      "{}; "
      "all uncertainties stated here are {:.2f} times those of independent errors. Lens: rms over the "
      "picture, "
      "but for what another pose could make up for; predicted: by independent "
      "errors.</p><table><tr><th>camera<th>lens "
      "[px]<th>predicted<th>place "
      "[mm]<th>predicted</tr>\n",
      times(h.lens_ratio), times(h.centre_ratio), times(c.validation->sigma.ratio),
      c.validation->sigma.scale);
  for (const HalfData::Camera& camera : h.cameras)
    page.add("<tr><td>{}<td>{:.3f}<td>{:.3f}<td>{:.3f}<td>{:.3f}</tr>\n",
             escaped(c.observations.camera_names[camera.camera]), camera.lens_px, camera.lens_predicted_px,
             1e3 * camera.centre_m, 1e3 * camera.centre_predicted_m);
  page.add("</table>\n");
}

/// What in the residuals is not noise.
void add_structure(Page& page, const Calibration& c) {
  const ResidualStructure& s = c.structure;
  if (s.sets.empty()) return;
  page.add(
      "<h2>What is not noise</h2><table><tr><th>by<th>part that is not noise [px]<th>over what noise "
      "makes</tr>\n");
  const auto row = [&](const char* what, double px, double ratio) {
    page.add("<tr><td>{}<td>{:.3f}<td>{:.2f}</tr>", what, px, ratio);
  };
  row("place in the picture (lens model)", s.position_px, s.position_ratio);
  row("view (frames not taken together)", s.view_px, s.view_ratio);
  row("row within a view (rolling shutter)", s.row_px, s.row_ratio);
  page.add("</table><p>By set, in order of time: rms [px]</p><svg viewBox='0 0 900 110' width='900'>\n");
  double top = 1e-9;
  for (const auto& set : s.sets) top = std::max(top, set.rms_px);
  const double step = std::min(60.0, 880.0 / static_cast<double>(s.sets.size()));
  for (std::size_t i = 0; i < s.sets.size(); ++i) {
    const double h = 80 * s.sets[i].rms_px / top, x = 10 + step * static_cast<double>(i);
    page.add(
        "<rect x='{:.1f}' y='{:.1f}' width='{:.1f}' height='{:.1f}' fill='#69a'><title>{}: {:.3f} "
        "px</title></rect>",
        x, 90 - h, 0.8 * step, h, escaped(c.observations.set_names[s.sets[i].set]), s.sets[i].rms_px);
    if (step >= 30)
      page.add("<text x='{:.1f}' y='104'>{}</text>", x + 0.4 * step,
               escaped(c.observations.set_names[s.sets[i].set]));
  }
  page.add("<text x='30' y='8'>{:.3f}</text></svg>\n", top);
}

void add_table(Page& page, const Calibration& c) {
  page.add(
      "<h2>Cameras</h2><table class='wide'><tr><th>name<th>row<th>col<th>f [px]<th>&sigma;<th>centre "
      "[px]<th>s, t, w [mm]"
      "<th>&sigma; [mm]<th>&sigma; turn [mrad]<th>boards<th>tilt [&deg;]<th>outliers<th>rms [px]<th>noise "
      "[px]</tr>\n");
  for (std::size_t i = 0; i < c.rig.cameras.size(); ++i) {
    const RigCamera& rc = c.rig.cameras[i];
    const CameraSummary& s = c.cameras[i];
    const Eigen::Vector3d p = 1e3 * rc.camera.cam_from_rig.centre(), e = 1e3 * rc.position_sigma_m;
    page.add("<tr{}><td>{}<td>{}<td>{}", rc.determined ? "" : " class='bad'", escaped(rc.camera.name), rc.row,
             rc.col);
    if (!rc.determined) {
      page.add("<td colspan='6' class='why'>not determined: {}", escaped(s.undetermined));
    } else {
      page.add("<td>{:.1f} {:.1f}<td>{:.2f}<td>{:.1f} {:.1f}", rc.camera.intrinsics[0],
               rc.camera.intrinsics[1], s.focal_sigma_px.maxCoeff(), rc.camera.intrinsics[2],
               rc.camera.intrinsics[3]);
      page.add("<td>{:.2f} {:.2f} {:.2f}", p.x(), p.y(), p.z());
      page.add("<td>{}",
               e.allFinite() ? fmt::format("{:.3f} {:.3f} {:.3f}", e.x(), e.y(), e.z()) : "not known");
      const double turn = 1e3 * s.rotation_sigma_rad.maxCoeff();
      page.add("<td>{}", std::isfinite(turn) ? fmt::format("{:.3f}", turn) : "-");
    }
    page.add("<td>{}<td>{:.0f}<td>{}<td>{:.3f}<td>{:.3f}</tr>\n", s.boards, s.seen.tilt_rad * 180 / M_PI,
             s.outliers, s.rms_px, s.noise_px);
  }
  page.add("</table>\n");
}

}  // namespace

std::string report_page(const Calibration& c) {
  Page page;
  page.text =
      "<!doctype html><html lang='en'><meta charset='utf-8'><title>Calibration report</title><style>"
      "body{font:15px sans-serif;margin:2em;max-width:1000px}svg{max-width:100%}text{font-size:11px;"
      "text-anchor:middle}.verdict{font-size:1.4em;padding:.5em}.good{background:#dfd}.bad{background:#fdd}"
      "td,th{padding:2px 8px;text-align:right;border-bottom:1px solid #ddd}table{border-collapse:collapse}"
      "table.wide{font-size:12px;white-space:nowrap}figure{display:inline-block;margin:4px}figcaption{font-"
      "size:12px;text-align:center}"
      ".key{padding:1px "
      "6px;margin-right:2px}td.why{text-align:left;white-space:normal;max-width:430px}</style>"
      "<h1>Calibration report</h1>\n";
  add_verdict(page, c);
  add_ghosting(page, c);
  add_layout(page, c);
  add_histogram(page, c);
  add_structure(page, c);
  add_cameras(page, c);
  add_validation(page, c);
  add_table(page, c);
  return page.text + "</html>\n";
}

}  // namespace stuv
