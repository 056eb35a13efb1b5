#include <algorithm>
#include <cmath>

#include "camera/camera.h"

namespace matiere {

std::optional<CameraSight> Camera::sight(Vec3f point, Vec2f lens) const {
    const Vec3f to = point - origin_;
    if (type_ == CameraType::kMaterialProbe) return std::nullopt;
    if (type_ == CameraType::kPanorama) {
        const float d2 = length_squared(to);
        if (!(d2 > 0)) return std::nullopt;
        const Vec3f d = to * (1 / std::sqrt(d2));
        const float up = std::clamp(dot(d, up_), -1.0F, 1.0F);
        const float phi = std::atan2(dot(d, right_), dot(d, forward_));
        const Vec2f raster{width_ * (phi / kTwoPi<float> + 0.5F),
                           height_ * (std::acos(up) / kPi<float>)};
        const float sine = safe_sqrt((1 - up) * (1 + up));
        if (!(sine > 0)) return std::nullopt;
        const float per_angle = width_ * height_ / (2 * kPi<float> * kPi<float> * sine);
        return CameraSight{origin_, -d, raster, per_angle / d2};
    }
    const auto raster = [&](float x, float y) {
        return Vec2f{x / scale_ + 0.5F * width_, 0.5F * height_ - y / scale_};
    };
    if (type_ == CameraType::kOrthographic) {
        const float z = dot(to, forward_);
        if (!(z > 0)) return std::nullopt;
        return CameraSight{point - forward_ * z, -forward_, raster(dot(to, right_), dot(to, up_)),
                           1 / (scale_ * scale_)};
    }
    // A point of the aperture sees the plane in focus as a pinhole at the origin would.
    Vec2f d{0, 0};
    if (aperture_radius_ > 0) d = aperture_point(lens) * aperture_radius_;
    const Vec3f p = origin_ + right_ * d.x + up_ * d.y;
    const Vec3f from_lens = point - p;
    const float z = dot(from_lens, forward_);
    if (!(z > 0)) return std::nullopt;
    const float shift = aperture_radius_ > 0 ? 1 / focus_distance_ : 0;
    const float distance = length(from_lens);
    return CameraSight{
        p, from_lens * (-1 / distance),
        raster(dot(from_lens, right_) / z + d.x * shift, dot(from_lens, up_) / z + d.y * shift),
        distance / (scale_ * scale_ * z * z * z)};
}

}  // namespace matiere
