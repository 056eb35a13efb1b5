// The place on a surface where a material is asked to scatter, in world space.
#pragma once

#include "base/vec.h"
#include "texture/texture.h"

namespace matiere {

/// Texture coordinates of one set, and how they run over the surface.
struct UvFrame {
    Vec2f uv;            ///< v grows upwards
    Vec3f dpdu, dpdv;    ///< need not be unit or orthogonal, zero if the shape has none
    float uv_scale = 1;  ///< dpdu and dpdv times this are metres per unit of u and v
    float area = 0;      ///< uv area that the ray covers; 0: a point
};

struct SurfacePoint {
    Vec3f p;         ///< position [m]
    Vec3f n_g;       ///< geometric unit normal, on the outside of the shape
    Vec3f n_s;       ///< shading unit normal, within 90 degrees of n_g
    UvFrame first;   ///< uv set 0; its dpdu is the tangent of lobes that are wider one way
    UvFrame second;  ///< uv set 1
    bool has_second = false;

    /// The frame of a set; a shape without a second one has the first for both.
    const UvFrame& frame(int set) const { return set == 1 && has_second ? second : first; }
    TexturePoint texture_point() const {
        return {{first.uv, frame(1).uv}, {first.area, frame(1).area}};
    }
};

}  // namespace matiere
