// Cameras: what a point of the film looks at.
#pragma once

#include <optional>

#include "base/frame.h"
#include "base/vec.h"

namespace matiere {

enum class CameraType { kPinhole, kThinLens, kOrthographic, kPanorama, kMaterialProbe };

/// Lengths in metres, angles in degrees. The picture plane stands upright on the line from origin
/// to target, with `up` upwards in it.
struct CameraDescription {
    CameraType type = CameraType::kPinhole;
    Vec3d origin{0, 0, 1}, target{0, 0, 0}, up{0, 1, 0};
    double vfov_deg = 45;  ///< pinhole, thin lens: full vertical angle
    double height = 2;     ///< orthographic: of the whole film, in the scene
    double aperture_radius = 0, focus_distance = 1;     ///< thin lens
    int blades = 0;                                     ///< thin lens: 0 is round
    double blade_rotation_deg = 0, aperture_ratio = 1;  ///< thin lens; width over height
};

struct CameraRay {
    Vec3f origin, direction;  ///< direction is unit
    bool sees = true;         ///< false outside the picture of a material probe
};

/// How wide one pixel is: at the camera, and how fast that grows with the distance.
struct PixelFootprint {
    float width = 0, spread = 0;  ///< metres; metres per metre
};

/// How the camera sees a point of the scene: `ray` turned round, for paths that come from lights.
struct CameraSight {
    Vec3f p;           ///< the point of the camera that sees it
    Vec3f direction;   ///< unit, from the scene to p
    Vec2f raster;      ///< where on the film, in pixels
    float importance;  ///< pixels per area that faces the camera there [1/m^2]
};

/// x grows to the right, y downwards.
class Camera {
 public:
    /// Basis in double; width and height are the whole film's. Throws SceneError where the
    /// description has no basis.
    Camera(const CameraDescription& description, int width, int height);

    /// Raster position in pixels of the whole film, lens sample in [0, 1)^2.
    CameraRay ray(Vec2f raster, Vec2f lens) const;
    /// How a point is seen by the lens sample in [0, 1)^2; nothing where it is behind the camera.
    std::optional<CameraSight> sight(Vec3f point, Vec2f lens) const;
    /// Calls f(raster) for every place of the film, as far as `margin` pixels outside, whose ray is
    /// that of `raster`: a panorama goes on beyond its borders.
    template <class F>
    void for_each_image(Vec2f raster, float margin, F&& f) const {
        f(raster);
        if (type_ != CameraType::kPanorama) return;
        const auto turns = int(margin / width_) + 1;
        const auto around = [&](float x, float y, bool itself) {
            for (int k = -turns; k <= turns; ++k)
                if (!itself || k != 0) f(Vec2f{x + float(k) * width_, y});
        };
        around(raster.x, raster.y, true);
        around(raster.x + 0.5F * width_, -raster.y, false);
        around(raster.x + 0.5F * width_, 2 * height_ - raster.y, false);
    }
    /// False where no path from a light can be sent to the camera: every pixel sees one point.
    bool has_sight() const { return type_ != CameraType::kMaterialProbe; }
    Vec3f origin() const { return origin_; }
    PixelFootprint footprint() const;
    bool has_lens() const { return aperture_radius_ > 0; }

 private:
    CameraRay panorama(Vec2f raster) const;
    CameraRay probe(Vec2f raster) const;
    Vec2f aperture_point(Vec2f lens) const;

    CameraType type_;
    Vec3f origin_, target_;
    Vec3f right_, up_, forward_;
    float scale_;  ///< metres per pixel, on a film plane at unit distance where there is one
    float width_, height_, distance_;
    float aperture_radius_, focus_distance_;
    int blades_;
    float blade_rotation_, aperture_ratio_;
};

}  // namespace matiere
