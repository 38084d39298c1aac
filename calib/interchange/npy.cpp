#include "calib/interchange/npy.h"

#include <fmt/format.h>

#include <bit>
#include <cstring>
#include <regex>

#include "core/error.h"
#include "core/files.h"

namespace stuv {
namespace {

static_assert(std::endian::native == std::endian::little);

constexpr std::string_view kMagic = "\x93NUMPY";

[[noreturn]] void fail(const std::filesystem::path& file, const std::string& problem) {
  throw Error(file.string(), problem, "save it anew with numpy.save, as a 2D array of float64");
}

struct Header {
  std::string type;
  bool by_columns = false;
  Eigen::Index rows = 0, cols = 0;
  std::size_t begin = 0;  ///< of the numbers
};

Header read_header(const std::filesystem::path& file, const std::string& bytes) {
  if (bytes.size() < 12 || bytes.compare(0, kMagic.size(), kMagic) != 0) fail(file, "is no .npy file");
  // Version 1 has two bytes of length, later ones four.
  const std::size_t wide = bytes[6] == 1 ? 2 : 4;
  std::uint32_t length = 0;
  std::memcpy(&length, bytes.data() + 8, wide);
  Header header;
  header.begin = 8 + wide + length;
  if (header.begin > bytes.size()) fail(file, "is truncated");
  const std::string text = bytes.substr(8 + wide, length);
  std::smatch found;
  if (!std::regex_search(text, found, std::regex(R"('descr':\s*'([^']*)')")))
    fail(file, "does not say its type");
  header.type = found[1];
  header.by_columns = std::regex_search(text, std::regex(R"('fortran_order':\s*True)"));
  if (!std::regex_search(text, found, std::regex(R"('shape':\s*\((\d{1,9}),\s*(\d{1,9})\s*,?\))")))
    fail(file, "is no array of two dimensions");
  header.rows = std::stol(found[1]);
  header.cols = std::stol(found[2]);
  return header;
}

template <class T>
RowMatrix numbers(const Header& header, const std::string& bytes, const std::filesystem::path& file) {
  const std::size_t count = static_cast<std::size_t>(header.rows) * static_cast<std::size_t>(header.cols);
  if (bytes.size() - header.begin < count * sizeof(T)) fail(file, "is truncated");
  std::vector<T> values(count);
  std::memcpy(values.data(), bytes.data() + header.begin, count * sizeof(T));
  RowMatrix m(header.rows, header.cols);
  for (Eigen::Index i = 0; i < header.rows; ++i)
    for (Eigen::Index j = 0; j < header.cols; ++j)
      m(i, j) =
          values[static_cast<std::size_t>(header.by_columns ? j * header.rows + i : i * header.cols + j)];
  return m;
}

}  // namespace

RowMatrix read_npy(const std::filesystem::path& file) {
  const std::string bytes = read_text(file);
  const Header header = read_header(file, bytes);
  if (header.type == "<f8") return numbers<double>(header, bytes, file);
  if (header.type == "<f4") return numbers<float>(header, bytes, file);
  fail(file, fmt::format("holds numbers of type {}", header.type));
}

void write_npy(const std::filesystem::path& file, const RowMatrix& matrix) {
  std::string header = fmt::format("{{'descr': '<f8', 'fortran_order': False, 'shape': ({}, {}), }}",
                                   matrix.rows(), matrix.cols());
  const std::size_t before = kMagic.size() + 4;
  header.append(63 - (before + header.size()) % 64, ' ');
  header += '\n';
  const auto length = static_cast<std::uint16_t>(header.size());
  std::string bytes(kMagic);
  bytes += '\x01';
  bytes += '\0';
  bytes.append(reinterpret_cast<const char*>(&length), 2);
  bytes += header;
  bytes.append(reinterpret_cast<const char*>(matrix.data()), static_cast<std::size_t>(matrix.size()) * 8);
  write_text(file, bytes);
}

}  // namespace stuv
