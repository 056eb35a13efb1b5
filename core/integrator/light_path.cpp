#include "integrator/light_path.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "integrator/ray_cone.h"
#include "integrator/visibility.h"
#include "integrator/walk.h"
#include "material/bsdf_for.h"
#include "sampling/sampler.h"
#include "scene/light_layer.h"
#include "scene/scene.h"

namespace matiere {

namespace {

/// Sets the numbers of paths from the lights apart from those of paths from the camera.
constexpr std::uint64_t kLightSeed = 0x6c69676874ULL;
/// The same for which of those that a limit cuts go on for the ledger.
constexpr std::uint64_t kFollowSeed = 0x666f6c6c6f77ULL;
/// Sharp events before roulette may end a path: so many does light inside a gem keep its flux.
constexpr int kSharpDepth = 8;

class LightPath {
 public:
    LightPath(const Scene& scene, const LightLayer& layer, const PathSettings& settings,
              const LightPathId& id, const LightPathSums& sums)
        : scene_(scene),
          layer_(layer),
          settings_(settings),
          sampler_(hash_words(settings.seed, kLightSeed), id.replicate, 0, 0, id.index),
          sums_(sums),
          counters_(sums.counters),
          followed_(settings.max_depth >= 0 &&
                    hash_words(kFollowSeed ^ settings.seed, kLightSeed, id.replicate, id.index) %
                            kCutStride ==
                        0) {}

    void run() {
        walk();
        if (!cut_) return;
        ++sums_.cut.paths;
        const double share = double(kCutStride) / double(sums_.window.pixels());
        if (followed_) sums_.cut.add({lost_[0] * share, lost_[1] * share, lost_[2] * share});
    }

 private:
    void walk() {
        if (!start()) return;
        for (int segment = 0; segment < 2 * kDepthGuard; ++segment) {
            ++counters_.rays;
            const RayHit hit = scene_.intersect(ray_);
            if (hit.missed()) return;
            flux_ *= absorb(scene_, inside_, hit.t);
            const SurfaceHit s = scene_.surface(ray_, hit);
            if (s.material < 0) return;
            const MaterialRecord& material = scene_.materials()[s.material];
            on_target_ = events_ > 0 || layer_.is_target(target_, hit, s.material);
            if (!on_target_ && !material.passes && !material.has_interior) return;
            float eta_rel = 1;
            if (material.has_interior && !cross(s, eta_rel)) continue;
            if (events_ > 0 && layer_.receives(s.material)) show(s, eta_rel);
            if (!scatter(s, eta_rel)) return;
        }
    }

    bool start() {
        const SampleBlock u = sampler_.block(0, Purpose::kFilm);
        const LightLayer::Pair pair = layer_.choose(u.bits[0]);
        target_ = pair.target;
        const auto emitted =
            emit(scene_.lights(), scene_.materials(), pair.light, layer_.ball(target_),
                 sampler_.block(0, Purpose::kLight), u.uniform2(1));
        if (!emitted) return false;
        flux_ = emitted->flux * (1 / pair.probability);
        power_ = flux_.max_value();
        inside_ = layer_.media(scene_, pair.light, *emitted);
        ray_ = {offset_origin(emitted->p, emitted->error, emitted->n, emitted->direction),
                emitted->direction};
        if (!emitted->infinite) return true;
        // What lies behind the start, on the way from infinity.
        SurfaceHit from;
        from.point.p = emitted->p;
        LightSample sun;
        sun.wi = -emitted->direction;
        sun.infinite = true;
        flux_ *= transmittance(scene_, from, sun, inside_, counters_);
        return !flux_.is_black();
    }

    /// As the paths from the camera do; false where the interface is hidden.
    bool cross(const SurfaceHit& s, float& eta_rel) {
        const bool entering = dot(s.point.n_g, ray_.direction) < 0;
        auto crossing =
            cross_interface(scene_.materials(), s.material, entering, inside_, std::max(lane_, 0));
        if (crossing.hidden) {
            move_on(s);
            return false;
        }
        if (crossing.dispersive && lane_ < 0) {
            pick_lane();
            crossing = cross_interface(scene_.materials(), s.material, entering, inside_, lane_);
        }
        eta_rel = crossing.eta_rel;
        return true;
    }

    void pick_lane() {
        const float sum = flux_[0] + flux_[1] + flux_[2];
        lane_ = flux_.pick(sampler_.block(slot(), Purpose::kSpare).uniform(kLaneSlot));
        Spectrumf one;
        one[lane_] = sum;
        flux_ = one;
    }

    /// Straight on, as if the surface were not there.
    void move_on(const SurfaceHit& s) {
        if (scene_.materials()[s.material].has_interior)
            move_through(scene_, s, dot(s.point.n_g, ray_.direction) < 0, inside_, counters_);
        ray_.origin = offset_origin(s.point.p, s.error, s.point.n_g, ray_.direction);
    }

    /// What the camera sees of the light that arrives here: f seen from the camera, as its own
    /// paths have it, times the flux over the area that it falls on.
    void show(const SurfaceHit& s, float eta_rel) {
        if (beyond(events_ + 1) && !followed_) return;
        const Vec2f lens = sampler_.block(slot(), Purpose::kLight).uniform2(0);
        const auto sight = scene_.camera().sight(s.point.p, lens);
        if (!sight) return;
        bool near = false;
        scene_.camera().for_each_image(sight->raster, sums_.window.filter->radius(),
                                       [&](Vec2f at) { near = near || sums_.window.near(at); });
        if (!near) return;
        const Vec3f wi = -ray_.direction, wo = sight->direction;
        const float cos_i = std::abs(dot(s.point.n_g, wi)), cos_o = std::abs(dot(s.point.n_g, wo));
        if (!(cos_i > 0)) return;
        const bool through = dot(s.point.n_g, wo) * dot(s.point.n_g, wi) < 0;
        const Bsdf bsdf(scene_.materials(), s.material, seen(s, *sight), wo,
                        through ? 1 / eta_rel : eta_rel);
        const Spectrumf f = bsdf.eval(wo, wi, counters_).f;
        if (f.is_black()) return;
        InteriorStack inside = inside_;
        if (through && scene_.materials()[s.material].has_interior)
            move_through(scene_, s, dot(s.point.n_g, wi) > 0, inside, counters_);
        LightSample camera;
        camera.wi = wo;
        camera.p = sight->p;
        const Spectrumf value = flux_ * f * (cos_o / cos_i * sight->importance) *
                                transmittance(scene_, s, camera, inside, counters_);
        if (!value.is_finite()) {
            counters_.reject(Reject::kNonFiniteEmission, s.material);
            return;
        }
        if (!value.is_black()) splat(sight->raster, value, bsdf, wo, wi);
    }

    /// The point with what a pixel covers of it.
    SurfacePoint seen(const SurfaceHit& s, const CameraSight& sight) const {
        SurfacePoint point = s.point;
        if (scene_.prefilters())
            RayCone(scene_.camera().footprint())
                .meet(point, length(sight.p - point.p), sight.direction);
        return point;
    }

    void splat(Vec2f raster, const Spectrumf& value, const Bsdf& bsdf, Vec3f wo, Vec3f wi) {
        LobeSplit lobes;
        const bool split = sums_.diffuse != nullptr && !beyond(events_ + 1);
        if (split) lobes = bsdf.split(wo, wi);
        const Spectrumf diffuse = value * lobes.diffuse;
        const auto part = [](const Spectrumf& v, double w) {
            return SplatSums::Value{w * double(v[0]), w * double(v[1]), w * double(v[2])};
        };
        const auto give = [&](std::uint32_t pixel, double w) {
            if (beyond(events_ + 1)) {
                for (int c = 0; c < kSplatChannels; ++c)
                    lost_[std::size_t(c)] += w * double(value[c]);
                return;
            }
            sums_.light.add(pixel, part(value, w));
            if (!split) return;
            if (lobes.transmission)
                sums_.transmission->add(pixel, part(value, w));
            else
                sums_.diffuse->add(pixel, part(diffuse, w));
        };
        scene_.camera().for_each_image(raster, sums_.window.filter->radius(), [&](Vec2f at) {
            if (sums_.window.near(at)) sums_.window.for_each_pixel(at, give);
        });
    }

    /// Whether a path of so many events is longer than the limit.
    bool beyond(int events) const {
        return settings_.max_depth >= 0 && events > settings_.max_depth;
    }

    bool scatter(const SurfaceHit& s, float eta_rel) {
        // What may still pass without an event is not cut before it does not.
        const bool last = beyond(events_ + 2);
        if (last && !passes(s) && !goes_beyond()) return false;
        if (events_ >= kDepthGuard) {
            ++counters_.depth_guard;
            return false;
        }
        const Vec3f known = -ray_.direction;
        const Bsdf bsdf(scene_.materials(), s.material, s.point, known, eta_rel);
        const SampleBlock u = sampler_.block(slot(), Purpose::kBsdf);
        const auto sample = bsdf.sample(known, u.uniform3(0), counters_);
        if (!sample) return false;
        if ((sample->lobe & kNull) != 0) {
            ++passed_;
            move_on(s);
            return true;
        }
        const bool delta = (sample->lobe & kSpecular) != 0;
        const bool sharp = delta || layer_.sharp(s.material);
        if (events_ == 0 && !(sharp && on_target_)) return false;
        if (last && !goes_beyond()) return false;
        flux_ *= adjoint(s, bsdf, *sample, known, eta_rel);
        if (!(flux_.max_value() > 0) || !flux_.is_finite()) return false;
        ++events_;
        if ((sample->lobe & kTransmission) != 0 && scene_.materials()[s.material].has_interior)
            move_through(scene_, s, dot(s.point.n_g, known) > 0, inside_, counters_);
        ray_ = {offset_origin(s.point.p, s.error, s.point.n_g, sample->wi), sample->wi};
        return (sharp && events_ < kSharpDepth) || survive(u.uniform(3));
    }

    /// At the limit: notes it, and says whether the path goes on for the ledger.
    bool goes_beyond() {
        cut_ = true;
        return followed_;
    }

    /// What a path from the camera that comes the other way would be weighed with, over the density
    /// of this one. A delta, and an estimate whose density nobody knows, are turned round by
    /// reciprocity: f of radiance is that of the other way but for eta^2, cosines with the shading
    /// normal but for those with the real one.
    Spectrumf adjoint(const SurfaceHit& s, const Bsdf& bsdf, const BsdfSample<float>& sample,
                      Vec3f known, float eta_rel) const {
        const Vec3f n = s.point.n_g, wi = sample.wi;
        const float cos_known = std::abs(dot(n, known)), cos_new = std::abs(dot(n, wi));
        if (!(cos_known > 0)) return {};
        const bool through = (sample.lobe & kTransmission) != 0;
        if ((sample.lobe & kSpecular) != 0 || layer_.is_estimate(s.material)) {
            const Vec3f n_s = scene_.materials().shading_normal(s.material, s.point);
            if (dot(n_s, known) * dot(n, known) <= 0) return {};  // the camera's are absorbed
            const Vec3f used = bsdf.frame().n;
            const float shading = std::abs(dot(used, known) / dot(used, wi));
            const float eta2 = through ? sample.eta * sample.eta : 1.0F;
            return sample.weight * (eta2 * shading * cos_new / cos_known);
        }
        const Bsdf back(scene_.materials(), s.material, s.point, wi,
                        through ? 1 / eta_rel : eta_rel);
        return back.eval(wi, known, counters_).f * (cos_new / (cos_known * sample.pdf));
    }

    /// Roulette on what is left of the flux.
    bool survive(float u) {
        const float q = flux_.max_value() / power_;
        if (q >= 1) return true;
        if (u >= q) return false;
        flux_ *= 1 / q;
        return true;
    }

    bool passes(const SurfaceHit& s) const { return scene_.materials()[s.material].passes; }
    std::uint32_t slot() const { return std::uint32_t(events_ + passed_); }

    const Scene& scene_;
    const LightLayer& layer_;
    const PathSettings& settings_;
    const Sampler sampler_;
    const LightPathSums& sums_;
    Counters& counters_;
    const bool followed_;
    bool cut_ = false;
    std::array<double, kSplatChannels> lost_{};  // beyond the limit, summed over the pixels
    InteriorStack inside_;
    Ray ray_;
    Spectrumf flux_;
    float power_ = 0;  // at the start
    std::uint32_t target_ = 0;
    bool on_target_ = false;
    int lane_ = -1, events_ = 0, passed_ = 0;
};

}  // namespace

void trace_light_path(const Scene& scene, const LightLayer& layer, const PathSettings& settings,
                      const LightPathId& id, const LightPathSums& sums) {
    LightPath(scene, layer, settings, id, sums).run();
}

}  // namespace matiere
