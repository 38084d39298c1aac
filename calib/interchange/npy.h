#pragma once

#include <Eigen/Dense>
#include <filesystem>

namespace stuv {

// NumPy's .npy (numpy.lib.format): "\x93NUMPY", version, length of the header, a Python dictionary with descr
// (type), fortran_order and shape, padded with blanks to a multiple of 64 bytes, then the numbers.

using RowMatrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

/// A two-dimensional array of little-endian floats or doubles. Throws Error for anything else.
RowMatrix read_npy(const std::filesystem::path& file);
/// As doubles, row by row.
void write_npy(const std::filesystem::path& file, const RowMatrix& matrix);

}  // namespace stuv
