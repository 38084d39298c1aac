#include "app/viewer/viewer_window.h"

#include <backends/imgui_impl_glfw.h>
#include <backends/imgui_impl_opengl3.h>
#include <epoxy/gl.h>
#include <fmt/format.h>
#include <imgui.h>

#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "app/viewer/render_worker.h"
#include "core/error.h"
#include "core/image_io.h"

// After epoxy, which brings OpenGL's declarations.
#define GLFW_INCLUDE_NONE
#include <GLFW/glfw3.h>

namespace stuv {
namespace {

constexpr int kPanel_px = 360;
/// While the mouse moves, pictures are made so small that they take no longer.
constexpr double kDragging_ms = 60;
/// The first picture is this much smaller, so that something is seen at once.
constexpr int kFirstShrink = 8;
/// Longest time between frames of the window.
constexpr double kResting_s = 0.1, kWorking_s = 0.015;
/// Clicks of the wheel that a drag with shift over the picture's height is worth: the whole range.
constexpr double kClicksPerHeight = 40;

std::string last_glfw_error() {
  const char* text = nullptr;
  return glfwGetError(&text) == GLFW_NO_ERROR || text == nullptr ? "no reason given" : text;
}

/// Without the slash that a shell may have left at its end.
std::string name_of(const LightField& lf) {
  const std::filesystem::path folder = std::filesystem::absolute(lf.folder).lexically_normal();
  return (folder.has_filename() ? folder : folder.parent_path()).filename().string();
}

/// Of the window: the panel and the picture, small ones enlarged, no larger than the screen has room for.
std::pair<int, int> window_size(const LightField& lf) {
  constexpr int kLeastHeight = 720;
  int x = 0, y = 0, width = 0, height = 0;
  if (GLFWmonitor* monitor = glfwGetPrimaryMonitor())
    glfwGetMonitorWorkarea(monitor, &x, &y, &width, &height);
  if (width <= 0 || height <= 0) width = 1366, height = 768;
  // A tenth is left for the frame and so that the window can be moved.
  const double most_width = std::max(0.9 * width - kPanel_px, 100.0),
               most_height = std::max(0.9 * height, 100.0);
  const double enlarged = std::max(1.0, kLeastHeight / static_cast<double>(lf.height));
  const double scale = std::min({most_width / lf.width, most_height / lf.height, enlarged});
  return {kPanel_px + std::max(static_cast<int>(std::lround(scale * lf.width)), 100),
          std::max(static_cast<int>(std::lround(scale * lf.height)),
                   static_cast<int>(std::min<double>(kLeastHeight, most_height)))};
}

/// GLFW, its window with OpenGL, and Dear ImGui in it.
class Window {
 public:
  explicit Window(const LightField& lf) {
    if (!glfwInit())
      throw Error("the display", fmt::format("cannot be opened ({})", last_glfw_error()),
                  "run on a desktop, over ssh -X, or under xvfb-run");
    glfwWindowHint(GLFW_CONTEXT_VERSION_MAJOR, 3);
    glfwWindowHint(GLFW_CONTEXT_VERSION_MINOR, 3);
    glfwWindowHint(GLFW_OPENGL_PROFILE, GLFW_OPENGL_CORE_PROFILE);
    const auto [width, height] = window_size(lf);
    window_ = glfwCreateWindow(width, height, ("stuv view " + name_of(lf)).c_str(), nullptr, nullptr);
    if (window_ == nullptr) {
      const std::string why = last_glfw_error();
      glfwTerminate();
      throw Error("the display", fmt::format("gives no window with OpenGL 3.3 ({})", why),
                  "install a driver (Mesa has one in software)");
    }
    glfwMakeContextCurrent(window_);
    glfwSwapInterval(1);
    // A key that is pressed and let go between two frames counts; Dear ImGui 1.86 misses it.
    glfwSetInputMode(window_, GLFW_STICKY_KEYS, GLFW_TRUE);
    ImGui::CreateContext();
    ImGui::GetIO().IniFilename = nullptr;
    ImGui::StyleColorsDark();
    ImGui_ImplGlfw_InitForOpenGL(window_, true);
    ImGui_ImplOpenGL3_Init("#version 330");
  }
  ~Window() {
    ImGui_ImplOpenGL3_Shutdown();
    ImGui_ImplGlfw_Shutdown();
    ImGui::DestroyContext();
    glfwDestroyWindow(window_);
    glfwTerminate();
  }
  Window(const Window&) = delete;
  Window& operator=(const Window&) = delete;
  GLFWwindow* get() const { return window_; }

 private:
  GLFWwindow* window_ = nullptr;
};

/// What lies in the framebuffer.
Image framebuffer(GLFWwindow* window) {
  int width = 0, height = 0;
  glfwGetFramebufferSize(window, &width, &height);
  std::vector<std::uint8_t> rows(static_cast<std::size_t>(width) * height * 3);
  glPixelStorei(GL_PACK_ALIGNMENT, 1);
  glReadPixels(0, 0, width, height, GL_RGB, GL_UNSIGNED_BYTE, rows.data());
  ImageF picture(width, height, 3);
  for (int y = 0; y < height; ++y)
    for (int i = 0; i < 3 * width; ++i)
      picture.row(y)[i] =
          static_cast<float>(rows[static_cast<std::size_t>(height - 1 - y) * width * 3 + i]) / 255;
  return from_float(picture, PixelType::u8);
}

class Viewer {
 public:
  Viewer(const LightFieldReader& reader, const ViewerState& start)
      : lf_(reader.light_field()), start_(start), state_(start), worker_(reader) {
    glGenTextures(1, &texture_);
    ask(kFirstShrink);
  }

  /// One frame of the window.
  void draw() {
    // First, so that the frame shows it.
    if (std::optional<RenderWorker::Result> result = worker_.take()) show(std::move(*result));
    const bool changed = panel() | picture_area();
    if (changed) ask(shrink_for(full_ms_, kDragging_ms));
    // The mouse rests: now in full.
    if (worker_.idle() && shown_.request.shrink > 1 && !changed && problem_.empty()) ask(1);
  }

  bool complete() const {
    return worker_.idle() &&
           (!problem_.empty() || (!shown_.view.colour.empty() && shown_.request.shrink == 1));
  }

  /// Why there is no picture; empty: there is one.
  const std::string& problem() const { return problem_; }

 private:
  void ask(int shrink) { worker_.submit({state_, shrink}); }

  void show(RenderWorker::Result result) {
    problem_ = result.problem;
    if (!problem_.empty()) return;
    const int shrink = result.request.shrink;
    full_ms_ = result.view.statistics.milliseconds * shrink * shrink;
    shown_ = std::move(result);
    upload();
  }

  void upload() {
    if (shown_.view.colour.empty()) return;
    const Raster<std::uint8_t> rgb = screen_picture(shown_.view, state_);
    glBindTexture(GL_TEXTURE_2D, texture_);
    glPixelStorei(GL_UNPACK_ALIGNMENT, 1);
    glTexImage2D(GL_TEXTURE_2D, 0, GL_RGB8, rgb.width, rgb.height, 0, GL_RGB, GL_UNSIGNED_BYTE,
                 rgb.data.data());
    glTexParameteri(GL_TEXTURE_2D, GL_TEXTURE_MIN_FILTER, GL_LINEAR);
    glTexParameteri(GL_TEXTURE_2D, GL_TEXTURE_MAG_FILTER, GL_LINEAR);
  }

  bool panel();
  bool method_switches();
  bool plane_switches();
  bool skip_switches();
  void numbers();
  void save();
  bool picture_area();
  bool mouse(float width, float height);

  const LightField& lf_;
  const ViewerState start_;
  ViewerState state_;
  RenderWorker worker_;
  RenderWorker::Result shown_;
  std::string problem_, saved_;
  double full_ms_ = 0;
  GLuint texture_ = 0;
};

/// A row of radio buttons.
template <class T>
bool choice(const char* label, T& value, std::initializer_list<std::pair<const char*, T>> options) {
  bool changed = false;
  ImGui::TextUnformatted(label);
  for (const auto& [name, option] : options) {
    ImGui::SameLine(option == options.begin()->second ? 110 : 0);
    if (ImGui::RadioButton(fmt::format("{}##{}", name, label).c_str(), value == option)) {
      changed = value != option;
      value = option;
    }
  }
  return changed;
}

bool Viewer::method_switches() {
  bool changed = choice("Mode", state_.all_in_focus, {{"all in focus", true}, {"focal plane", false}});
  changed |= choice("Method", state_.method,
                    {{"literal", Method::literal}, {"exact", Method::exact}, {"fast", Method::fast}});
  changed |= choice("Back end", state_.backend, {{"CPU", Backend::cpu}, {"OpenGL", Backend::gl}});
  if (!exists(state_.method, state_.backend)) state_.method = Method::exact;
  changed |= choice("Filter", state_.options.k,
                    {{"normal", Filter::normal}, {"wide", Filter::wide}, {"skipped", Filter::skipped}});
  // The overlay needs no new picture.
  if (choice("Overlay", state_.overlay,
             {{"none", Overlay::none}, {"depth", Overlay::depth}, {"trust", Overlay::confidence}}))
    upload();
  return changed;
}

bool Viewer::plane_switches() {
  bool changed = false;
  ImGui::PushItemWidth(190);
  const double low = start_.options.d_min, high = start_.options.d_max;
  if (!state_.all_in_focus) {
    changed |= ImGui::SliderScalar("focus, px", ImGuiDataType_Double, &state_.focus_px, &low, &high, "%.3f");
    const double rho = lf_.inverse_depth(state_.focus_px);
    if (lf_.metric && rho > 0) ImGui::Text("= %.3f m", 1 / rho);
  } else {
    changed |= ImGui::SliderInt("planes N", &state_.options.planes, 1, 128);
    changed |= ImGui::SliderInt("window M", &state_.options.window, 0, 20);
    RenderOptions& o = state_.options;
    changed |= ImGui::SliderScalar("farthest, px", ImGuiDataType_Double, &o.d_min, &low, &high, "%.3f");
    changed |= ImGui::SliderScalar("nearest, px", ImGuiDataType_Double, &o.d_max, &low, &high, "%.3f");
    o.planes = std::clamp(o.planes, 1, 1000);
    o.window = std::clamp(o.window, 0, 1000);
    if (o.d_max < o.d_min) o.d_max = o.d_min;
  }
  ImGui::PopItemWidth();
  return changed;
}

bool Viewer::skip_switches() {
  if (state_.method != Method::fast || !state_.all_in_focus || !ImGui::CollapsingHeader("What fast may skip"))
    return false;
  constexpr std::pair<const char*, bool Skips::*> kSkips[] = {
      {"empty planes", &Skips::empty_planes},
      {"planes not near a tile", &Skips::tile_planes},
      {"flat tiles", &Skips::flat_tiles},
      {"pixels beside tiles", &Skips::tile_margins},
      {"colour in costs", &Skips::colour_costs},
      {"second filter", &Skips::second_filter},
      {"idle cameras", &Skips::idle_cameras},
      {"unread tiles", &Skips::unread_tiles},
      {"known from the view before", &Skips::previous_view}};
  bool changed = false;
  for (const auto& [name, skip] : kSkips) changed |= ImGui::Checkbox(name, &(state_.options.skips.*skip));
  return changed;
}

void Viewer::numbers() {
  const RenderedView::Statistics& statistics = shown_.view.statistics;
  ImGui::Text("viewpoint  s %.4g  t %.4g  z %.4g", state_.s, state_.t, state_.z);
  if (state_.yaw != 0 || state_.pitch != 0)
    ImGui::Text("turned  %.1f deg right  %.1f deg up", state_.yaw * 180 / M_PI, state_.pitch * 180 / M_PI);
  ImGui::Text("frame  %.1f ms  (%dx%d)", statistics.milliseconds, shown_.view.colour.width,
              shown_.view.colour.height);
  for (const auto& [stage, ms] : statistics.stages_ms) ImGui::Text("  %s  %.1f ms", stage.c_str(), ms);
  if (shown_.request.state.all_in_focus)
    ImGui::Text("evaluated  %.1f %% of the planes", 100 * statistics.evaluated_fraction);
  if (!statistics.skipped.empty()) ImGui::TextDisabled("skipped");
  for (const Skipped& skipped : statistics.skipped) {
    ImGui::ProgressBar(static_cast<float>(skipped.fraction), ImVec2(90, 14),
                       fmt::format("{:.1f} %", 100 * skipped.fraction).c_str());
    ImGui::SameLine();
    ImGui::TextUnformatted(skipped.reason.c_str());
  }
}

/// The picture into the folder where the viewer was started, under a name that is free.
void Viewer::save() {
  std::filesystem::path file;
  for (int i = 0; file.empty() || std::filesystem::exists(file); ++i)
    file = fmt::format("{}_{:03}.png", name_of(lf_), i);
  try {
    write_image(file, from_float(shown_.view.colour, PixelType::u8));
    saved_ = file.string();
  } catch (const std::exception& e) {
    saved_ = e.what();
  }
}

bool Viewer::panel() {
  const ImVec2 size = ImGui::GetIO().DisplaySize;
  ImGui::SetNextWindowPos({0, 0});
  ImGui::SetNextWindowSize({kPanel_px, size.y});
  ImGui::Begin("stuv", nullptr,
               ImGuiWindowFlags_NoMove | ImGuiWindowFlags_NoResize | ImGuiWindowFlags_NoCollapse |
                   ImGuiWindowFlags_NoTitleBar);
  ImGui::TextUnformatted(name_of(lf_).c_str());
  ImGui::TextDisabled("%dx%d views of %dx%d, %s", lf_.rows, lf_.cols, lf_.width, lf_.height,
                      lf_.metric ? "metres" : "no metres");
  ImGui::Separator();
  bool changed = method_switches();
  changed |= plane_switches();
  changed |= skip_switches();
  ImGui::Separator();
  if (!worker_.idle()) ImGui::ProgressBar(static_cast<float>(worker_.progress()), {-1, 4}, "");
  if (problem_.empty())
    numbers();
  else
    ImGui::TextWrapped("%s", problem_.c_str());
  ImGui::Separator();
  const bool home =
      !ImGui::GetIO().WantTextInput && glfwGetKey(glfwGetCurrentContext(), GLFW_KEY_HOME) == GLFW_PRESS;
  if (ImGui::Button("Back to the start") || home) {
    state_ = start_;
    changed = true;
  }
  ImGui::SameLine();
  // Not the small one that is shown while the full one is in work.
  ImGui::BeginDisabled(!complete() || !problem_.empty());
  if (ImGui::Button("Save picture")) save();
  ImGui::EndDisabled();
  if (!saved_.empty()) ImGui::TextWrapped("%s", saved_.c_str());
  ImGui::TextDisabled("%s", lf_.metric
                                ? "drag: along the cameras' plane\nwheel, shift drag: towards the scene\n"
                                  "right drag: look around\nctrl wheel: zoom\nHome: back to the start"
                                : "drag: along the cameras' plane\nctrl wheel: zoom\n"
                                  "Home: back to the start\n"
                                  "(without metres only on their plane)");
  ImGui::End();
  return changed;
}

bool Viewer::mouse(float width, float height) {
  const ImGuiIO& io = ImGui::GetIO();
  if (!ImGui::IsItemHovered() && !ImGui::IsItemActive()) return false;
  const ViewerReach reach = reach_of(lf_, start_.options);
  const ImVec2 moved = io.MouseDelta;
  const bool moves = moved.x != 0 || moved.y != 0;
  bool changed = false;
  if (moves && ImGui::IsMouseDown(ImGuiMouseButton_Left)) {
    if (io.KeyShift)
      step_along_z(state_, reach, -kClicksPerHeight * moved.y / height);
    else
      drag(state_, reach, moved.x / width, moved.y / height);
    changed = true;
  }
  if (moves && ImGui::IsMouseDown(ImGuiMouseButton_Right)) {
    turn(state_, reach, moved.x / width, moved.y / height);
    changed = true;
  }
  if (io.MouseWheel != 0) {
    if (io.KeyCtrl)
      zoom(state_, io.MouseWheel);
    else
      step_along_z(state_, reach, io.MouseWheel);
    changed = true;
  }
  return changed;
}

/// The picture, as large as fits; the mouse acts on it.
bool Viewer::picture_area() {
  const ImVec2 size = ImGui::GetIO().DisplaySize;
  ImGui::SetNextWindowPos({kPanel_px, 0});
  ImGui::SetNextWindowSize({std::max(size.x - kPanel_px, 1.0F), size.y});
  ImGui::PushStyleVar(ImGuiStyleVar_WindowPadding, ImVec2(0, 0));
  ImGui::Begin("picture", nullptr,
               ImGuiWindowFlags_NoDecoration | ImGuiWindowFlags_NoMove |
                   ImGuiWindowFlags_NoBringToFrontOnFocus | ImGuiWindowFlags_NoScrollWithMouse);
  ImGui::PopStyleVar();
  const ImVec2 room = ImGui::GetContentRegionAvail();
  const float scale =
      std::min(room.x / static_cast<float>(lf_.width), room.y / static_cast<float>(lf_.height));
  const ImVec2 drawn{std::max(scale * static_cast<float>(lf_.width), 1.0F),
                     std::max(scale * static_cast<float>(lf_.height), 1.0F)};
  ImGui::SetCursorPos({(room.x - drawn.x) / 2, (room.y - drawn.y) / 2});
  const ImVec2 corner = ImGui::GetCursorScreenPos();
  ImGui::InvisibleButton("mouse", drawn,
                         ImGuiButtonFlags_MouseButtonLeft | ImGuiButtonFlags_MouseButtonRight);
  const bool changed = mouse(drawn.x, drawn.y);
  if (!shown_.view.colour.empty())
    ImGui::GetWindowDrawList()->AddImage(reinterpret_cast<ImTextureID>(static_cast<std::intptr_t>(texture_)),
                                         corner, {corner.x + drawn.x, corner.y + drawn.y});
  ImGui::End();
  return changed;
}

}  // namespace

void run_viewer(const LightFieldReader& reader, const ViewerState& start, const ViewerRun& run) {
  const Window window(reader.light_field());
  Viewer viewer(reader, start);
  int drawn = 0;
  while (!glfwWindowShouldClose(window.get())) {
    // At rest seldom: without a graphics card drawing the window takes time from rendering.
    glfwWaitEventsTimeout(run.frames == 0 && viewer.complete() ? kResting_s : kWorking_s);
    ImGui_ImplOpenGL3_NewFrame();
    ImGui_ImplGlfw_NewFrame();
    ImGui::NewFrame();
    viewer.draw();
    ImGui::Render();
    int width = 0, height = 0;
    glfwGetFramebufferSize(window.get(), &width, &height);
    glViewport(0, 0, width, height);
    glClearColor(0.06F, 0.06F, 0.07F, 1);
    glClear(GL_COLOR_BUFFER_BIT);
    ImGui_ImplOpenGL3_RenderDrawData(ImGui::GetDrawData());
    ++drawn;
    const bool last = run.frames > 0 && drawn >= run.frames && viewer.complete();
    if (last && !run.screenshot.empty()) write_image(run.screenshot, framebuffer(window.get()));
    glfwSwapBuffers(window.get());
    if (last) break;
  }
  if (run.frames > 0 && !viewer.problem().empty()) throw std::runtime_error(viewer.problem());
}

}  // namespace stuv
