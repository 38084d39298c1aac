#include "app/viewer/render_worker.h"

#include <chrono>
#include <exception>
#include <new>

namespace stuv {
namespace {

/// Thrown through a renderer by its own reporter.
struct GivenUp : std::exception {};

/// A picture is given up for a newer one only after this time: else none would be finished during a drag.
constexpr std::chrono::milliseconds kPatience{300};

}  // namespace

RenderWorker::RenderWorker(const LightFieldReader& reader) : reader_(reader), thread_([this] { run(); }) {}

RenderWorker::~RenderWorker() {
  {
    const std::lock_guard lock(mutex_);
    stop_ = give_up_ = true;
  }
  wake_.notify_all();
  thread_.join();
}

void RenderWorker::submit(const Request& request) {
  {
    const std::lock_guard lock(mutex_);
    waiting_ = request;
    give_up_ = working_;
  }
  wake_.notify_all();
}

std::optional<RenderWorker::Result> RenderWorker::take() {
  const std::lock_guard lock(mutex_);
  return std::exchange(done_, std::nullopt);
}

bool RenderWorker::idle() const {
  const std::lock_guard lock(mutex_);
  return !waiting_ && !working_ && !done_;
}

double RenderWorker::progress() const {
  const std::lock_guard lock(mutex_);
  return progress_;
}

void RenderWorker::run() {
  std::unique_lock lock(mutex_);
  while (true) {
    wake_.wait(lock, [&] { return stop_ || waiting_; });
    if (stop_) break;
    const Request request = *std::exchange(waiting_, std::nullopt);
    working_ = true;
    give_up_ = false;
    progress_ = 0;
    lock.unlock();
    std::optional<Result> result;
    try {
      result = render(request);
    } catch (const GivenUp&) {
    } catch (const std::bad_alloc&) {
      result = Result{request, {}, "out of memory; choose another method or fewer planes"};
    } catch (const std::exception& e) {
      result = Result{request, {}, e.what()};
    }
    lock.lock();
    working_ = false;
    if (result) done_ = std::move(result);
  }
  // A renderer of OpenGL ends where it was made.
  renderer_.reset();
}

RenderWorker::Result RenderWorker::render(const Request& request) {
  const ViewerState& state = request.state;
  const std::pair wanted(state.method, state.backend);
  if (!renderer_ || made_ != wanted) {
    renderer_.reset();
    renderer_ = make_renderer(state.method, state.backend, reader_);
    made_ = wanted;
  }
  const Viewpoint view = viewpoint_of(state, reader_.light_field(), request.shrink);
  const auto start = std::chrono::steady_clock::now();
  Reporter reporter;
  reporter.progress = [&](std::string_view, std::size_t done, std::size_t total) {
    const std::lock_guard lock(mutex_);
    progress_ = static_cast<double>(done) / static_cast<double>(total);
    const bool late = give_up_ && std::chrono::steady_clock::now() - start > kPatience;
    if (stop_ || (late && done < total)) throw GivenUp();
  };
  Result out{request, {}, {}};
  out.view = state.all_in_focus ? renderer_->all_in_focus(view, state.options, reporter)
                                : renderer_->focal_plane(view, state.focus_px, state.options.k);
  return out;
}

}  // namespace stuv
