#include "camera/camera.h"

#include <algorithm>
#include <cmath>

#include "base/error.h"
#include "sampling/warp.h"

namespace matiere {

namespace {

double metres_per_pixel(const CameraDescription& d, int height) {
    if (d.type == CameraType::kOrthographic) return d.height / double(height);
    return 2 * std::tan(0.5 * d.vfov_deg * kPi<double> / 180) / double(height);
}

}  // namespace

Camera::Camera(const CameraDescription& d, int width, int height)
    : type_(d.type),
      origin_(vec_cast<float>(d.origin)),
      target_(vec_cast<float>(d.target)),
      scale_(float(metres_per_pixel(d, height))),
      width_(float(width)),
      height_(float(height)),
      aperture_radius_(d.type == CameraType::kThinLens ? float(d.aperture_radius) : 0.0F),
      focus_distance_(float(d.focus_distance)),
      blades_(d.blades),
      blade_rotation_(float(d.blade_rotation_deg * kPi<double> / 180)),
      aperture_ratio_(float(d.aperture_ratio)) {
    const Vec3d forward = d.target - d.origin;
    const double distance = length(forward);
    if (!(distance > 0))
        throw SceneError("camera_target", "camera origin and target are the same point",
                         "/camera/target");
    const Vec3d f = forward / distance;
    const Vec3d right = cross(f, d.up);
    if (!(length(right) > 1e-9 * length(d.up)))
        throw SceneError("camera_up", "camera up is parallel to the view direction", "/camera/up");
    const Vec3d r = normalize(right);
    right_ = vec_cast<float>(r);
    up_ = vec_cast<float>(cross(r, f));
    forward_ = vec_cast<float>(f);
    distance_ = float(distance);
}

CameraRay Camera::ray(Vec2f raster, Vec2f lens) const {
    if (type_ == CameraType::kPanorama) return panorama(raster);
    if (type_ == CameraType::kMaterialProbe) return probe(raster);
    const float x = (raster.x - 0.5F * width_) * scale_, y = (0.5F * height_ - raster.y) * scale_;
    if (type_ == CameraType::kOrthographic) return {origin_ + right_ * x + up_ * y, forward_};
    const Vec3f through = right_ * x + up_ * y + forward_;
    if (aperture_radius_ <= 0) return {origin_, normalize(through)};
    const Vec2f d = aperture_point(lens);
    const Vec3f offset = right_ * (d.x * aperture_radius_) + up_ * (d.y * aperture_radius_);
    return {origin_ + offset, normalize(through * focus_distance_ - offset)};
}

PixelFootprint Camera::footprint() const {
    switch (type_) {
        case CameraType::kOrthographic:
            return {scale_, 0};
        case CameraType::kPanorama:
            return {0, kPi<float> / height_};
        case CameraType::kMaterialProbe:
            return {};  // all pixels look at one point
        default:
            return {0, scale_};
    }
}

/// The whole sphere by longitude and latitude, forward in the middle.
CameraRay Camera::panorama(Vec2f raster) const {
    const float phi = 2 * kPi<float> * (raster.x / width_ - 0.5F);
    const float theta = kPi<float> * raster.y / height_;
    const float s = std::sin(theta);
    const Vec3f d =
        right_ * (s * std::sin(phi)) + up_ * std::cos(theta) + forward_ * (s * std::cos(phi));
    return {origin_, normalize(d)};
}

/// The hemisphere of directions from which the target can be seen, as an equal-area disk (Lambert
/// 1772): every pixel looks at the same point.
CameraRay Camera::probe(Vec2f raster) const {
    const float radius = 0.5F * std::min(width_, height_);
    const float x = (raster.x - 0.5F * width_) / radius, y = (0.5F * height_ - raster.y) / radius;
    const float r2 = x * x + y * y;
    if (r2 >= 1) return {origin_, forward_, false};
    const float s = std::sqrt(2 - r2);
    const Vec3f away = normalize(right_ * (x * s) + up_ * (y * s) - forward_ * (1 - r2));
    return {target_ + away * distance_, -away};
}

Vec2f Camera::aperture_point(Vec2f lens) const {
    if (blades_ == 0) {
        const Vec2f d = square_to_disk(lens.x, lens.y);
        return {d.x * aperture_ratio_, d.y};
    }
    const float n = float(blades_), sector = std::min(std::floor(lens.x * n), n - 1);
    const float a = std::sqrt(lens.x * n - sector), b = a * lens.y;
    const float step = 2 * kPi<float> / n, t0 = blade_rotation_ + sector * step, t1 = t0 + step;
    return {((a - b) * std::cos(t0) + b * std::cos(t1)) * aperture_ratio_,
            (a - b) * std::sin(t0) + b * std::sin(t1)};
}

}  // namespace matiere
