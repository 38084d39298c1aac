#pragma once

#include <memory>
#include <string>
#include <vector>

#include "core/progress.h"
#include "core/view.h"
#include "render/view_set.h"

namespace stuv {

/// Makes pictures of one light field by one method on one back end.
class Renderer {
 public:
  virtual ~Renderer() = default;
  /// All-in-focus synthesis (all_in_focus.h). Throws std::invalid_argument as validate() does.
  virtual RenderedView all_in_focus(const Viewpoint& view, const RenderOptions& options,
                                    const Reporter& reporter = {}) = 0;
  /// The view on one focal plane in the same form: plane 0, confidence = coverage inside the hull.
  virtual RenderedView focal_plane(const Viewpoint& view, double d_px, Filter filter) = 0;
  /// Reads the pixels that a picture needs, where they are read as needed.
  virtual void load(const Viewpoint& view, const RenderOptions& options);
  /// Forgets what earlier pictures taught (`fast` uses it for the next one).
  virtual void forget() {}
};

enum class Method {
  literal,  ///< the paper's equations as they stand, the reference
  exact,    ///< the same picture, fast
  fast      ///< skips what the scene does not need
};
enum class Backend { cpu, gl };

const char* name_of(Method method);
const char* name_of(Backend backend);
/// Throw std::invalid_argument naming what there is.
Method method_from_name(const std::string& name);
Backend backend_from_name(const std::string& name);
/// Whether the method runs there: `fast` on the CPU only.
bool exists(Method method, Backend backend);

/// `reader` must outlive the renderer. Views named in `leave_out` become holes of the lattice. Throws Error
/// if a picture cannot be read, or if this machine has no OpenGL 4.5 for Backend::gl.
std::unique_ptr<Renderer> make_renderer(Method method, Backend backend, const LightFieldReader& reader,
                                        const std::vector<std::string>& leave_out = {});
/// Of views in memory or on disk.
std::unique_ptr<Renderer> make_renderer(Method method, Backend backend, std::shared_ptr<const ViewSet> views);

}  // namespace stuv
