#pragma once

#include <condition_variable>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <thread>
#include <utility>

#include "app/viewer/view_controls.h"

namespace stuv {

/// Renders in a thread of its own, one picture at a time; of the requests that wait only the newest counts.
class RenderWorker {
 public:
  struct Request {
    ViewerState state;
    int shrink = 1;
  };
  struct Result {
    Request request;
    RenderedView view;
    std::string problem;  ///< instead of a picture
  };

  explicit RenderWorker(const LightFieldReader& reader);
  ~RenderWorker();
  RenderWorker(const RenderWorker&) = delete;
  RenderWorker& operator=(const RenderWorker&) = delete;

  /// Takes the place of a request that waits. A picture that has been in work for long is given up, unless it
  /// is as good as done.
  void submit(const Request& request);
  /// The newest picture that is done, once.
  std::optional<Result> take();
  /// Nothing waits, is in work or has not been taken.
  bool idle() const;
  /// Part of the picture in work that is done, 0..1.
  double progress() const;

 private:
  void run();
  Result render(const Request& request);

  const LightFieldReader& reader_;
  // One at a time: `literal` holds all pictures in memory, OpenGL its textures.
  std::unique_ptr<Renderer> renderer_;
  std::pair<Method, Backend> made_{};
  mutable std::mutex mutex_;
  std::condition_variable wake_;
  std::optional<Request> waiting_;
  std::optional<Result> done_;
  bool working_ = false, give_up_ = false, stop_ = false;
  double progress_ = 0;
  std::thread thread_;
};

}  // namespace stuv
