// Pinhole and thin-lens cameras.
#pragma once

#include "base/frame.h"
#include "base/vec.h"

namespace matiere {

struct CameraRay {
    Vec3f origin, direction;  ///< direction is unit
};

/// x grows to the right, y downwards; the film plane lies at unit distance.
class Camera {
 public:
    /// Basis in double; `aspect` is width over height; aperture 0 is a pinhole.
    Camera(Vec3d origin, Vec3d target, Vec3d up, double vfov_deg, double aperture_radius,
           double focus_distance, int width, int height);

    /// Raster position in pixels of the whole film, lens sample in [0, 1)^2.
    CameraRay ray(Vec2f raster, Vec2f lens) const;
    Vec3f origin() const { return origin_; }

 private:
    Vec3f origin_;
    Vec3f right_, up_, forward_;
    float scale_;  ///< film-plane metres per pixel
    float half_width_, half_height_;
    float aperture_radius_, focus_distance_;
};

}  // namespace matiere
