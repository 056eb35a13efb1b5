// Triangle meshes: buffers owned by the scene, and the geometry of a point on a triangle.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "base/vec.h"

namespace matiere {

struct Mesh {
    std::vector<float> positions;  ///< 3 per vertex, plus one float of padding for Embree
    std::vector<std::uint32_t> indices;
    std::vector<float> normals;  ///< empty or 3 per vertex
    std::vector<float> uv;       ///< empty or 2 per vertex
    std::vector<float> uv1;      ///< the second set: empty or 2 per vertex
    int material = -1;           ///< -1: emits only, scatters nothing
    int light = -1;              ///< index of the light this mesh is, if any

    std::size_t triangle_count() const { return indices.size() / 3; }
    std::array<std::uint32_t, 3> triangle(std::size_t i) const {
        return {indices[3 * i], indices[3 * i + 1], indices[3 * i + 2]};
    }
    Vec3f position(std::uint32_t v) const {
        const float* p = &positions[std::size_t(v) * 3];
        return {p[0], p[1], p[2]};
    }
    Vec3f normal(std::uint32_t v) const {
        const float* p = &normals[std::size_t(v) * 3];
        return {p[0], p[1], p[2]};
    }
    Vec2f texcoord(std::uint32_t v) const { return pair(uv, v); }
    Vec2f texcoord1(std::uint32_t v) const { return pair(uv1, v); }

 private:
    static Vec2f pair(const std::vector<float>& values, std::uint32_t v) {
        const float* p = &values[std::size_t(v) * 2];
        return {p[0], p[1]};
    }
};

/// Twice the area times the unit normal, from double edges: exact enough for needles.
inline Vec3d triangle_cross(const Mesh& mesh, std::size_t i) {
    const auto [a, b, c] = mesh.triangle(i);
    const Vec3d p0 = vec_cast<double>(mesh.position(a));
    return cross(vec_cast<double>(mesh.position(b)) - p0, vec_cast<double>(mesh.position(c)) - p0);
}

inline double triangle_area(const Mesh& mesh, std::size_t i) {
    return 0.5 * length(triangle_cross(mesh, i));
}

}  // namespace matiere
