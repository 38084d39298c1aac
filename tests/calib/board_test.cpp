#include "calib/board/board.h"
#include "calib/board/symmetric_corner.h"

#include <fstream>
#include <opencv2/calib3d.hpp>

#include "calib/board/find_corners.h"
#include "calib/board/markers.h"
#include "calib/board/refine.h"
#include "calib/board/symmetric_corner.h"
#include "core/error.h"
#include "core/image_io.h"
#include "core/json.h"
#include "tests/calib/board_scenes.h"
#include "tests/support/support.h"

using namespace stuv;
using namespace stuv::test;
using Catch::Contains;

TEST_CASE("a board is read from its text and written as one text") {
  CHECK(board_spec(parse_board("chessboard:28x17:2cm")) == "chessboard:28x17:20mm");
  const Board charuco = parse_board("charuco:4x5:54mm:4.05cm:DICT_4X4_1000:inverted");
  CHECK(board_spec(charuco) == "charuco:4x5:54mm:40.5mm:DICT_4X4_1000:inverted");
  CHECK(charuco.columns == 3);
  CHECK(charuco.rows == 4);
  CHECK(charuco.inverted);
  CHECK_FALSE(charuco.legacy);
  CHECK_FALSE(charuco.is_ambiguous());
  CHECK(parse_board("charuco:5x8:3cm:22mm:DICT_5X5_50:legacy").legacy);

  const Board grid = parse_board("aprilgrid:6x6:88mm:0.3");
  CHECK(board_spec(grid) == "aprilgrid:6x6:88mm:3/10");
  CHECK(grid.columns == 76);
  CHECK(grid.square_m == Approx(0.0088));
  CHECK(grid.real_corners() == 144);
  CHECK(board_spec(parse_board("aprilgrid:6x6:88mm:26.4mm")) == "aprilgrid:6x6:88mm:3/10");
  CHECK(board_spec(parse_board("aprilgrid:6x6:88mm:3/10")) == "aprilgrid:6x6:88mm:3/10");
  CHECK(board_spec(parse_board("aprilgrid:4x3:6cm:0.25")) == "aprilgrid:4x3:60mm:1/4");
  // A third, as it is written in target files.
  CHECK(board_spec(parse_board("aprilgrid:4x3:6cm:0.33333")) == "aprilgrid:4x3:60mm:1/3");
}

TEST_CASE("corners of an AprilGrid lie where its tags end") {
  const Board board = parse_board("aprilgrid:3x2:50mm:0.3");
  const std::vector<Eigen::Vector3d> points = board_points(board);
  std::vector<double> columns, rows;
  int count = 0;
  for (int i = 0; i < board.corners(); ++i) {
    if (!board.has_corner(i)) continue;
    ++count;
    if (i < board.columns) columns.push_back(points[static_cast<std::size_t>(i)].x());
    if (i % board.columns == 0) rows.push_back(points[static_cast<std::size_t>(i)].y());
  }
  CHECK(count == 24);
  CHECK(count == board.real_corners());
  const std::vector<double> expected = {0, 0.05, 0.065, 0.115, 0.13, 0.18};
  REQUIRE(columns.size() == 6);
  for (std::size_t i = 0; i < 6; ++i) CHECK(columns[i] == Approx(expected[i]));
  REQUIRE(rows.size() == 4);
  CHECK(rows.back() == Approx(0.115));
}

TEST_CASE("a board that cannot be is refused in one line that says why") {
  const std::pair<const char*, const char*> bad[] = {
      {"circles:4x5:3mm", "no known kind"},
      {"charuco:4x5:54mm", "cannot be read"},
      {"charuco:4x5:54:40mm:DICT_4X4_50", "without mm, cm or m"},
      {"charuco:4x5:30mm:40mm:DICT_4X4_50", "do not fit"},
      {"charuco:4x5:54mm:40mm:DICT_3X3_50", "does not have"},
      {"charuco:20x20:54mm:40mm:DICT_4X4_50", "needs 200 markers"},
      {"charuco:4x5:54mm:40mm:DICT_4X4_50:upside", "not in inverted or legacy"},
      {"charuco:4x5:54mm:40mm:DICT_4X4_50:legacy:legacy", "not in inverted or legacy"},
      {"charuco:2x5:54mm:40mm:DICT_4X4_50", "fewer than 3 squares"},
      {"aprilgrid:6x6:88mm", "cannot be read"},
      {"aprilgrid:6x6:88mm:0", "gaps below 0.01"},
      {"aprilgrid:6x6:88mm:2", "or above 1"},
      {"aprilgrid:30x30:88mm:0.3", "more than 587"},
      {"aprilgrid:6x6:88mm:0.2837", "simpler fraction"},
      {"aprilgrid:6x6:88mm:0.3kg", "neither a number nor a length"},
      {"chessboard:8x8:20mm", "is square"},
      {"/nowhere/target.yaml", "cannot be read"},
  };
  for (const auto& [spec, why] : bad) {
    INFO(spec);
    try {
      parse_board(spec);
      FAIL_CHECK("was taken");
    } catch (const Error& e) {
      CHECK_THAT(e.what(), Contains(why));
      CHECK(line_count(e.what()) == 0);
    }
  }
}

TEST_CASE("Kalibr's target files are boards") {
  const TempFolder folder;
  const auto write = [&](const std::string& name, const std::string& text) {
    std::ofstream(folder / name) << text;
    return (folder / name).string();
  };
  CHECK(board_spec(parse_board(
            write("april.yaml",
                  "target_type: 'aprilgrid' #gridtype\ntagCols: 6     #number of apriltags\n"
                  "tagRows: 5\ntagSize: 0.088\ntagSpacing: 0.3   #ratio\n"))) == "aprilgrid:6x5:88mm:3/10");
  CHECK(board_spec(parse_board(write("chess.yaml",
                                     "target_type: 'checkerboard'\ntargetCols: 6\ntargetRows: 7\n"
                                     "rowSpacingMeters: 0.06\ncolSpacingMeters: 0.06\n"))) ==
        "chessboard:6x7:60mm");
  CHECK_THROWS_WITH(parse_board(write("none.yaml", "target_type: aprilgrid\ntagCols: 6\n")),
                    Contains("has no tagRows"));
  CHECK_THROWS_WITH(parse_board(write("oblong.yaml",
                                      "target_type: checkerboard\ntargetCols: 6\ntargetRows: 7\n"
                                      "rowSpacingMeters: 0.06\ncolSpacingMeters: 0.05\n")),
                    Contains("not square"));
  CHECK_THROWS_WITH(parse_board(write("circle.yaml", "target_type: circlegrid\n")), Contains("circlegrid"));
}

TEST_CASE("tags are turned as Kalibr prints them") {
  // Code 0 of family 36h11 is 0xd5d628584, row by row from the top left, in Kalibr's print; the board's first
  // tag from the bottom left shows it. Its cells are read back from the areas that are drawn black.
  const Board board = parse_board("aprilgrid:2x2:50mm:0.3");
  const Eigen::AlignedBox2d tag = marker_boxes(board)[0];
  CHECK(tag.min().x() == Approx(0));
  CHECK(tag.max().y() == Approx(0.115));
  const std::vector<Eigen::AlignedBox2d> dark = dark_areas(board);
  std::uint64_t code = 0;
  for (int y = 0; y < 6; ++y)
    for (int x = 0; x < 6; ++x) {
      const Eigen::Vector2d middle = tag.min() + 0.005 * Eigen::Vector2d(x + 2.5, y + 2.5);
      const bool black = std::any_of(dark.begin(), dark.end(),
                                     [&](const Eigen::AlignedBox2d& b) { return b.contains(middle); });
      code = 2 * code + (black ? 0 : 1);
    }
  CHECK(code == 0xd5d628584);
}

TEST_CASE("each board is found whole, tilted, blurred, dark and noisy, where it is") {
  struct Case {
    const char* spec;
    double distance_m;
    int least_blurred;  // corners that must be found in the blurred picture
  };
  const Case cases[] = {{"chessboard:10x7:40mm", 0.8, 70},
                        {"charuco:5x7:40mm:30mm:DICT_4X4_50", 0.55, 22},
                        {"charuco:4x6:54mm:40.5mm:DICT_4X4_1000:inverted:legacy", 0.65, 14},
                        {"aprilgrid:4x3:60mm:0.3", 0.6, 44}};
  const Spoil spoils[] = {{}, {0.7, 1, 2, 3}, {1.5, 1, 2, 4}, {0.7, 0.12, 1, 5}};
  for (const Case& c : cases) {
    const Board board = parse_board(c.spec);
    const Camera camera = test_camera();
    const Pose pose = board_pose(board, c.distance_m, {0.35, -0.3, 0.2});
    for (const Spoil& spoil : spoils) {
      INFO(c.spec << ", blur " << spoil.blur_px << ", light " << spoil.light);
      const BoardView view = detect_board(photograph(board, camera, pose, spoil), board);
      CHECK(view.seen() >= (spoil.blur_px > 1 ? c.least_blurred : board.real_corners()));
      if (view.empty()) continue;
      Errors errors;
      add_errors(board, camera, pose, view, errors);
      INFO("rms " << errors.rms() << " px, worst " << errors.worst() << ", of sigma "
                  << errors.normalised_rms());
      CHECK(errors.rms() < 0.1);
      CHECK(errors.worst() < 0.5);
    }
  }
}

TEST_CASE("a board that is another one is not found") {
  const Camera camera = test_camera();
  const Board board = parse_board("charuco:5x8:30mm:22mm:DICT_5X5_50:legacy");
  const Image picture = photograph(board, camera, board_pose(board, 0.4, {0.1, 0.2, 0}));
  CHECK(detect_board(picture, board).seen() == board.real_corners());
  CHECK(detect_board(picture, parse_board("charuco:5x8:30mm:22mm:DICT_5X5_50")).empty());
  CHECK(detect_board(picture, parse_board("charuco:5x8:30mm:22mm:DICT_6X6_50")).empty());
  CHECK(detect_board(picture, parse_board("charuco:5x8:30mm:22mm:DICT_5X5_50:legacy:inverted")).empty());
  CHECK(detect_board(picture, parse_board("aprilgrid:5x8:30mm:0.3")).empty());
}

TEST_CASE("partly seen boards: what is in the picture is found, in its place") {
  struct Case {
    const char* spec;
    double distance_m;
    Eigen::Vector2d aside;
    int least;
  };
  const Case cases[] = {{"chessboard:13x8:40mm", 0.7, {-0.2, 0.02}, 70},
                        {"chessboard:12x9:40mm", 0.7, {0.02, 0.14}, 70},
                        {"charuco:7x5:40mm:30mm:DICT_4X4_50", 0.5, {0.2, 0.1}, 8},
                        {"aprilgrid:4x3:60mm:0.3", 0.5, {-0.22, 0.1}, 16}};
  for (const Case& c : cases) {
    const Board board = parse_board(c.spec);
    const Camera camera = test_camera();
    const Pose pose = board_pose(board, c.distance_m, {0.15, -0.2, 0.1}, c.aside);
    const BoardView view = detect_board(photograph(board, camera, pose, {0.6, 1, 1, 3}), board);
    INFO(c.spec << " " << c.aside.transpose() << ": " << view.seen() << " of " << board.real_corners());
    CHECK(view.seen() >= c.least);
    CHECK(view.seen() < board.real_corners());
    if (view.empty()) continue;
    // An ambiguous board may be counted from its other end, not from the middle.
    Errors errors;
    add_errors(board, camera, pose, view, errors);
    CHECK(errors.worst() < 0.3);
  }
}

TEST_CASE("a chessboard of which two opposite ends are hidden has no place, and is left out") {
  const Board board = parse_board("chessboard:20x7:40mm");
  const Camera camera = test_camera();
  const Image picture = photograph(board, camera, board_pose(board, 0.6, {0.1, 0.1, 0}), {0.6, 1, 1, 3});
  CHECK(detect_board(picture, board).empty());
}

TEST_CASE(
    "sigma says how large errors are: blurred and dark corners have a larger one, and weights follow it") {
  // 3 boards by light and focus, several seeds; errors over sigma must be near 1 for all, while errors
  // themselves differ by a factor.
  const Board board = parse_board("charuco:7x5:40mm:30mm:DICT_4X4_50");
  const Camera camera = test_camera();
  const Spoil spoils[] = {{0.7, 1, 2, 0}, {2, 1, 4, 0}, {1, 0.25, 4, 0}};
  std::vector<double> plain, normalised;
  for (const Spoil& base : spoils) {
    Errors errors;
    for (std::uint64_t seed = 1; seed <= 6; ++seed) {
      Spoil spoil = base;
      spoil.seed = seed;
      const double turn = 2.0 * static_cast<double>(seed);
      const Pose pose = board_pose(board, 0.55, {0.3 * std::cos(turn), 0.3 * std::sin(turn), 0.1});
      add_errors(board, camera, pose, detect_board(photograph(board, camera, pose, spoil), board), errors);
    }
    REQUIRE(errors.error_px.size() > 80);
    plain.push_back(errors.rms());
    normalised.push_back(errors.normalised_rms());
    std::printf("blur %.1f light %.2f noise %.0f: rms %.4f px, of sigma %.3f, %zu corners\n", base.blur_px,
                base.light, base.noise, errors.rms(), errors.normalised_rms(), errors.error_px.size());
  }
  const auto spread = [](const std::vector<double>& v) {
    return *std::max_element(v.begin(), v.end()) / *std::min_element(v.begin(), v.end());
  };
  // Neighbouring edges bleed into the windows of blurred corners, which no noise explains: sigma is then up
  // to twice too small. Without it, errors differ by a factor of nine.
  CHECK(spread(plain) > 6);
  CHECK(spread(normalised) < 0.35 * spread(plain));
  for (const double n : normalised) {
    CHECK(n > 0.6);
    CHECK(n < 2);
  }
}

namespace {

/// A crossing drawn exactly on a curved and slanted pair of edges, blurred by a pixel, under a lamp from the
/// side: p(d) as `lattice` has it around `truth`.
cv::Mat crossing(const Eigen::Vector2d& truth, double bend, int size) {
  cv::Mat picture(size, size, CV_32F);
  for (int y = 0; y < size; ++y)
    for (int x = 0; x < size; ++x) {
      const Eigen::Vector2d e = Eigen::Vector2d(x, y) - truth;
      const double across = e.x() + 0.2 * e.y(), a = std::erf(across / 1.4),
                   b = std::erf((e.y() - bend * across * across) / 1.4);
      picture.at<float>(y, x) = static_cast<float>(120 + 0.5 * e.x() + 80 * a * b);
    }
  return picture;
}

/// In half windows of 12 px.
LocalLattice lattice_of(double bend) {
  LocalLattice lattice;
  lattice.A << 12, -0.2 * 12, 0, 12;
  lattice.B.setZero();
  lattice.B(1, 0) = bend * 12 * 12;
  lattice.B(0, 0) = -0.2 * lattice.B(1, 0);  // both stay on the slanted edge's parallels
  return lattice;
}

cv::Mat noisy(const cv::Mat& exact, double deviation, std::mt19937_64& random) {
  std::normal_distribution<float> noise(0, static_cast<float>(deviation));
  cv::Mat picture = exact.clone();
  for (auto it = picture.begin<float>(); it != picture.end<float>(); ++it) *it += noise(random);
  return picture;
}

}  // namespace

TEST_CASE(
    "a corner by symmetry: neither shading nor a curved edge moves it, and its covariance is its scatter") {
  const Eigen::Vector2d truth(20.3, 19.6), start = truth + Eigen::Vector2d(0.8, -0.6);
  std::mt19937_64 random(7);
  for (const double bend : {0.0, 0.004}) {
    const cv::Mat exact = crossing(truth, bend, 41);
    const LocalLattice lattice = lattice_of(bend);
    const auto clean = refine_by_symmetry(smooth_for_symmetry(exact), lattice, start, 4);
    REQUIRE(clean);
    // Blur of deviation s moves an edge of curvature k by k s^2 / 2.
    CHECK((clean->at_px - truth).norm() < (bend > 0 ? 0.01 : 0.003));
    // Half a pixel of bend at the window's border, taken for a straight edge, is seen in the corner.
    if (bend > 0) {
      const auto straight = refine_by_symmetry(smooth_for_symmetry(exact), lattice_of(0), start, 4);
      REQUIRE(straight);
      CHECK((straight->at_px - truth).norm() > 0.1);
    }
    Eigen::Matrix2d scatter = Eigen::Matrix2d::Zero(), stated = Eigen::Matrix2d::Zero();
    constexpr int kDraws = 400;
    for (int i = 0; i < kDraws; ++i) {
      const auto corner = refine_by_symmetry(smooth_for_symmetry(noisy(exact, 3, random)), lattice, start, 4);
      REQUIRE(corner);
      const Eigen::Vector2d e = corner->at_px - clean->at_px;
      scatter += e * e.transpose() / kDraws;
      stated += corner->covariance / kDraws;
    }
    INFO("scatter\n" << scatter << "\nstated\n" << stated);
    for (int axis = 0; axis < 2; ++axis)
      CHECK(std::sqrt(scatter(axis, axis) / stated(axis, axis)) == Approx(1).margin(0.12));
  }
}

TEST_CASE("what spoils a corner's symmetry is in its covariance; one edge or nothing is no corner") {
  const Eigen::Vector2d truth(20.3, 19.6);
  cv::Mat picture = crossing(truth, 0, 41);
  const auto whole = refine_by_symmetry(smooth_for_symmetry(picture), lattice_of(0), truth, 4);
  picture(cv::Rect(23, 23, 18, 18)).setTo(90);  // a hidden quarter
  const auto spoilt = refine_by_symmetry(smooth_for_symmetry(picture), lattice_of(0), truth, 4);
  REQUIRE(whole);
  if (spoilt) {
    const double sigma = std::sqrt(0.5 * spoilt->covariance.trace());
    CHECK(sigma > 20 * std::sqrt(0.5 * whole->covariance.trace()));
    CHECK((spoilt->at_px - truth).norm() < 6 * sigma);
  }
  CHECK_FALSE(refine_by_symmetry(cv::Mat::zeros(41, 41, CV_32F), lattice_of(0), truth, 4));
  cv::Mat edge = cv::Mat::zeros(41, 41, CV_32F);
  edge.colRange(20, 41).setTo(200);
  CHECK_FALSE(refine_by_symmetry(smooth_for_symmetry(edge), lattice_of(0), truth, 4));
  CHECK_FALSE(refine_by_symmetry(smooth_for_symmetry(crossing(truth, 0, 41)), lattice_of(0), {-50, 1e9}, 4));
  cv::Mat broken = crossing(truth, 0, 41);
  broken.at<float>(20, 20) = std::nanf("");
  CHECK_FALSE(refine_by_symmetry(smooth_for_symmetry(broken), lattice_of(0), truth, 4));
}

TEST_CASE("errors of the corners are hardly shared by the cameras that see one pose") {
  // Nine cameras a few centimetres apart, as of an array, look at one board: what their corners' errors have
  // in common no number of cameras averages out. findChessboardCornersSB has several times as much, up to 0.1
  // px.
  const Board board = parse_board("chessboard:10x7:40mm");
  const Camera camera = test_camera(640, 480, 600);
  Errors common, common_sb;
  for (const Eigen::Vector3d& turn :
       {Eigen::Vector3d(0.5, 0.1, 0.2), Eigen::Vector3d(-0.2, 0.6, -0.3), Eigen::Vector3d(0.05, 0.02, 0)}) {
    std::vector<Eigen::Vector2d> mean(70, Eigen::Vector2d::Zero()), mean_sb = mean;
    for (int k = 0; k < 9; ++k) {
      const Pose pose = board_pose(board, 0.75, turn, {0.03 * (k % 3) - 0.03, 0.03 * (k / 3) - 0.03});
      const std::vector<Eigen::Vector2d> truth = synthetic::board_pixels(drawn(board), camera, pose);
      const Image picture = photograph(board, camera, pose, {0.7, 1, 2, static_cast<std::uint64_t>(k)});
      const BoardView view = detect_board(picture, board);
      REQUIRE(view.seen() == 70);
      const cv::Mat grey(picture.height, picture.width, CV_8UC1,
                         const_cast<std::byte*>(picture.bytes.data()));
      std::vector<cv::Point2f> sb;
      REQUIRE(cv::findChessboardCornersSB(grey, {10, 7}, sb, cv::CALIB_CB_ACCURACY));
      const bool turned = std::hypot(sb[0].x - truth[0].x(), sb[0].y - truth[0].y()) > 10;
      for (std::size_t i = 0; i < 70; ++i) {
        const cv::Point2f& c = sb[turned ? 69 - i : i];
        mean[i] += (view.corners_px[i] - truth[i]) / 9;
        mean_sb[i] += (Eigen::Vector2d(c.x, c.y) - truth[i]) / 9;
      }
    }
    common.error_px.insert(common.error_px.end(), mean.begin(), mean.end());
    common_sb.error_px.insert(common_sb.error_px.end(), mean_sb.begin(), mean_sb.end());
  }
  std::printf("corners' errors in common: rms %.4f px, SB's %.4f px\n", common.rms(), common_sb.rms());
  CHECK(common.rms() < 0.01);
  CHECK(common.rms() < common_sb.rms() / 3);
}

TEST_CASE("a single edge and an empty window are no corner") {
  CornerImage image;
  image.luma = cv::Mat::zeros(30, 30, CV_32F);
  image.gradient_x = cv::Mat::zeros(30, 30, CV_32F);
  image.gradient_y = cv::Mat::zeros(30, 30, CV_32F);
  CHECK_FALSE(refine_corner(image, {15, 15}, 5, 3));
  image.gradient_x.col(15).setTo(50);
  CHECK_FALSE(refine_corner(image, {15, 15}, 5, 3));
  CHECK_FALSE(refine_corner(image, {2, 2}, 5, 3));  // the window leaves the picture
}

TEST_CASE("corners that were found are kept, also those of a search that was cut short") {
  const TempFolder folder;
  const Board board = parse_board("charuco:5x7:40mm:30mm:DICT_4X4_50");
  const Camera camera = test_camera(400, 300, 400);
  Recording recording;
  recording.folder = folder.path();
  recording.rows = recording.cols = 1;
  recording.cameras = {{"cam", 0, 0}};
  for (int s = 0; s < 3; ++s) {
    const Pose pose = board_pose(board, 0.6, {0.2 * s, 0.1, 0});
    const auto file = folder / ("p" + std::to_string(s) + ".png");
    write_image(file, photograph(board, camera, pose));
    Frame frame;
    frame.status = FrameStatus::ok;
    frame.file = file;
    recording.sets.push_back({"s" + std::to_string(s), {frame}});
  }
  Recording first = recording;
  first.sets.resize(2);
  CHECK(find_corners(first, board).remembered == 0);
  const FoundCorners all = find_corners(recording, board);
  CHECK(all.remembered == 2);
  CHECK(all.boards == 3);
  const FoundCorners again = find_corners(recording, board);
  CHECK(again.remembered == 3);
  for (int s = 0; s < 3; ++s) {
    const BoardView &a = all.views[s][0], &b = again.views[s][0];
    REQUIRE(a.corners_px.size() == b.corners_px.size());
    for (std::size_t i = 0; i < a.corners_px.size(); ++i) {
      CHECK(a.corners_px[i].allFinite() == b.corners_px[i].allFinite());
      if (a.corners_px[i].allFinite()) CHECK((a.corners_px[i] - b.corners_px[i]).norm() == 0);
    }
  }
  // A file that a crash damaged is looked at again, as is one of another board.
  std::ofstream(folder / "corners" / "charuco_5x7_40mm_30mm_DICT_4X4_50" / "s1" / "cam.json") << "{";
  CHECK(find_corners(recording, board).remembered == 2);
  CHECK(find_corners(recording, parse_board("charuco:5x7:41mm:30mm:DICT_4X4_50")).remembered == 0);
}

TEST_CASE("weights: a usual corner weighs 1, an absent one nothing") {
  FoundCorners found;
  const double nan = std::nan("");
  found.views = {{{{{1, 1}, {2, 2}, {nan, nan}}, {0.02, 0.04, nan}}, {{{3, 3}}, {0.04}}}};
  CHECK(median_sigma_px(found) == 0.04);
  const std::vector<double> weights = corner_weights(found.views[0][0], 0.04);
  CHECK(weights[0] == Approx(std::hypot(0.04, kSolveFloorPx) / std::hypot(0.02, kSolveFloorPx)));
  CHECK(weights[1] == 1);
  CHECK(weights[2] == 0);
}
