// Shading normals from textures: tangent-space normal maps (as glTF 2.0 and Blender write them: x
// along u, y along v, z out of the surface, n = 2 rgb - 1) and bump maps (Blinn 1978).
// A mapped normal stays on the outside of the geometric one, and is bent towards the viewer where
// it would face away (`material.cpp`), so no pixel of a lit side turns black by itself. Directions
// between the shading and the geometric horizon scatter nothing on either side: no light leaks,
// some energy is lost at grazing. Only the first channel of a bump map counts.
#pragma once

#include <cmath>

#include "material/surface_point.h"
#include "texture/texture.h"

namespace matiere {

/// Least cosine between a mapped and the geometric normal.
inline constexpr float kMinMappedCosine = 1e-3F;

inline Vec3f kept_outside(Vec3f n, Vec3f n_g) {
    const float c = dot(n, n_g);
    return normalize(c >= kMinMappedCosine ? n : n + n_g * (kMinMappedCosine - c));
}

/// The frame of a map's own coordinates: of its uv set, turned and stretched by its transform.
inline UvFrame map_frame(const ImageTexture& map, const SurfacePoint& point) {
    UvFrame frame = point.frame(map.uv_set());
    const UvTransform& t = map.transform();
    frame.uv = map.coordinates(frame.uv);
    if (t.is_identity()) return frame;
    const float inverse = 1.0F / t.determinant();
    const Vec3f dpdu = frame.dpdu, dpdv = frame.dpdv;
    frame.dpdu = (dpdu * t.d - dpdv * t.c) * inverse;
    frame.dpdv = (dpdv * t.a - dpdu * t.b) * inverse;
    return frame;
}

/// `n` is the interpolated normal. A shape without texture coordinates keeps it.
inline Vec3f map_normal(const ImageTexture& map, const SurfacePoint& point, Vec3f n) {
    const UvFrame frame = map_frame(map, point);
    const Vec3f tangent = frame.dpdu - n * dot(n, frame.dpdu);
    const float l2 = length_squared(tangent);
    if (!(l2 > 0.0F) || !std::isfinite(l2)) return n;
    const Vec3f t = tangent * (1.0F / std::sqrt(l2));
    const Vec3f across = cross(n, t);
    // Mirrored texture coordinates turn the bitangent over.
    const Vec3f b = dot(across, frame.dpdv) < 0.0F ? -across : across;
    const Spectrumf rgb = map.fine_at(frame.uv);
    const Vec3f m =
        t * (2.0F * rgb[0] - 1.0F) + b * (2.0F * rgb[1] - 1.0F) + n * (2.0F * rgb[2] - 1.0F);
    if (!(length_squared(m) > 1e-12F)) return n;
    return kept_outside(normalize(m), point.n_g);
}

/// n - grad h, h the height over the surface; its slope by differences over one texel.
inline Vec3f bump_normal(const ImageTexture& map, float height, const SurfacePoint& point,
                         Vec3f n) {
    const UvFrame frame = map_frame(map, point);
    const Vec3f along_u = cross(frame.dpdv, n), along_v = cross(n, frame.dpdu);
    const float area = dot(frame.dpdu, along_u) * frame.uv_scale;
    if (area == 0.0F || !std::isfinite(area)) return n;
    const float du = 0.5F / float(map.width()), dv = 0.5F / float(map.height());
    const auto h = [&](float u, float v) {
        return map.bilinear_at({frame.uv.x + u, frame.uv.y + v})[0];
    };
    const float h_u = (h(du, 0) - h(-du, 0)) * float(map.width());
    const float h_v = (h(0, dv) - h(0, -dv)) * float(map.height());
    const Vec3f bumped = n - (along_u * h_u + along_v * h_v) * (height / area);
    const float l2 = length_squared(bumped);
    if (!std::isfinite(l2)) return n;
    return kept_outside(bumped * (1.0F / std::sqrt(l2)), point.n_g);
}

}  // namespace matiere
