// Light sampling on shapes: parallelograms, triangle meshes and spheres.
#pragma once

#include <cmath>
#include <optional>
#include <vector>

#include "base/frame.h"
#include "base/vec.h"
#include "light/light_tree.h"
#include "sampling/discrete.h"
#include "sampling/sampler.h"
#include "shape/mesh.h"
#include "shape/sphere.h"
#include "texture/texture.h"

namespace matiere {

/// A point on a light, chosen for a reference point.
struct ShapeSample {
    Vec3f p, n;
    Vec3f error;         ///< absolute bound on the rounding of p
    Vec2f uv;            ///< texture coordinates
    float pdf;           ///< per solid angle at the reference point
    Vec2f uv1{};         ///< of the second set; `uv` where the shape has none
    float pdf_area = 0;  ///< per area, of meshes alone

    TexturePoint texture_point() const { return {{uv, uv1}, {}}; }
};

/// Converts a density per area into one per solid angle; zero at grazing and coincident points.
inline float area_to_solid_angle(float pdf_area, Vec3f to_light, Vec3f n) {
    const float d2 = length_squared(to_light);
    const float cos_light = std::abs(dot(to_light, n)) / std::sqrt(d2);
    const float pdf = pdf_area * d2 / cos_light;
    return std::isfinite(pdf) ? pdf : 0.0F;
}

struct RectangleShape {
    Vec3f corner, edge_u, edge_v, n;
    float area;

    RectangleShape(Vec3f c, Vec3f u, Vec3f v) : corner(c), edge_u(u), edge_v(v) {
        const Vec3d w = cross(vec_cast<double>(u), vec_cast<double>(v));
        area = float(length(w));
        n = vec_cast<float>(normalize(w));
    }
    ShapeSample sample(Vec3f reference, const SampleBlock& u) const {
        const Vec2f s = u.uniform2(1);
        const Vec3f p = corner + edge_u * s.x + edge_v * s.y;
        const Vec3f error = (abs(corner) + abs(edge_u) + abs(edge_v)) * gamma_bound<float>(6);
        return {p, n, error, s, area_to_solid_angle(1 / area, p - reference, n)};
    }
    float pdf(Vec3f reference, Vec3f p) const {
        return area_to_solid_angle(1 / area, p - reference, n);
    }
};

/// Triangles chosen by area times `weight` (mean emission), points uniform on them.
class MeshShape {
 public:
    MeshShape(const Mesh& mesh, const std::vector<double>& weight);
    std::optional<ShapeSample> sample(Vec3f reference, const SampleBlock& u) const;
    float pdf(Vec3f reference, std::uint32_t triangle, Vec3f p, Vec3f n) const;
    double area() const { return area_; }
    /// Adds the triangles that shine, and sets the cone of their normals.
    void bound(LightBounds& bounds) const;

 private:
    const Mesh* mesh_;
    DiscreteDistribution triangles_;
    std::vector<float> pdf_area_;
    double area_ = 0;
};

struct SphereShape {
    Sphere sphere;
    /// Uniform in the cone of directions from outside, uniform on the surface from inside.
    ShapeSample sample(Vec3f reference, const SampleBlock& u) const;
    float pdf(Vec3f reference, Vec3f p, Vec3f n) const;

 private:
    /// sin^2 of the half angle of the cone that holds the sphere; 1 inside and so near the surface
    /// that rounding could not tell: there the whole surface is sampled.
    float sin2_cone(Vec3f reference) const {
        constexpr float kNearSurface = 1 - 0x1p-10F;
        const float d2 = length_squared(reference - sphere.center);
        const float sin2 = sphere.radius * sphere.radius / d2;
        return sin2 < kNearSurface ? sin2 : 1.0F;
    }
};

}  // namespace matiere
