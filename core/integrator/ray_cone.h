// How wide a path is: a cone around its ray (Amanatides 1984; Akenine-Moller et al. 2019), wide
// enough for one number, the area of the surface that it covers. Pre-filtered textures read it.
//
// From the camera the cone is half a pixel wide: pixels are filtered by their samples anyway, and a
// wider one would blur twice. Mirrors and lenses keep its angle, as if they were flat. A scattered
// direction widens it to the solid angle that is one of kBounceSamples of its density: the others
// cover the rest. The area is the cone's over the cosine: textures seen at grazing angles are
// filtered between the short and the long side of what the cone covers.
#pragma once

#include <algorithm>
#include <cmath>

#include "camera/camera.h"
#include "material/surface_point.h"

namespace matiere {

class RayCone {
 public:
    explicit RayCone(const PixelFootprint& pixel)
        : width_(kPixelShare * pixel.width), spread_(kPixelShare * pixel.spread) {}

    /// At the end of `distance` metres along `direction`: what the cone covers there.
    void meet(SurfacePoint& point, float distance, Vec3f direction) {
        width_ += spread_ * distance;
        const float cosine = std::max(std::abs(dot(point.n_g, direction)), kLeastCosine);
        const float covered = width_ * width_ / cosine;
        set_area(point.first, covered);
        if (point.has_second) set_area(point.second, covered);
    }
    /// A direction was sampled with this density [1/sr].
    void scatter(float pdf) {
        spread_ = std::max(spread_, std::min(std::sqrt(kBounceAngle / pdf), kWidest));
    }

 private:
    static constexpr float kPixelShare = 0.5F;
    static constexpr float kBounceSamples = 64;
    /// Square of the spread of one steradian over kBounceSamples: 4 / (pi n).
    static constexpr float kBounceAngle = 4 * kInvPi<float> / kBounceSamples;
    static constexpr float kWidest = 0.5F;        ///< radians: beyond, a cone is none
    static constexpr float kLeastCosine = 1e-3F;  ///< edges of a silhouette

    static void set_area(UvFrame& frame, float covered) {
        const float per_uv =
            length(cross(frame.dpdu, frame.dpdv)) * frame.uv_scale * frame.uv_scale;
        frame.area = per_uv > 0 ? covered / per_uv : 0;
    }

    float width_, spread_;  ///< metres; metres per metre
};

/// Where a kernel reads no textures.
struct NoCone {
    explicit NoCone(const PixelFootprint&) {}
};

}  // namespace matiere
