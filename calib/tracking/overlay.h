#pragma once

#include "calib/tracking/object_model.h"
#include "core/camera.h"
#include "core/image.h"

namespace stuv::tracking {

/// The picture as 8 bit RGB with the model's visible edges drawn: green, or red if the object is lost. Lines
/// follow the lens. Without a model nothing is drawn.
Image draw_overlay(const Image& picture, const ObjectModel* model, const Camera& camera,
                   const Pose& cam_from_object, bool lost);

}  // namespace stuv::tracking
