#include "scene/light_layer.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "scene/media_at.h"
#include "scene/scene.h"

namespace matiere {

namespace {

/// A lobe up to this width counts as sharp: wider ones are found well enough from the camera.
constexpr double kSharpAlpha = 0.15;
/// A lamp is small if some sharp thing sees no more of it than this [sr].
constexpr double kSmallLamp = 0.1;
/// More pairs of lights and targets than this are not told apart.
constexpr std::size_t kMostPairs = std::size_t(1) << 18;
/// Photons of a lamp below which it is not worth paths of its own.
constexpr std::uint32_t kFewHard = 8;

/// The width of the lobes of a model that are no delta; infinite where one is wide or not known.
double lobe_alpha(const AnyModel<float>& model) {
    constexpr double kWide = std::numeric_limits<double>::infinity();
    const std::uint8_t lobes = model_lobes<float>(model);
    if ((lobes & (kDiffuse | kGlossy)) == 0) return 0;
    return visit_model(model, [&]<class M>(const M& m) {
        const auto widest = [](const auto& surface) {
            return double(std::max(surface.alpha_x, surface.alpha_y));
        };
        // What facets lose at each other comes back diffuse: little where they are that smooth.
        if constexpr (std::same_as<M, Dielectric<float>>) return widest(m.surface);
        if constexpr (std::same_as<M, Conductor<float>>) return widest(m.surface.surface);
        if constexpr (std::same_as<M, CookTorrance<float>>)
            return m.layers.body.is_black() ? widest(m.layers.coat.surface) : kWide;
        return kWide;
    });
}

Ball ball_of(const Mesh& mesh) {
    Vec3f low{kInfinity<float>, kInfinity<float>, kInfinity<float>}, high = -low;
    for (const std::uint32_t v : mesh.indices) {
        const Vec3f p = mesh.position(v);
        low = {std::min(low.x, p.x), std::min(low.y, p.y), std::min(low.z, p.z)};
        high = {std::max(high.x, p.x), std::max(high.y, p.y), std::max(high.z, p.z)};
    }
    Ball ball{(low + high) * 0.5F, 0};
    for (const std::uint32_t v : mesh.indices)
        ball.radius = std::max(ball.radius, length(mesh.position(v) - ball.center));
    return ball;
}

Ball around(const Ball& a, const Ball& b) {
    const Vec3f to = b.center - a.center;
    const float d = length(to);
    if (d + b.radius <= a.radius) return a;
    if (d + a.radius <= b.radius) return b;
    const float r = 0.5F * (d + a.radius + b.radius);
    return {a.center + to * ((r - a.radius) / d), r};
}

/// Rounded up, so that nothing at the rim is missed.
Ball with_margin(Ball ball) {
    const Vec3f c = abs(ball.center);
    ball.radius = ball.radius * (1 + 0x1p-12F) + max_component(c) * 0x1p-20F;
    return ball;
}

bool overlap(const Ball& a, const Ball& b) {
    return length(a.center - b.center) <= a.radius + b.radius;
}

/// Whether light is scattered between surfaces: no path from a light follows it there.
bool scatters(const MaterialTable& materials) {
    for (int i = 0; i < materials.size(); ++i)
        if (materials[i].scatters) return true;
    return false;
}

}  // namespace

LightLayer::LightLayer(const Scene& scene, std::span<const std::uint32_t> hard, bool all) {
    if (!scene.camera().has_sight() || scatters(scene.materials())) return;
    classify(scene);
    find_targets(scene);
    choose_lights(scene, hard, all);
    if (lights_.empty() || targets_.empty() ||
        std::count(receives_.begin(), receives_.end(), 1) == 0) {
        *this = {};
        return;
    }
    weigh_pairs(scene);
    if (choice_.empty())
        *this = {};
    else
        find_media(scene);
}

void LightLayer::classify(const Scene& scene) {
    const MaterialTable& materials = scene.materials();
    for (int i = 0; i < materials.size(); ++i) {
        const MaterialRecord& r = materials[i];
        const bool sharp = !r.recipe.textured() && lobe_alpha(r.recipe.model()) <= kSharpAlpha;
        const std::uint8_t model = r.recipe.lobes();
        const bool delta = (model & kSpecular) != 0 && (model & (kReflection | kTransmission)) != 0;
        sharp_.push_back(sharp);
        reflects_sharply_.push_back(delta || (sharp && (model & kGlossy) != 0));
        estimate_.push_back(model_is_stochastic<float>(r.recipe.model()));
        receives_.push_back(!sharp && (r.lobes & (kDiffuse | kGlossy)) != 0);
    }
}

void LightLayer::find_targets(const Scene& scene) {
    const auto wanted = [&](int m) { return m >= 0 && reflects_sharply_[std::size_t(m)] != 0; };
    const auto& meshes = scene.meshes();
    for (std::uint32_t i = 0; i < meshes.size(); ++i)
        if (wanted(meshes[i]->material)) targets_.push_back({ball_of(*meshes[i]), i, 0, false});
    for (std::uint32_t i = 0; i < scene.spheres().size(); ++i) {
        const Sphere& s = scene.spheres()[i];
        if (wanted(s.material))
            targets_.push_back({{s.center, s.radius}, std::uint32_t(meshes.size()), i, true});
    }
    std::erase_if(targets_, [](const Target& t) { return !(t.ball.radius > 0); });
    for (Target& t : targets_) t.ball = with_margin(t.ball);
}

bool LightLayer::is_small(const LightBall& light) const {
    return std::any_of(targets_.begin(), targets_.end(), [&](const Target& t) {
        const float away = length(light.ball.center - t.ball.center) - t.ball.radius;
        const auto d = double(std::max(away, 0.5F * t.ball.radius));
        return light.area <= kSmallLamp * d * d;
    });
}

void LightLayer::choose_lights(const Scene& scene, std::span<const std::uint32_t> hard, bool all) {
    const LightSet& lights = scene.lights();
    owned_.assign(std::size_t(lights.size()), 0);
    for (int i = 0; i < lights.size(); ++i) {
        if (i == lights.environment_index()) continue;
        const auto ball = light_ball(lights, i);
        if (ball && ball->area > 0 && !all) {
            const bool found = std::size_t(i) < hard.size() && hard[std::size_t(i)] >= kFewHard;
            if (!found || !is_small(*ball)) continue;
        }
        owned_[std::size_t(i)] = 1;
        lights_.push_back(i);
    }
    owned_count_ = int(lights_.size());
}

void LightLayer::weigh_pairs(const Scene& scene) {
    if (targets_.size() > 1 && targets_.size() * lights_.size() > kMostPairs) {
        Target all{targets_.front().ball};
        for (const Target& t : targets_) all.ball = around(all.ball, t.ball);
        targets_ = {all};
    }
    std::vector<double> weights;
    double total = 0;
    std::size_t lit = 0;
    for (const int light : lights_)
        for (const Target& t : targets_) {
            weights.push_back(expected_flux(scene.lights(), scene.materials(), light, t.ball));
            total += weights.back();
            lit += weights.back() > 0 ? 1 : 0;
        }
    // What is misjudged still gets its share.
    for (double& w : weights)
        if (w > 0) w = 0.75 * w / total + 0.25 / double(lit);
    choice_ = DiscreteDistribution(weights);
}

LightLayer::Pair LightLayer::choose(std::uint32_t u) const {
    const auto choice = choice_.sample(u);
    return {lights_[choice.index / targets_.size()], std::uint32_t(choice.index % targets_.size()),
            choice.probability};
}

bool LightLayer::is_target(std::uint32_t target, const RayHit& hit, int material) const {
    const Target& t = targets_[target];
    if (t.geometry == RayHit::kMiss) return reflects_sharply_[std::size_t(material)] != 0;
    return hit.geometry == t.geometry && (!t.is_sphere || hit.primitive == t.primitive);
}

/// Whether a target lies near the interior of another shape.
bool LightLayer::any_target_beside(std::span<const Ball> interiors) const {
    if (interiors.size() * targets_.size() > kMostPairs) return true;
    return std::any_of(targets_.begin(), targets_.end(), [&](const Target& t) {
        const auto beside = [&](const Ball& b) { return overlap(b, t.ball); };
        const auto self = [&](const Ball& b) {
            return b.center == t.ball.center && b.radius == t.ball.radius;
        };
        return std::count_if(interiors.begin(), interiors.end(), beside) >
               std::min(std::count_if(interiors.begin(), interiors.end(), self), std::ptrdiff_t(1));
    });
}

void LightLayer::find_media(const Scene& scene) {
    media_.assign(owned_.size(), Media::kNone);
    fixed_.resize(owned_.size());
    std::vector<Ball> interiors;
    const auto bounds = [&](int m) { return m >= 0 && scene.materials()[m].has_interior; };
    for (const auto& mesh : scene.meshes())
        if (bounds(mesh->material)) interiors.push_back(with_margin(ball_of(*mesh)));
    for (const Sphere& s : scene.spheres())
        if (bounds(s.material)) interiors.push_back(with_margin({s.center, s.radius}));
    const bool crowded = any_target_beside(interiors);
    for (const int light : lights_) {
        const auto place = light_ball(scene.lights(), light);
        if (!place) {  // from infinity: paths start beside their target, maybe inside another shape
            if (crowded) media_[std::size_t(light)] = Media::kAtStart;
            continue;
        }
        const bool near = std::any_of(interiors.begin(), interiors.end(),
                                      [&](const Ball& b) { return overlap(b, place->ball); });
        if (!near) continue;
        const bool point = !(place->area > 0);
        media_[std::size_t(light)] = point ? Media::kFixed : Media::kAtStart;
        if (point) fixed_[std::size_t(light)] = media_at(scene, place->ball.center);
    }
}

InteriorStack LightLayer::media(const Scene& scene, int light, const Emission& start) const {
    switch (media_[std::size_t(light)]) {
        case Media::kFixed:
            return fixed_[std::size_t(light)];
        case Media::kAtStart:
            return media_at(scene, offset_origin(start.p, start.error, start.n, start.direction));
        default:
            return {};
    }
}

}  // namespace matiere
