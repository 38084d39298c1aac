#include "calib/board/markers.h"

#include <array>
#include <opencv2/aruco/dictionary.hpp>
#include <stdexcept>

namespace stuv {
namespace {

/// In the order of OpenCV's enumeration.
constexpr std::array kNames = {"DICT_4X4_50",        "DICT_4X4_100",        "DICT_4X4_250",
                               "DICT_4X4_1000",      "DICT_5X5_50",         "DICT_5X5_100",
                               "DICT_5X5_250",       "DICT_5X5_1000",       "DICT_6X6_50",
                               "DICT_6X6_100",       "DICT_6X6_250",        "DICT_6X6_1000",
                               "DICT_7X7_50",        "DICT_7X7_100",        "DICT_7X7_250",
                               "DICT_7X7_1000",      "DICT_ARUCO_ORIGINAL", "DICT_APRILTAG_16h5",
                               "DICT_APRILTAG_25h9", "DICT_APRILTAG_36h10", "DICT_APRILTAG_36h11"};
static_assert(cv::aruco::DICT_ARUCO_ORIGINAL == 16 && cv::aruco::DICT_APRILTAG_36h11 == kNames.size() - 1);

}  // namespace

int dictionary_index(const std::string& name) {
  for (std::size_t i = 0; i < kNames.size(); ++i)
    if (name == kNames[i]) return static_cast<int>(i);
  return -1;
}

int dictionary_size(const std::string& name) {
  const int index = dictionary_index(name);
  return index < 0 ? 0 : cv::aruco::getPredefinedDictionary(index)->bytesList.rows;
}

MarkerBits marker_bits(const std::string& dictionary, int id) {
  if (id < 0 || id >= dictionary_size(dictionary)) throw std::invalid_argument("no such marker");
  const cv::Ptr<cv::aruco::Dictionary> all = cv::aruco::getPredefinedDictionary(dictionary_index(dictionary));
  const cv::Mat bits =
      cv::aruco::Dictionary::getBitsFromByteList(all->bytesList.rowRange(id, id + 1), all->markerSize);
  MarkerBits result{all->markerSize, {}};
  for (int y = 0; y < bits.rows; ++y)
    for (int x = 0; x < bits.cols; ++x) result.white.push_back(bits.at<unsigned char>(y, x) != 0);
  return result;
}

}  // namespace stuv
