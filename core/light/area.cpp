#include "light/area.h"

#include <algorithm>

namespace matiere {

MeshShape::MeshShape(const Mesh& mesh, const std::vector<double>& weight) : mesh_(&mesh) {
    const std::size_t n = mesh.triangle_count();
    std::vector<double> areas(n), weights(n);
    for (std::size_t i = 0; i < n; ++i) {
        areas[i] = triangle_area(mesh, i);
        weights[i] = areas[i] * weight[i];
        area_ += areas[i];
    }
    triangles_ = DiscreteDistribution(weights);
    pdf_area_.resize(n);
    for (std::size_t i = 0; i < n && !triangles_.empty(); ++i)
        pdf_area_[i] = areas[i] > 0 ? float(double(triangles_.probability(i)) / areas[i]) : 0.0F;
}

std::optional<ShapeSample> MeshShape::sample(Vec3f reference, const SampleBlock& u) const {
    if (triangles_.empty()) return std::nullopt;
    const auto choice = triangles_.sample(u.bits[3]);
    const auto [a, b, c] = mesh_->triangle(choice.index);
    const Vec3f p0 = mesh_->position(a), p1 = mesh_->position(b), p2 = mesh_->position(c);

    // Uniform barycentrics by folding the unit square along its diagonal without a square root
    // (Heitz 2019, "A Low-Distortion Map Between Triangle and Square").
    Vec2f s = u.uniform2(1);
    if (s.y > s.x) {
        s.x *= 0.5F;
        s.y -= s.x;
    } else {
        s.y *= 0.5F;
        s.x -= s.y;
    }
    const float w0 = 1 - s.x - s.y;
    const Vec3f p = p0 * w0 + p1 * s.x + p2 * s.y;
    const Vec3f error = (abs(p0) + abs(p1) + abs(p2)) * gamma_bound<float>(6);
    const Vec3f n = vec_cast<float>(normalize(triangle_cross(*mesh_, choice.index)));
    Vec2f uv{s.x, s.y};
    if (!mesh_->uv.empty())
        uv = mesh_->texcoord(a) * w0 + mesh_->texcoord(b) * s.x + mesh_->texcoord(c) * s.y;
    Vec2f uv1 = uv;
    if (!mesh_->uv1.empty())
        uv1 = mesh_->texcoord1(a) * w0 + mesh_->texcoord1(b) * s.x + mesh_->texcoord1(c) * s.y;
    return ShapeSample{p,
                       n,
                       error,
                       uv,
                       area_to_solid_angle(pdf_area_[choice.index], p - reference, n),
                       uv1,
                       pdf_area_[choice.index]};
}

float MeshShape::pdf(Vec3f reference, std::uint32_t triangle, Vec3f p, Vec3f n) const {
    return area_to_solid_angle(pdf_area_[triangle], p - reference, n);
}

void MeshShape::bound(LightBounds& bounds) const {
    Vec3d sum;
    for (std::size_t i = 0; i < mesh_->triangle_count(); ++i) {
        if (!(pdf_area_[i] > 0)) continue;
        for (const std::uint32_t v : mesh_->triangle(i)) bounds.grow(mesh_->position(v));
        sum = sum + triangle_cross(*mesh_, i);
    }
    bounds.cos_normal = -1;
    if (!(length(sum) > 1e-6 * area_)) return;  // closed: all directions
    const Vec3d axis = normalize(sum);
    double least = 1;
    for (std::size_t i = 0; i < mesh_->triangle_count(); ++i)
        if (pdf_area_[i] > 0)
            least = std::min(least, dot(axis, normalize(triangle_cross(*mesh_, i))));
    bounds.axis = vec_cast<float>(axis);
    bounds.cos_normal = float(least);
}

ShapeSample SphereShape::sample(Vec3f reference, const SampleBlock& u) const {
    const Vec3f to_center = sphere.center - reference;
    const float sin2_max = sin2_cone(reference);
    const Vec2f s = u.uniform2(1);
    const float phi = kTwoPi<float> * s.y;
    Vec3f n;
    if (sin2_max < 1) {
        // 1 - cos of the cone angle without cancellation, then the point where the chosen direction
        // enters the sphere, as a normal seen from the centre (Pharr, Jakob, Humphreys
        // 2023, 6.2.4).
        const float cos_max = safe_sqrt(1 - sin2_max);
        const float one_minus_cos = s.x * sin2_max / (1 + cos_max);
        const float sin2 = one_minus_cos * (2 - one_minus_cos), cos_theta = 1 - one_minus_cos;
        const float cos_alpha =
            sin2 / std::sqrt(sin2_max) + cos_theta * safe_sqrt(1 - sin2 / sin2_max);
        const float sin_alpha = safe_sqrt(1 - cos_alpha * cos_alpha);
        const Framef frame = Framef::from_normal(normalize(to_center));
        n = frame.to_world({sin_alpha * std::cos(phi), sin_alpha * std::sin(phi), -cos_alpha});
    } else {
        const float z = 1 - 2 * s.x, r = 2 * std::sqrt(s.x * (1 - s.x));
        n = {r * std::cos(phi), r * std::sin(phi), z};
    }
    n = normalize(n);
    const Vec3f p = sphere.center + n * sphere.radius;
    const Vec3f error = (abs(sphere.center) + abs(n) * sphere.radius) * gamma_bound<float>(6);
    return {p, n, error, {}, pdf(reference, p, n)};
}

float SphereShape::pdf(Vec3f reference, Vec3f p, Vec3f n) const {
    const float sin2_max = sin2_cone(reference);
    if (sin2_max < 1) {
        const float one_minus_cos_max = sin2_max / (1 + safe_sqrt(1 - sin2_max));
        return 1 / (kTwoPi<float> * one_minus_cos_max);
    }
    const float area = 4 * kPi<float> * sphere.radius * sphere.radius;
    return area_to_solid_angle(1 / area, p - reference, n);
}

}  // namespace matiere
