#include "capture/v4l2/v4l2_controls.h"

#include <fmt/format.h>
#include <linux/videodev2.h>

#include <algorithm>
#include <cctype>
#include <cerrno>

#include "capture/cameras/explain.h"
#include "core/error.h"

namespace stuv {
namespace {

/// A kind of control under one name: the automatic that hinders it, with the value that switches it off, and
/// the controls that drivers have for it, best first.
struct Alias {
  const char* name;
  std::uint32_t automatic;
  std::int64_t off;
  std::uint32_t controls[2];
};

constexpr Alias kAliases[] = {
    {"exposure",
     V4L2_CID_EXPOSURE_AUTO,
     V4L2_EXPOSURE_MANUAL,
     {V4L2_CID_EXPOSURE_ABSOLUTE, V4L2_CID_EXPOSURE}},
    {"gain", V4L2_CID_AUTOGAIN, 0, {V4L2_CID_GAIN, V4L2_CID_ANALOGUE_GAIN}},
    {"white_balance",
     V4L2_CID_AUTO_WHITE_BALANCE,
     0,
     {V4L2_CID_WHITE_BALANCE_TEMPERATURE, V4L2_CID_WHITE_BALANCE_TEMPERATURE}},
    {"focus", V4L2_CID_FOCUS_AUTO, 0, {V4L2_CID_FOCUS_ABSOLUTE, V4L2_CID_FOCUS_ABSOLUTE}},
};

/// "Exposure Time, Absolute" -> "exposure_time_absolute"
std::string plain_name(const char* name) {
  std::string plain;
  for (const char* c = name; *c != 0; ++c) {
    if (std::isalnum(static_cast<unsigned char>(*c)) != 0)
      plain += static_cast<char>(std::tolower(static_cast<unsigned char>(*c)));
    else if (!plain.empty() && plain.back() != '_')
      plain += '_';
  }
  while (!plain.empty() && plain.back() == '_') plain.pop_back();
  return plain;
}

const ControlInfo* find(const std::vector<ControlInfo>& controls, std::uint32_t id) {
  const auto it =
      std::find_if(controls.begin(), controls.end(), [&](const ControlInfo& c) { return c.id == id; });
  return it == controls.end() ? nullptr : &*it;
}

const ControlInfo& find(const std::vector<ControlInfo>& controls, const std::string& name,
                        const std::string& camera) {
  for (const Alias& alias : kAliases)
    if (name == alias.name)
      for (const std::uint32_t id : alias.controls)
        if (const ControlInfo* info = find(controls, id)) return *info;
  std::vector<std::string> names;
  for (const ControlInfo& info : controls) {
    if (info.name == name) return info;
    names.push_back(info.name);
  }
  throw Error("camera " + camera, fmt::format("has no control '{}'", name),
              fmt::format("it has {}", names.empty() ? "none" : fmt::format("{}", fmt::join(names, ", "))));
}

int write_control(const V4l2File& file, std::uint32_t id, std::int64_t value) {
  v4l2_ext_control control{};
  control.id = id;
  control.value = static_cast<std::int32_t>(value);
  v4l2_ext_controls list{};
  list.which = V4L2_CTRL_WHICH_CUR_VAL;
  list.count = 1;
  list.controls = &control;
  return file.control(VIDIOC_S_EXT_CTRLS, &list);
}

}  // namespace

std::vector<ControlInfo> list_controls(const V4l2File& file) {
  std::vector<ControlInfo> controls;
  v4l2_query_ext_ctrl query{};
  query.id = V4L2_CTRL_FLAG_NEXT_CTRL;
  while (file.control(VIDIOC_QUERY_EXT_CTRL, &query) == 0) {
    const bool number = query.type == V4L2_CTRL_TYPE_INTEGER || query.type == V4L2_CTRL_TYPE_BOOLEAN ||
                        query.type == V4L2_CTRL_TYPE_MENU || query.type == V4L2_CTRL_TYPE_INTEGER_MENU ||
                        query.type == V4L2_CTRL_TYPE_BITMASK || query.type == V4L2_CTRL_TYPE_BUTTON;
    if (number && (query.flags & (V4L2_CTRL_FLAG_DISABLED | V4L2_CTRL_FLAG_READ_ONLY)) == 0)
      controls.push_back(
          {query.id, plain_name(query.name), query.minimum, query.maximum, query.default_value});
    query.id |= V4L2_CTRL_FLAG_NEXT_CTRL;
  }
  return controls;
}

bool read_control(const V4l2File& file, std::uint32_t id, std::int64_t& value) {
  v4l2_ext_control control{};
  control.id = id;
  v4l2_ext_controls list{};
  list.which = V4L2_CTRL_WHICH_CUR_VAL;
  list.count = 1;
  list.controls = &control;
  if (file.control(VIDIOC_G_EXT_CTRLS, &list) != 0) return false;
  value = control.value;
  return true;
}

std::vector<ControlState> set_controls(const V4l2File& file,
                                       const std::map<std::string, std::int64_t>& wanted,
                                       const std::string& camera, const std::string& device) {
  const std::vector<ControlInfo> controls = list_controls(file);
  for (const Alias& alias : kAliases)
    if (wanted.contains(alias.name) && find(controls, alias.automatic) != nullptr)
      write_control(file, alias.automatic, alias.off);  // shows when the value is read back
  std::vector<ControlState> states;
  for (const auto& [name, value] : wanted) {
    const ControlInfo& info = find(controls, name, camera);
    if (value < info.least || value > info.most)
      throw Error("camera " + camera, fmt::format("control {} is to be {}", name, value),
                  fmt::format("it takes {} to {}", info.least, info.most));
    if (const int error = write_control(file, info.id, value); error != 0)
      throw camera_error(camera, device, fmt::format("set {} to {}", name, value), error);
    ControlState state{name, value, value};
    read_control(file, info.id, state.actual);  // a button has no value to read back
    states.push_back(state);
  }
  return states;
}

}  // namespace stuv
