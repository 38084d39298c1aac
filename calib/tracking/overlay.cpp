#include "calib/tracking/overlay.h"

#include <cmath>
#include <opencv2/imgproc.hpp>

#include "calib/tracking/lens.h"
#include "calib/tracking/visible_edges.h"

namespace stuv::tracking {

Image draw_overlay(const Image& picture, const ObjectModel* model, const Camera& camera, const Pose& pose,
                   bool lost) {
  const ImageF pixels = to_float(picture);
  ImageF rgb(picture.width, picture.height, 3);
  for (std::size_t i = 0; i < rgb.data.size(); ++i)
    rgb.data[i] = pixels.data[pixels.channels == 3 ? i : i / 3];
  Image out = from_float(rgb, PixelType::u8);
  if (model == nullptr) return out;
  cv::Mat canvas(out.height, out.width, CV_8UC3, out.bytes.data());
  const cv::Scalar colour = lost ? cv::Scalar(230, 40, 40) : cv::Scalar(40, 230, 80);
  const Lens lens(camera);
  constexpr int pieces = 16, shift = 4;
  for (const VisibleSegment& s : visible_edges(*model, pose, 2e-3 * model->radius())) {
    const Eigen::Vector3d a = model->vertices[model->edges[s.edge].a],
                          b = model->vertices[model->edges[s.edge].b];
    Eigen::Vector2d last, q;
    bool has_last = false;
    for (int i = 0; i <= pieces; ++i) {
      const double t = s.t0 + (s.t1 - s.t0) * i / pieces;
      const bool seen = lens.project(pose * (a + t * (b - a)), q) && lens.inside(q, -200);
      const auto fixed = [](const Eigen::Vector2d& p) {
        return cv::Point(cvRound(p.x() * (1 << shift)), cvRound(p.y() * (1 << shift)));
      };
      if (seen && has_last) cv::line(canvas, fixed(last), fixed(q), colour, 1, cv::LINE_AA, shift);
      last = q;
      has_last = seen;
    }
  }
  return out;
}

}  // namespace stuv::tracking
