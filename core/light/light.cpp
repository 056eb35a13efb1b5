#include "light/light.h"

#include <algorithm>
#include <cmath>
#include <iterator>

namespace matiere {

namespace {

template <class... F>
struct Overload : F... {
    using F::operator()...;
};

double luminance(const Spectrumf& s) { return double(s.luminance()); }

/// Emitted power over pi, up to a common factor.
double light_power(const Light& light, const std::shared_ptr<const EnvironmentLight>& environment,
                   const MaterialTable& materials, double radius) {
    const double disk = radius * radius;
    const auto sides = [&](int m) { return materials[m].two_sided ? 2.0 : 1.0; };
    return std::visit(
        Overload{
            [](const PointLight& l) { return 4 * luminance(l.intensity); },
            [](const SpotLight& l) {
                return 2 * (1 - 0.5 * double(l.cos_inner + l.cos_outer)) * luminance(l.intensity);
            },
            [](const ProfileLight& l) {
                const double flux = l.profile->flux(double(l.spot.cos_outer));
                return flux / kPi<double> * luminance(l.spot.intensity);
            },
            [&](const DirectionalLight& l) { return disk * luminance(l.irradiance); },
            [](const RectangleLight& l) { return double(l.shape.area) * luminance(l.radiance); },
            [&](const MeshLight& l) {
                return l.shape.area() * luminance(materials.mean_emission(l.material)) *
                       sides(l.material);
            },
            [&](const SphereLight& l) {
                const double r = double(l.shape.sphere.radius);
                return 4 * kPi<double> * r * r * luminance(materials.mean_emission(l.material));
            },
            [&](const EnvironmentTag&) { return environment->sampled_power(disk); }},
        light);
}

/// Whether a light has a place, so that the tree can hold it.
bool stands(const Light& light) {
    return !std::holds_alternative<DirectionalLight>(light) &&
           !std::holds_alternative<EnvironmentTag>(light);
}

std::ptrdiff_t count_standing(const std::vector<Light>& lights) {
    return std::count_if(lights.begin(), lights.end(), stands);
}

/// Everything but the power.
LightBounds light_bounds(const Light& light, const MaterialTable& materials) {
    LightBounds b;
    std::visit(
        Overload{[&](const PointLight& l) {
                     b.grow(l.position);
                     b.cos_normal = -1;
                 },
                 [&](const SpotLight& l) {
                     b.grow(l.position);
                     b.axis = l.direction;
                     b.cos_normal = l.cos_inner;  // all its power there, then it fades
                     b.cos_emit = std::cos(std::acos(l.cos_outer) - std::acos(l.cos_inner));
                 },
                 [&](const ProfileLight& l) {
                     b.grow(l.spot.position);
                     b.cos_normal = -1;
                 },
                 [&](const RectangleLight& l) {
                     for (const Vec2f c : {Vec2f{0, 0}, Vec2f{0, 1}, Vec2f{1, 0}, Vec2f{1, 1}})
                         b.grow(l.shape.corner + l.shape.edge_u * c.x + l.shape.edge_v * c.y);
                     b.axis = l.shape.n;
                 },
                 [&](const MeshLight& l) {
                     l.shape.bound(b);
                     b.two_sided = materials[l.material].two_sided;
                 },
                 [&](const SphereLight& l) {
                     const Sphere& s = l.shape.sphere;
                     b.grow(s.center - Vec3f{s.radius, s.radius, s.radius});
                     b.grow(s.center + Vec3f{s.radius, s.radius, s.radius});
                     b.cos_normal = -1;
                 },
                 [](const auto&) {}},
        light);
    return b;
}

LightSample delta_sample(Vec3f wi, const Spectrumf& value) {
    LightSample s;
    s.wi = wi;
    s.weight = value;
    s.delta = true;
    return s;
}

/// Light from a point whose intensity is spread over directions by `share`.
template <class F>
std::optional<LightSample> spread_sample(const SpotLight& l, Vec3f reference, F&& share) {
    const Vec3f to_light = l.position - reference;
    const float d2 = length_squared(to_light);
    if (!(d2 > 0)) return std::nullopt;
    const Vec3f wi = to_light * (1 / std::sqrt(d2));
    const float part = share(-wi);
    if (part == 0) return std::nullopt;
    auto s = delta_sample(wi, l.intensity * (part / d2));
    s.p = l.position;
    return s;
}

std::optional<LightSample> if_any(const LightSample& s) {
    if (!(s.pdf > 0)) return std::nullopt;
    return s;
}

}  // namespace

LightSet::LightSet(std::vector<Light> lights, std::shared_ptr<const EnvironmentLight> environment,
                   const MaterialTable& materials, float scene_radius, bool tree)
    : lights_(std::move(lights)), environment_(std::move(environment)), materials_(&materials) {
    if (environment_) {
        environment_index_ = int(lights_.size());
        lights_.emplace_back(EnvironmentTag{});
    }
    const bool use_tree = tree && count_standing(lights_) > 1;
    std::vector<LightBounds> standing(use_tree ? lights_.size() : 0);
    std::vector<double> power;
    place_.resize(lights_.size());
    for (std::size_t i = 0; i < lights_.size(); ++i) {
        const double p = light_power(lights_[i], environment_, materials, double(scene_radius));
        if (use_tree && stands(lights_[i])) {
            standing[i] = light_bounds(lights_[i], materials);
            standing[i].power = p;
            continue;
        }
        place_[i] = std::uint32_t(choices_.size());
        choices_.push_back(std::uint32_t(i));
        power.push_back(p);
    }
    if (use_tree) {
        tree_ = LightTree(standing);
        for (std::size_t i = 0; i < lights_.size(); ++i)
            if (stands(lights_[i])) place_[i] = std::uint32_t(choices_.size());
        choices_.push_back(kTree);
        power.push_back(tree_.power());
    }
    double total = 0;
    int lit = 0;
    for (const double p : power) {
        total += p;
        lit += p > 0 ? 1 : 0;
    }
    for (double& p : power)
        if (p > 0) p = 0.5 * p / total + 0.5 / lit;
    choice_ = DiscreteDistribution(power);
}

std::string_view LightSet::kind(int i) const {
    constexpr std::string_view kNames[] = {"point",     "spot", "luminaire", "directional",
                                           "rectangle", "mesh", "sphere",    "environment"};
    static_assert(std::size(kNames) == std::variant_size_v<Light>);
    return kNames[lights_[std::size_t(i)].index()];
}

bool LightSet::has_points() const {
    return std::any_of(lights_.begin(), lights_.end(), [](const Light& l) {
        return std::holds_alternative<PointLight>(l) || std::holds_alternative<SpotLight>(l) ||
               std::holds_alternative<ProfileLight>(l) ||
               std::holds_alternative<DirectionalLight>(l);
    });
}

bool LightSet::is_one_rectangle() const {
    return lights_.size() == 1 && std::holds_alternative<RectangleLight>(lights_[0]);
}

std::optional<LightSet::Choice> LightSet::choose(Vec3f reference, std::uint32_t u) const {
    const auto first = choice_.sample(u);
    const std::uint32_t chosen = choices_[first.index];
    if (chosen != kTree) return Choice{chosen, first.probability};
    const auto found = tree_.sample(reference, first.remainder);
    if (!found) return std::nullopt;
    return Choice{found->light, first.probability * found->probability};
}

float LightSet::probability(Vec3f reference, std::size_t light) const {
    const std::size_t place = place_[light];
    const float p = choice_.probability(place);
    return choices_[place] == kTree ? p * tree_.probability(reference, std::uint32_t(light)) : p;
}

std::optional<LightSample> LightSet::sample(const Receiver& at, const SampleBlock& u) const {
    const Vec3f reference = at.p;
    const auto choice = choose(reference, u.bits[0]);
    if (!choice) return std::nullopt;
    auto found = std::visit(
        Overload{
            [&](const PointLight& l) -> std::optional<LightSample> {
                const Vec3f to_light = l.position - reference;
                const float d2 = length_squared(to_light);
                if (!(d2 > 0)) return std::nullopt;
                auto s = delta_sample(to_light * (1 / std::sqrt(d2)), l.intensity * (1 / d2));
                s.p = l.position;
                return s;
            },
            [&](const SpotLight& l) {
                return spread_sample(l, reference, [&](Vec3f away) { return l.falloff(away); });
            },
            [&](const ProfileLight& l) {
                return spread_sample(l.spot, reference, [&](Vec3f away) { return l.share(away); });
            },
            [&](const DirectionalLight& l) -> std::optional<LightSample> {
                auto s = delta_sample(-l.direction, l.irradiance);
                s.infinite = true;
                return s;
            },
            [&](const RectangleLight& l) {
                return if_any(
                    shape_sample(reference, l.shape.sample(reference, u), l.radiance, false));
            },
            [&](const MeshLight& l) -> std::optional<LightSample> {
                const auto s = l.shape.sample(reference, u);
                if (!s) return std::nullopt;
                return if_any(shape_sample(reference, *s,
                                           materials_->emission(l.material, s->texture_point()),
                                           (*materials_)[l.material].two_sided));
            },
            [&](const SphereLight& l) {
                auto s = l.shape.sample(reference, u);
                if ((*materials_)[l.material].textured()) s.uv = s.uv1 = sphere_uv(s.n);
                return if_any(shape_sample(reference, s,
                                           materials_->emission(l.material, s.texture_point()),
                                           (*materials_)[l.material].two_sided));
            },
            [&](const EnvironmentTag&) -> std::optional<LightSample> {
                const auto e = environment_->sample(at, u);
                if (!e || !(e->pdf > 0)) return std::nullopt;
                LightSample s;
                s.wi = e->wi;
                s.weight = e->radiance * (1 / e->pdf);
                s.pdf = e->pdf;
                s.infinite = true;
                return s;
            }},
        lights_[choice->light]);
    if (!found) return std::nullopt;
    found->light = int(choice->light);
    found->weight *= 1 / choice->probability;
    found->pdf *= choice->probability;
    return found;
}

float LightSet::pdf(Vec3f reference, const LightHit& hit) const {
    const auto i = std::size_t(hit.light);
    const float pdf = std::visit(
        Overload{
            [&](const RectangleLight& l) { return l.shape.pdf(reference, hit.p); },
            [&](const MeshLight& l) { return l.shape.pdf(reference, hit.primitive, hit.p, hit.n); },
            [&](const SphereLight& l) { return l.shape.pdf(reference, hit.p, hit.n); },
            [](const auto&) { return 0.0F; }},
        lights_[i]);
    return pdf > 0 ? pdf * probability(reference, i) : 0.0F;
}

Spectrumf LightSet::emitted(int light, const TexturePoint& at, bool front) const {
    const auto of_material = [&](int material) {
        return front || (*materials_)[material].two_sided ? materials_->emission(material, at)
                                                          : Spectrumf();
    };
    return std::visit(
        Overload{[&](const RectangleLight& l) { return front ? l.radiance : Spectrumf(); },
                 [&](const MeshLight& l) { return of_material(l.material); },
                 [&](const SphereLight& l) { return of_material(l.material); },
                 [](const auto&) { return Spectrumf(); }},
        lights_[std::size_t(light)]);
}

EnvironmentLight::Seen LightSet::see_environment(const Receiver& at, Vec3f direction) const {
    auto seen = environment_->see(at, direction);
    seen.pdf *= choice_.empty() ? 0 : choice_.probability(place_[std::size_t(environment_index_)]);
    return seen;
}

}  // namespace matiere
