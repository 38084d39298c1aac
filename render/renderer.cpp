#include "render/renderer.h"

#include <stdexcept>

#include "render/all_in_focus.h"
#include "render/cpu/fast_renderer.h"
#include "render/cpu/sweep_renderer.h"
#include "render/gl/gl_renderer.h"

namespace stuv {

void Renderer::load(const Viewpoint&, const RenderOptions&) {}

const char* name_of(Method method) {
  return method == Method::literal ? "literal" : method == Method::exact ? "exact" : "fast";
}

const char* name_of(Backend backend) { return backend == Backend::cpu ? "cpu" : "gl"; }

Method method_from_name(const std::string& name) {
  for (const Method method : {Method::literal, Method::exact, Method::fast})
    if (name == name_of(method)) return method;
  throw std::invalid_argument("there is no method '" + name + "'; there are literal, exact, fast");
}

bool exists(Method method, Backend backend) { return method != Method::fast || backend == Backend::cpu; }

Backend backend_from_name(const std::string& name) {
  for (const Backend backend : {Backend::cpu, Backend::gl})
    if (name == name_of(backend)) return backend;
  throw std::invalid_argument("there is no back end '" + name + "'; there are cpu, gl");
}

std::unique_ptr<Renderer> make_renderer(Method method, Backend backend,
                                        std::shared_ptr<const ViewSet> views) {
  if (!exists(method, backend))
    throw std::invalid_argument("method fast runs on the CPU; use exact with OpenGL");
  if (method == Method::literal)
    return make_literal_renderer(backend == Backend::gl ? make_gl_renderer(std::move(views))
                                                        : make_cpu_renderer(std::move(views)));
  if (backend == Backend::gl) return make_gl_exact_renderer(std::move(views));
  if (method == Method::fast) return make_cpu_fast_renderer(std::move(views));
  return make_cpu_exact_renderer(std::move(views));
}

std::unique_ptr<Renderer> make_renderer(Method method, Backend backend, const LightFieldReader& reader,
                                        const std::vector<std::string>& leave_out) {
  return make_renderer(
      method, backend,
      method == Method::literal ? load_views(reader, leave_out) : open_views(reader, leave_out));
}

}  // namespace stuv
