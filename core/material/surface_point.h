// The place on a surface where a material is asked to scatter, in world space.
#pragma once

#include "base/vec.h"

namespace matiere {

struct SurfacePoint {
    Vec3f p;     ///< position [m]
    Vec3f n_g;   ///< geometric unit normal, on the outside of the shape
    Vec3f n_s;   ///< shading unit normal, within 90 degrees of n_g
    Vec3f dpdu;  ///< shading tangent; need not be unit or orthogonal, zero if the shape has none
    Vec3f dpdv;  ///< the same along v
    Vec2f uv;    ///< texture coordinates; v grows upwards
    float uv_scale = 1;  ///< dpdu and dpdv times this are metres per unit of u and v
};

}  // namespace matiere
