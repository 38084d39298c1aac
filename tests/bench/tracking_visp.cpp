// ViSP's model-based tracker on ../shared/data/castle, started at the exact pose: what `stuv track` is
// compared with. Built only by tests/bench/run-tracking (Debian's libvisp-mbt-dev); nothing of stuv uses it.
//   tracking_visp DATA/castle edges|both STEP OFFSET_M
#include <visp3/core/vpImage.h>
#include <visp3/io/vpImageIo.h>
#include <visp3/mbt/vpMbGenericTracker.h>

#include <cmath>
#include <cstdio>
#include <fstream>
#include <string>

static vpHomogeneousMatrix read_pose(const std::string& file) {
  std::ifstream in(file);
  vpHomogeneousMatrix m;
  for (unsigned i = 0; i < 16; ++i) in >> m[i / 4][i % 4];
  return m;
}

int main(int, char** argv) {
  const std::string data = argv[1], kind = argv[2];
  const int step = std::atoi(argv[3]);
  vpMbGenericTracker tracker(1, kind == "edges"
                                    ? vpMbGenericTracker::EDGE_TRACKER
                                    : vpMbGenericTracker::EDGE_TRACKER | vpMbGenericTracker::KLT_TRACKER);
  vpMe me;
  me.setMaskSize(5);
  me.setMaskNumber(180);
  me.setRange(10);
  me.setThreshold(5000);
  me.setMu1(0.5);
  me.setMu2(0.5);
  me.setSampleStep(4);
  tracker.setMovingEdge(me);
  if (kind != "edges") {
    vpKltOpencv klt;
    klt.setMaxFeatures(300);
    klt.setWindowSize(5);
    klt.setQuality(0.01);
    klt.setMinDistance(5);
    klt.setHarrisFreeParameter(0.01);
    klt.setBlockSize(3);
    klt.setPyramidLevels(3);
    tracker.setKltOpencv(klt);
    tracker.setKltMaskBorder(5);
  }
  tracker.setCameraParameters(vpCameraParameters(700, 700, 320, 240));
  tracker.setAngleAppear(vpMath::rad(85));
  tracker.setAngleDisappear(vpMath::rad(89));
  tracker.loadModel(data + "/Models/chateau.cao");
  tracker.setDisplayFeatures(false);
  double t2 = 0, r2 = 0;
  int count = 0, lost = 0;
  for (int i = 1; i <= 40; i += step) {
    char name[64];
    std::snprintf(name, sizeof name, "/Images/Image_%04d.png", i);
    vpImage<unsigned char> image;
    vpImageIo::read(image, data + name);
    std::snprintf(name, sizeof name, "/CameraPose/Camera_%03d.txt", i);
    const vpHomogeneousMatrix truth = read_pose(data + name);
    vpHomogeneousMatrix pose;
    try {
      if (i == 1) {
        vpHomogeneousMatrix start = truth;
        start[0][3] += std::atof(argv[4]);
        tracker.initFromPose(image, start);
      }
      tracker.track(image);
      tracker.getPose(pose);
    } catch (const vpException&) {
      std::printf("gives up at frame %d\n", i);
      break;
    }
    const vpHomogeneousMatrix d = pose * truth.inverse();
    const vpThetaUVector turn(d.getRotationMatrix());
    const double dt = (pose.getTranslationVector() - truth.getTranslationVector()).frobeniusNorm();
    const double dr = 180 / M_PI * std::sqrt(turn[0] * turn[0] + turn[1] * turn[1] + turn[2] * turn[2]);
    if (dt > 0.01 || dr > 5)
      ++lost;
    else if (i != 1 && (step > 1 || (i != 14 && i != 27)))
      t2 += dt * dt, r2 += dr * dr, ++count;
  }
  std::printf("ViSP %s, every %d: %.2f mm %.2f degrees over %d frames, %d lost\n", kind.c_str(), step,
              1e3 * std::sqrt(t2 / count), std::sqrt(r2 / count), count, lost);
}
