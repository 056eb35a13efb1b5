#include "integrator/integrator.h"

#include <algorithm>

#include "integrator/guided_bsdf.h"
#include "integrator/visibility.h"
#include "sampling/mis.h"
#include "sampling/sampler.h"
#include "scene/caustics.h"
#include "scene/scene.h"

namespace matiere {

namespace {

/// Scattering events after which a path is cut and counted: an endless path in a lossless box.
constexpr int kDepthGuard = 10000;
/// Scattering events before roulette may end a path.
constexpr int kRouletteDepth = 4;
/// Which number of the spare block picks the lane of a dispersed path.
constexpr int kLaneSlot = 1;

/// One path from the camera.
class Walk {
 public:
    Walk(const Scene& scene, const PathSettings& settings, const Sampler& sampler,
         Counters& counters)
        : scene_(scene),
          settings_(settings),
          sampler_(sampler),
          counters_(counters),
          interior_(scene.camera_interior()) {}

    PathResult run(Ray ray) {
        ray_ = ray;
        from_ = ray.origin;
        // Hidden interfaces do not scatter but must not loop for ever either.
        for (int segment = 0; segment < 2 * kDepthGuard; ++segment) {
            ++counters_.rays;
            const RayHit hit = scene_.intersect(ray_);
            if (!interior_.empty())
                beta_ *= absorb(scene_, interior_, hit.missed() ? kInfinity<float> : hit.t);
            if (hit.missed()) {
                escape();
                break;
            }
            const SurfaceHit s = scene_.surface(ray_, hit);
            float eta_rel = 1;
            if (s.material >= 0 && scene_.materials()[s.material].has_interior) {
                const bool entering = dot(s.point.n_g, ray_.direction) < 0;
                auto crossing = cross_interface(scene_.materials(), s.material, entering, interior_,
                                                std::max(lane_, 0));
                if (crossing.hidden) {
                    move_through(scene_, s, entering, interior_, counters_);
                    ray_.origin = offset_origin(s.point.p, s.error, s.point.n_g, ray_.direction);
                    continue;
                }
                if (crossing.dispersive && lane_ < 0) {
                    pick_lane();
                    crossing =
                        cross_interface(scene_.materials(), s.material, entering, interior_, lane_);
                }
                eta_rel = crossing.eta_rel;
            }
            add_emission(s);
            if (s.material < 0 || !scatter(s, eta_rel)) break;
        }
        return finish();
    }

 private:
    /// At the first dispersive interface of a path: from there on it carries one lane, picked in
    /// proportion to the light it carries, for all of them.
    void pick_lane() {
        const float sum = beta_[0] + beta_[1] + beta_[2];
        const SampleBlock u = sampler_.block(std::uint32_t(depth_), Purpose::kSpare);
        const float x = u.uniform(kLaneSlot) * sum;
        lane_ = x < beta_[0] ? 0 : x < beta_[0] + beta_[1] ? 1 : 2;
        if (!(beta_[lane_] > 0)) lane_ = beta_[1] > 0 ? 1 : 0;  // x at a rounded edge
        Spectrumf one;
        one[lane_] = sum;
        beta_ = one;
    }

    float emission_weight(float light_pdf) const {
        if (specular_ || settings_.strategy == Strategy::kBsdfOnly) return 1;
        if (settings_.strategy == Strategy::kLightOnly) return light_pdf > 0 ? 0.0F : 1.0F;
        return power_heuristic(bsdf_pdf_, light_pdf);
    }

    void add(const Spectrumf& value, int material) {
        if (value.is_finite())
            L_ += value;
        else
            counters_.reject(Reject::kNonFiniteEmission, material);
    }

    void escape() {
        const EnvironmentLight* environment = scene_.lights().environment();
        if (depth_ == 0 && settings_.transparent_background) {
            alpha_ = 0;
            return;
        }
        if (environment == nullptr) return;
        const float w =
            emission_weight(specular_ ? 0 : scene_.lights().pdf_environment(ray_.direction));
        if (w > 0) add(beta_ * environment->radiance(ray_.direction) * w, -1);
    }

    void add_emission(const SurfaceHit& s) {
        if (s.light < 0) return;
        const bool front = dot(s.point.n_g, ray_.direction) < 0;
        const Spectrumf radiance = scene_.lights().emitted(s.light, s.point.uv, front);
        if (radiance.is_black()) return;
        const LightHit hit{s.light, s.primitive, s.point.p, s.point.n_g};
        const float w = emission_weight(specular_ ? 0 : scene_.lights().pdf(from_, hit));
        if (w > 0) add(beta_ * radiance * w, s.material);
    }

    /// Direct light and the next direction; false where the path ends.
    bool scatter(const SurfaceHit& s, float eta_rel) {
        const bool last = settings_.max_depth >= 0 && depth_ >= settings_.max_depth;
        if (last && !scene_.materials()[s.material].passes) return false;
        if (depth_ >= kDepthGuard) {
            ++counters_.depth_guard;
            return false;
        }
        const Vec3f wo = -ray_.direction;
        const Bsdf bsdf(scene_.materials(), s.material, s.point, wo, eta_rel);
        const GuidedBsdf guided_bsdf(bsdf, hidden_light(s, bsdf), s.point.p);
        if (!last && !scene_.lights().empty() && !bsdf.is_delta()) direct(s, guided_bsdf, wo);

        const SampleBlock u = sampler_.block(std::uint32_t(depth_ + passed_), Purpose::kBsdf);
        const auto sample = guided_bsdf.sample(wo, u.uniform3(0), counters_);
        if (!sample) return false;
        if ((sample->lobe & kNull) != 0) return pass(s);
        if (last) return false;
        beta_ *= sample->weight;
        ++depth_;
        specular_ = (sample->lobe & kSpecular) != 0;
        bsdf_pdf_ = sample->pdf;
        from_ = s.point.p;
        if ((sample->lobe & kTransmission) != 0) {
            eta_scale_ *= sample->eta * sample->eta;
            if (scene_.materials()[s.material].has_interior)
                move_through(scene_, s, dot(s.point.n_g, wo) > 0, interior_, counters_);
        }
        ray_ = {offset_origin(s.point.p, s.error, s.point.n_g, sample->wi), sample->wi};
        return survive(u.uniform(3));
    }

    /// Goes on as if the surface were not there: no event, and lights ahead are still seen from the
    /// last scattering point.
    bool pass(const SurfaceHit& s) {
        ++passed_;
        if (scene_.materials()[s.material].has_interior)
            move_through(scene_, s, dot(s.point.n_g, ray_.direction) < 0, interior_, counters_);
        ray_.origin = offset_origin(s.point.p, s.error, s.point.n_g, ray_.direction);
        return true;
    }

    const PhotonGuide::Region* hidden_light(const SurfaceHit& s, const Bsdf& bsdf) const {
        const PhotonGuide* caustics = settings_.guide_caustics ? scene_.caustics() : nullptr;
        return caustics != nullptr && guided(bsdf.lobes()) ? caustics->find(s.point.p) : nullptr;
    }

    void direct(const SurfaceHit& s, const GuidedBsdf& bsdf, Vec3f wo) {
        const auto light = scene_.lights().sample(
            s.point.p, sampler_.block(std::uint32_t(depth_ + passed_), Purpose::kLight));
        if (!light || (settings_.strategy == Strategy::kBsdfOnly && !light->delta)) return;
        const auto value = bsdf.eval(wo, light->wi, counters_);
        if (value.f.is_black()) return;
        const float w = light->delta || settings_.strategy == Strategy::kLightOnly
                            ? 1.0F
                            : power_heuristic(light->pdf, value.pdf);
        const Spectrumf contribution = beta_ * value.f * light->weight * w;
        if (contribution.is_black()) return;
        InteriorStack inside = interior_;
        const float side = dot(s.point.n_g, wo) * dot(s.point.n_g, light->wi);
        if (side < 0 && scene_.materials()[s.material].has_interior)
            move_through(scene_, s, dot(s.point.n_g, wo) > 0, inside, counters_);
        add(contribution * transmittance(scene_, s, *light, inside, counters_), s.material);
    }

    /// Russian roulette on the throughput without its radiance compression, so that a path inside
    /// glass, whose radiance is scaled by 1/eta^2 until it leaves, does not die early.
    bool survive(float u) {
        if (beta_.is_black()) return false;
        if (depth_ < kRouletteDepth) return true;
        const float q = beta_.max_value() * eta_scale_;
        if (q >= 1) return true;
        if (u >= q) return false;
        beta_ *= 1 / q;
        return true;
    }

    PathResult finish() const {
        if (!L_.is_finite()) {
            counters_.reject(Reject::kNonFiniteRadiance, -1);
            return {Spectrumf(), alpha_};
        }
        if (L_.has_negative()) counters_.reject(Reject::kNegativeRadiance, -1);
        return {L_, alpha_};
    }

    const Scene& scene_;
    const PathSettings& settings_;
    const Sampler& sampler_;
    Counters& counters_;
    InteriorStack interior_;
    Ray ray_;
    Vec3f from_;  // the last scattering point: densities of light sampling are seen from there
    Spectrumf beta_{1.0F}, L_;
    float alpha_ = 1, eta_scale_ = 1, bsdf_pdf_ = 0;
    bool specular_ = true;
    int lane_ = -1;               // the one lane of a path that has met a dispersive interface
    int depth_ = 0, passed_ = 0;  // scattering events; surfaces passed through, which are none
};

}  // namespace

PathResult PathIntegrator::sample(int x, int y, std::uint32_t replicate, std::uint64_t index,
                                  Counters& counters) const {
    const Sampler sampler(settings_.seed, replicate, x, y, index);
    const SampleBlock u = sampler.block(0, Purpose::kFilm);
    const Vec2f offset = scene_->film().filter.sample(u.uniform2(0));
    const CameraRay ray = scene_->camera().ray(
        {float(x) + 0.5F + offset.x, float(y) + 0.5F + offset.y}, u.uniform2(2));
    ++counters.samples;
    if (!ray.sees) return {Spectrumf(), 0};
    return Walk(*scene_, settings_, sampler, counters).run({ray.origin, ray.direction});
}

}  // namespace matiere
