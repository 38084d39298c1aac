#pragma once

#include <string>

#include "core/image_io.h"
#include "tests/support/support.h"

namespace stuv::test {

/// A small grey picture, all of one value.
inline Image flat_image(int width, int height, std::uint8_t value) {
  Image image{width, height, 1, PixelType::u8, {}, {}};
  image.bytes.assign(static_cast<std::size_t>(width) * height, static_cast<std::byte>(value));
  return image;
}

/// Pictures FOLDER/s{set}_c{camera}.png of all sets and cameras but those listed as "set/camera".
inline void write_pictures(const std::filesystem::path& folder, const std::vector<std::string>& sets,
                           const std::vector<std::string>& cameras,
                           const std::vector<std::string>& lacking = {}) {
  std::filesystem::create_directories(folder);
  for (const std::string& set : sets)
    for (const std::string& camera : cameras)
      if (std::find(lacking.begin(), lacking.end(), set + "/" + camera) == lacking.end())
        write_image(folder / ("s" + set + "_c" + camera + ".png"), flat_image(8, 6, 99));
}

}  // namespace stuv::test
