#include "camera/camera.h"

#include <cmath>

#include "base/error.h"
#include "sampling/warp.h"

namespace matiere {

Camera::Camera(Vec3d origin, Vec3d target, Vec3d up, double vfov_deg, double aperture_radius,
               double focus_distance, int width, int height)
    : origin_(vec_cast<float>(origin)),
      half_width_(0.5F * float(width)),
      half_height_(0.5F * float(height)),
      aperture_radius_(float(aperture_radius)),
      focus_distance_(float(focus_distance)) {
    const Vec3d forward = target - origin;
    const double distance = length(forward);
    if (!(distance > 0))
        throw SceneError("camera_target", "camera origin and target are the same point",
                         "/camera/target");
    const Vec3d f = forward / distance;
    const Vec3d right = cross(f, up);
    if (!(length(right) > 1e-9 * length(up)))
        throw SceneError("camera_up", "camera up is parallel to the view direction", "/camera/up");
    const Vec3d r = normalize(right);
    right_ = vec_cast<float>(r);
    up_ = vec_cast<float>(cross(r, f));
    forward_ = vec_cast<float>(f);
    scale_ = float(2 * std::tan(0.5 * vfov_deg * kPi<double> / 180) / double(height));
}

CameraRay Camera::ray(Vec2f raster, Vec2f lens) const {
    const float x = (raster.x - half_width_) * scale_, y = (half_height_ - raster.y) * scale_;
    const Vec3f through = right_ * x + up_ * y + forward_;
    if (aperture_radius_ <= 0) return {origin_, normalize(through)};
    const Vec2f d = square_to_disk(lens.x, lens.y);
    const Vec3f offset = right_ * (d.x * aperture_radius_) + up_ * (d.y * aperture_radius_);
    return {origin_ + offset, normalize(through * focus_distance_ - offset)};
}

}  // namespace matiere
