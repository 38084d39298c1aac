# Everything comes from Debian's packages; packages.txt is the one list of their names.
find_package(PkgConfig REQUIRED)
find_package(Threads REQUIRED)
find_package(Eigen3 REQUIRED NO_MODULE)
find_package(OpenCV 4.6 REQUIRED COMPONENTS core imgproc imgcodecs calib3d features2d)
find_package(Ceres 2.1 REQUIRED)
find_package(OpenImageIO 2.4 REQUIRED)
find_package(TBB REQUIRED)
find_package(fmt REQUIRED)
find_package(spdlog REQUIRED)
find_package(nlohmann_json REQUIRED)
find_package(tomlplusplus REQUIRED)
find_package(CLI11 2.1 REQUIRED)
pkg_check_modules(epoxy REQUIRED IMPORTED_TARGET epoxy)

# mrcal and CHOLMOD ship neither a CMake config nor a .pc file.
find_path(MRCAL_INCLUDE_DIR mrcal/mrcal.h REQUIRED)
find_library(MRCAL_LIBRARY mrcal REQUIRED)
add_library(mrcal::mrcal UNKNOWN IMPORTED)
set_target_properties(mrcal::mrcal PROPERTIES
  IMPORTED_LOCATION ${MRCAL_LIBRARY} INTERFACE_INCLUDE_DIRECTORIES ${MRCAL_INCLUDE_DIR})
find_library(CHOLMOD_LIBRARY cholmod REQUIRED)
add_library(cholmod::cholmod UNKNOWN IMPORTED)
set_target_properties(cholmod::cholmod PROPERTIES IMPORTED_LOCATION ${CHOLMOD_LIBRARY})
