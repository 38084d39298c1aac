#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "core/light_field.h"

namespace stuv {

/// One row of somebody else's list of views.
struct ListedView {
  std::filesystem::path file;
  double s = 0, t = 0;
  ViewRole role = ViewRole::input;
};

enum class ViewLayout {
  csv,       ///< views.csv: `file,s,t,role`, s and t in metres or camera steps, role input or truth
  stanford,  ///< *_ROW_COL_Y_X.*: (s, t) = (X, Y) in millimetres, as the Stanford archive names its views
  hci  ///< input_CamNNN.*: NNN = 9 row + col, (s, t) in camera steps from the centre, as the HCI benchmark
       ///< does
};

/// Reads the list; `source` is the csv file or the folder. Throws Error naming the file (and line) that is
/// wrong.
std::vector<ListedView> list_views(const std::filesystem::path& source, ViewLayout layout);

/// Gives each input view its row and column: views whose t (s) lie within half the median distance of nearest
/// neighbours form a row (column). Rows and columns without any view are not counted: tents know local
/// spacing only. Throws Error (naming `source`) if two views share a place.
void place_on_lattice(LightField& lf, const std::string& source);

}  // namespace stuv
