// Cameras: what a point of the film looks at.
#pragma once

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

/// x grows to the right, y downwards.
class Camera {
 public:
    /// Basis in double; width and height are the whole film's. Throws SceneError where the
    /// description has no basis.
    Camera(const CameraDescription& description, int width, int height);

    /// Raster position in pixels of the whole film, lens sample in [0, 1)^2.
    CameraRay ray(Vec2f raster, Vec2f lens) const;
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
