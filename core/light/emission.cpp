#include "light/emission.h"

#include <algorithm>
#include <cmath>

#include "sampling/warp.h"

namespace matiere {

namespace {

template <class... F>
struct Overload : F... {
    using F::operator()...;
};

/// Directions from p to a ball: a cone, or everything from inside.
struct Cone {
    Vec3f axis{0, 0, 1};
    float one_minus_cos = 2;

    Cone(Vec3f a, float one_minus) : axis(a), one_minus_cos(one_minus) {}
    Cone(Vec3f p, const Ball& ball) {
        const Vec3f to = ball.center - p;
        const float d2 = length_squared(to), r2 = ball.radius * ball.radius;
        if (!(d2 > r2)) return;
        axis = to * (1 / std::sqrt(d2));
        const float sin2 = r2 / d2;
        one_minus_cos = sin2 / (1 + std::sqrt(1 - sin2));
    }
    bool everything() const { return one_minus_cos >= 2; }
    float solid_angle() const { return kTwoPi<float> * one_minus_cos; }
    Vec3f sample(Vec2f u) const {
        const float t = u.x * one_minus_cos;
        const float sine = safe_sqrt(t * (2 - t)), phi = kTwoPi<float> * u.y;
        return normalize(Framef::from_normal(axis).to_world(
            {sine * std::cos(phi), sine * std::sin(phi), 1 - t}));
    }
};

/// The directions worth a try: to the ball, or into the light's own cone where that is narrower.
Cone lit_cone(const PointLight& l, const Ball& ball) { return {l.position, ball}; }
Cone lit_cone(const SpotLight& l, const Ball& ball) {
    const Cone cone(l.position, ball);
    return 1 - l.cos_outer < cone.one_minus_cos ? Cone(l.direction, 1 - l.cos_outer) : cone;
}

Cone lit_cone(const ProfileLight& l, const Ball& ball) { return lit_cone(l.spot, ball); }

Vec3f place_of(const PointLight& l) { return l.position; }
Vec3f place_of(const SpotLight& l) { return l.position; }
Vec3f place_of(const ProfileLight& l) { return l.spot.position; }

Spectrumf towards(const PointLight& l, Vec3f) { return l.intensity; }
Spectrumf towards(const SpotLight& l, Vec3f direction) {
    return l.intensity * l.falloff(direction);
}
Spectrumf towards(const ProfileLight& l, Vec3f direction) {
    return l.spot.intensity * l.share(direction);
}

/// Intensity in the mean over the directions that a spot shines to.
double mean_intensity(const PointLight& l) { return double(l.intensity.luminance()); }
double mean_intensity(const SpotLight& l) { return double(l.intensity.luminance()); }
double mean_intensity(const ProfileLight& l) {
    const double cone = kTwoPi<double> * std::min(1.0 - double(l.spot.cos_outer), 2.0);
    const double flux = l.profile->flux(double(l.spot.cos_outer));
    return double(l.spot.intensity.luminance()) * flux / cone;
}

template <class L>
std::optional<Emission> from_point(const L& l, const Ball& ball, Vec2f u) {
    const Cone cone = lit_cone(l, ball);
    const Vec3f direction = cone.sample(u);
    const Spectrumf flux = towards(l, direction) * cone.solid_angle();
    if (flux.is_black()) return std::nullopt;
    return Emission{place_of(l), direction, {}, {}, false, flux};
}

std::optional<Emission> from_infinity(const DirectionalLight& l, const Ball& ball, Vec2f u) {
    const Vec2f disk = square_to_disk(u.x, u.y);
    const Framef frame = Framef::from_normal(l.direction);
    const Vec3f p = ball.center + frame.to_world(Vec3f{disk.x, disk.y, -1}) * ball.radius;
    const float area = kPi<float> * ball.radius * ball.radius;
    if (l.irradiance.is_black()) return std::nullopt;
    return Emission{p, l.direction, {}, {}, true, l.irradiance * area};
}

/// From a point of a surface, chosen with density `pdf_area`; `radiance(front)` is what it emits.
template <class Radiance>
std::optional<Emission> from_surface(const ShapeSample& s, float pdf_area, const Ball& ball,
                                     Vec2f u, bool two_sided, Radiance&& radiance) {
    if (!(pdf_area > 0)) return std::nullopt;
    const Cone cone(s.p, ball);
    Vec3f direction;
    float weight = 1 / pdf_area;
    if (cone.everything()) {  // Lambert's directions, on either side where both shine
        const bool back = two_sided && u.x >= 0.5F;
        if (two_sided) u.x = std::min(back ? 2 * u.x - 1 : 2 * u.x, kOneMinusEpsilon<float>);
        direction =
            Framef::from_normal(back ? -s.n : s.n).to_world(square_to_cosine_hemisphere(u.x, u.y));
        weight *= kPi<float> * (two_sided ? 2.0F : 1.0F);
    } else {
        direction = cone.sample(u);
        weight *= cone.solid_angle() * std::abs(dot(direction, s.n));
    }
    const Spectrumf flux = radiance(dot(direction, s.n) > 0) * weight;
    if (flux.is_black()) return std::nullopt;
    return Emission{s.p, direction, s.error, s.n, false, flux};
}

ShapeSample anywhere_on(const Sphere& sphere, Vec2f u) {
    const Vec3f n = normalize(square_to_sphere(u.x, u.y));
    const Vec3f error = (abs(sphere.center) + abs(n) * sphere.radius) * gamma_bound<float>(6);
    const Vec2f uv = sphere_uv(n);
    return {sphere.center + n * sphere.radius, n, error, uv, 0, uv};
}
ShapeSample anywhere_on(const RectangleShape& r, Vec2f u) {
    const Vec3f error = (abs(r.corner) + abs(r.edge_u) + abs(r.edge_v)) * gamma_bound<float>(6);
    return {r.corner + r.edge_u * u.x + r.edge_v * u.y, r.n, error, u, 0, u};
}

}  // namespace

std::optional<Emission> emit(const LightSet& lights, const MaterialTable& materials, int light,
                             const Ball& ball, const SampleBlock& place, Vec2f u) {
    const auto emitted = [&](const ShapeSample& s) {
        return [&, at = s.texture_point()](bool front) { return lights.emitted(light, at, front); };
    };
    return std::visit(
        Overload{[&](const auto& point) { return from_point(point, ball, u); },
                 [&](const DirectionalLight& l) { return from_infinity(l, ball, u); },
                 [&](const RectangleLight& l) {
                     const ShapeSample s = anywhere_on(l.shape, place.uniform2(1));
                     return from_surface(s, 1 / l.shape.area, ball, u, false, emitted(s));
                 },
                 [&](const MeshLight& l) -> std::optional<Emission> {
                     const auto s = l.shape.sample(ball.center, place);
                     if (!s) return std::nullopt;
                     return from_surface(*s, s->pdf_area, ball, u, materials[l.material].two_sided,
                                         emitted(*s));
                 },
                 [&](const SphereLight& l) {
                     const Sphere& sphere = l.shape.sphere;
                     const ShapeSample s = anywhere_on(sphere, place.uniform2(1));
                     const float area = 4 * kPi<float> * sphere.radius * sphere.radius;
                     return from_surface(s, 1 / area, ball, u, materials[l.material].two_sided,
                                         emitted(s));
                 },
                 [](const EnvironmentTag&) -> std::optional<Emission> { return std::nullopt; }},
        lights[light]);
}

std::optional<LightBall> light_ball(const LightSet& lights, int light) {
    using Found = std::optional<LightBall>;
    return std::visit(
        Overload{[](const DirectionalLight&) -> Found { return std::nullopt; },
                 [](const EnvironmentTag&) -> Found { return std::nullopt; },
                 [](const RectangleLight& l) -> Found {
                     const Vec3f diagonal = (l.shape.edge_u + l.shape.edge_v) * 0.5F;
                     const Vec3f other = (l.shape.edge_u - l.shape.edge_v) * 0.5F;
                     const float r = std::max(length(diagonal), length(other));
                     return LightBall{{l.shape.corner + diagonal, r}, double(l.shape.area)};
                 },
                 [](const MeshLight& l) -> Found {
                     LightBounds b;
                     l.shape.bound(b);
                     const Vec3f half = (b.high - b.low) * 0.5F;
                     return LightBall{{b.low + half, length(half)}, l.shape.area()};
                 },
                 [](const SphereLight& l) -> Found {
                     const Sphere& s = l.shape.sphere;
                     const double r = double(s.radius);
                     return LightBall{{s.center, s.radius}, 4 * kPi<double> * r * r};
                 },
                 [](const auto& l) -> Found { return LightBall{{place_of(l), 0}, 0}; }},
        lights[light]);
}

double expected_flux(const LightSet& lights, const MaterialTable& materials, int light,
                     const Ball& ball) {
    const auto of_area = [&](const Spectrumf& radiance, double cosines) {
        const auto from = light_ball(lights, light);
        const double solid = double(Cone(from->ball.center, ball).solid_angle());
        return double(radiance.luminance()) * from->area * std::min(solid, kPi<double>) * cosines;
    };
    return std::visit(
        Overload{
            [&](const auto& l) {
                return mean_intensity(l) * double(lit_cone(l, ball).solid_angle());
            },
            [&](const DirectionalLight& l) {
                const double r = double(ball.radius);
                return double(l.irradiance.luminance()) * kPi<double> * r * r;
            },
            [&](const RectangleLight& l) {
                const Vec3f to =
                    ball.center - (l.shape.corner + l.shape.edge_u * 0.5F + l.shape.edge_v * 0.5F);
                const float above = dot(to, l.shape.n);
                return above + ball.radius <= 0 ? 0.0 : of_area(l.radiance, 0.5);
            },
            [&](const MeshLight& l) { return of_area(materials.mean_emission(l.material), 0.25); },
            [&](const SphereLight& l) {
                return of_area(materials.mean_emission(l.material), 0.25);
            },
            [](const EnvironmentTag&) { return 0.0; }},
        lights[light]);
}

}  // namespace matiere
