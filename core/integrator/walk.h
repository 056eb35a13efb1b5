// One path from the camera, as code for the features F alone: on a scene that needs no more it
// gives the same bits whatever F is, and counts the same rays.
#pragma once

#include <algorithm>
#include <type_traits>

#include "base/features.h"
#include "integrator/aov_layers.h"
#include "integrator/guided_bsdf.h"
#include "integrator/integrator.h"
#include "integrator/layer_split.h"
#include "integrator/medium.h"
#include "integrator/path_record.h"
#include "integrator/ray_cone.h"
#include "integrator/visibility.h"
#include "material/bsdf_for.h"
#include "sampling/mis.h"
#include "sampling/sampler.h"
#include "scene/caustics.h"
#include "scene/scene.h"

namespace matiere {

/// Scattering events after which a path is cut and counted: an endless path in a lossless box.
inline constexpr int kDepthGuard = 10000;
/// Scattering events before roulette may end a path.
inline constexpr int kRouletteDepth = 4;
/// Which number of the spare block picks the lane of a dispersed path.
inline constexpr int kLaneSlot = 1;

/// The media around a path, where a kernel knows of none.
struct NoInteriors {
    static constexpr bool empty() { return true; }
};

/// Where a kernel writes down no paths.
struct NoRecord {};

template <Features F>
class Walk {
 public:
    using Record = std::conditional_t<has(F, kRecords), PathRecord*,
                                      std::conditional_t<has(F, kCollects), AovLayers*, NoRecord>>;

    Walk(const Scene& scene, const PathSettings& settings, const Sampler& sampler,
         Counters& counters, Record record)
        : scene_(scene),
          settings_(settings),
          sampler_(sampler),
          counters_(counters),
          record_(record),
          cone_(scene.camera().footprint()) {
        if constexpr (kInteriors) interior_ = scene.camera_interior();
        if constexpr (kLayered) layer_.layer = light_layer(scene, settings);
    }

    PathResult run(Ray ray) {
        ray_ = ray;
        from_ = ray.origin;
        // Hidden interfaces do not scatter but must not loop for ever either.
        for (int segment = 0; segment < 2 * kDepthGuard; ++segment) {
            ++counters_.rays;
            const RayHit hit = scene_.intersect(ray_);
            if constexpr (kInteriors)
                if (!interior_.empty()) {
                    const Way way = cross_medium(hit);
                    if (way == Way::kEnded) break;
                    if (way == Way::kScattered) {
                        --segment;  // these have a guard of their own
                        continue;
                    }
                }
            if (hit.missed()) {
                escape();
                break;
            }
            SurfaceHit s = scene_.surface<F>(ray_, hit);
            if constexpr (kTextured)
                if (scene_.prefilters()) cone_.meet(s.point, hit.t, ray_.direction);
            if constexpr (kRecording) arrive(s, hit.t);
            float eta_rel = 1;
            if constexpr (kInteriors)
                if (s.material >= 0 && scene_.materials()[s.material].has_interior &&
                    !cross(s, eta_rel))
                    continue;
            if constexpr (kCollecting)
                if (depth_ == 0) record_->meet(s.point, s.material, from_, ray_.direction);
            add_emission(s);
            if (s.material < 0) {
                note_end("emitter");
                break;
            }
            if (!scatter(s, eta_rel)) break;
        }
        return finish();
    }

 private:
    static constexpr bool kInteriors = has(F, kNeedsInteriors);
    static constexpr bool kPasses = has(F, kNeedsPassing);
    static constexpr bool kScattering = has(F, kNeedsScattering);
    static constexpr bool kRecording = has(F, kRecords);
    static constexpr bool kCollecting = has(F, kCollects);
    static constexpr bool kTextured = has(F, kNeedsTextures);
    static constexpr bool kLayered = has(F, kNeedsLightLayer);
    using BsdfHere = BsdfFor<F & kKernelFeatures>;

    int inside_events() const { return kScattering ? inside_events_ : 0; }

    const MaterialRecord& material(const SurfaceHit& s) const {
        return scene_.materials()[s.material];
    }

    /// What became of a path on its way through a medium.
    enum class Way { kThrough, kScattered, kEnded };

    [[gnu::always_inline]] Way cross_medium(const RayHit& hit) {
        if constexpr (kScattering) {
            const int medium = interior_.current();
            if (medium >= 0 && scene_.materials()[medium].scatters) return fly(medium, hit);
        }
        beta_ *= absorb(scene_, interior_, hit.missed() ? kInfinity<float> : hit.t);
        return Way::kThrough;
    }

    /// Through a medium that scatters: to its boundary, or to a scattering event before it.
    Way fly(int medium, const RayHit& hit) {
        if (hit.missed()) {  // its shape is not closed
            ++counters_.unmatched_exits;
            interior_ = {};
            return Way::kThrough;
        }
        const MaterialRecord& m = scene_.materials()[medium];
        const SampleBlock u = sampler_.block(kFirstFlight + flights_++, Purpose::kSpare);
        const auto flight =
            sample_flight(m.sigma_s, m.sigma_t, beta_, hit.t, u.uniform(0), u.uniform(1));
        beta_ = flight.carried;
        if (!flight.meets) return Way::kThrough;

        SurfaceHit event;
        event.point.p = point_before(ray_, flight.distance, scene_.surface<F>(ray_, hit));
        event.material = medium;
        if constexpr (kTextured)
            if (scene_.prefilters()) cone_.meet(event.point, flight.distance, ray_.direction);
        if constexpr (kRecording) arrive(event, flight.distance);
        ++inside_events_;
        if (is_last()) return end_inside("max_depth");
        if (inside_events_ >= kMediumGuard) {
            ++counters_.depth_guard;
            return end_inside("depth_guard");
        }
        const PhaseBsdf phase(m.g);
        const bool on = scatter_with(event, phase, -ray_.direction, {}, false, false);
        if constexpr (kRecording)
            if (here().event == "scatter") here().event = "scatter_inside";
        return on ? Way::kScattered : Way::kEnded;
    }

    Way end_inside(std::string_view why) {
        note_end(why);
        return Way::kEnded;
    }

    /// Finds the relative index of an interface; false where it is hidden and the path went on.
    bool cross(const SurfaceHit& s, float& eta_rel) {
        const bool entering = dot(s.point.n_g, ray_.direction) < 0;
        auto crossing = cross_interface(scene_.materials(), s.material, entering, interior_,
                                        std::max(lane_, 0));
        if (crossing.hidden) {
            if constexpr (kRecording) here().event = "hidden";
            move_through(scene_, s, entering, interior_, counters_);
            ray_.origin = offset_origin(s.point.p, s.error, s.point.n_g, ray_.direction);
            return false;
        }
        if (has(F, kNeedsDispersion) && crossing.dispersive && lane_ < 0) {
            pick_lane();
            crossing = cross_interface(scene_.materials(), s.material, entering, interior_, lane_);
        }
        eta_rel = crossing.eta_rel;
        return true;
    }

    /// At the first dispersive interface of a path: from there on it carries one lane, picked in
    /// proportion to the light it carries, for all of them.
    void pick_lane() {
        const float sum = beta_[0] + beta_[1] + beta_[2];
        const SampleBlock u = sampler_.block(std::uint32_t(depth_), Purpose::kSpare);
        lane_ = beta_.pick(u.uniform(kLaneSlot));
        Spectrumf one;
        one[lane_] = sum;
        beta_ = one;
    }

    float emission_weight(float light_pdf) const {
        if (specular_ || settings_.strategy == Strategy::kBsdfOnly) return 1;
        if (settings_.strategy == Strategy::kLightOnly) return light_pdf > 0 ? 0.0F : 1.0F;
        return power_heuristic(bsdf_pdf_, light_pdf);
    }

    /// Light that arrives after `events` scattering events.
    void add(const Spectrumf& value, int material, int events) {
        if (value.is_finite()) {
            L_ += value;
            if constexpr (kCollecting) record_->add(value, events);
        } else {
            counters_.reject(Reject::kNonFiniteEmission, material);
        }
    }

    void escape() {
        note_end("escaped");
        const EnvironmentLight* environment = scene_.lights().environment();
        if (depth_ == 0) {
            if (settings_.transparent_background) {
                alpha_ = 0;
                return;
            }
            if (scene_.backdrop() != nullptr) return see_backdrop(*scene_.backdrop());
        }
        if (environment == nullptr) return;
        const auto seen = scene_.lights().see_environment({from_, from_n_}, ray_.direction);
        const float pdf = specular_ ? 0 : seen.pdf;
        const float w = emission_weight(pdf);
        if (!(w > 0)) return;
        const Spectrumf arrived = beta_ * seen.radiance * w;
        add(arrived, -1, depth_);
        if constexpr (kRecording)
            record_->background.push_back(
                met(scene_.lights().environment_index(), ray_.direction, pdf, w, arrived));
    }

    /// What the camera sees where no light comes from.
    void see_backdrop(const EnvironmentLight& backdrop) {
        const Spectrumf arrived = beta_ * backdrop.radiance(ray_.direction);
        add(arrived, -1, 0);
        if constexpr (kRecording)
            record_->background.push_back(met(-1, ray_.direction, 0, 1, arrived));
    }

    void add_emission(const SurfaceHit& s) {
        if (s.light < 0) return;
        const bool front = dot(s.point.n_g, ray_.direction) < 0;
        const TexturePoint at = kReadsUv<F> ? s.point.texture_point() : TexturePoint{};
        const Spectrumf radiance = scene_.lights().emitted(s.light, at, front);
        if (radiance.is_black()) return;
        if constexpr (kLayered)
            if (layer_.owns(s.light)) return;
        const LightHit hit{s.light, s.primitive, s.point.p, s.point.n_g};
        const float pdf = specular_ ? 0 : scene_.lights().pdf(from_, hit);
        const float w = emission_weight(pdf);
        if (!(w > 0)) return;
        const Spectrumf arrived = beta_ * radiance * w;
        add(arrived, s.material, depth_);
        if constexpr (kRecording)
            here().lights.push_back(met(s.light, ray_.direction, pdf, w, arrived));
    }

    /// No event may follow: the path is cut, or passes on without scattering and without the light
    /// that it would have looked for.
    bool is_last() {
        if (settings_.max_depth < 0 || depth_ < settings_.max_depth) return false;
        cut_ = Cut::kDepth;
        return true;
    }

    /// Direct light and the next direction; false where the path ends.
    bool scatter(const SurfaceHit& s, float eta_rel) {
        const bool last = is_last();
        if (last && !(kPasses && material(s).passes)) return note_end("max_depth");
        if (depth_ - inside_events() >= kDepthGuard) {
            ++counters_.depth_guard;
            return note_end("depth_guard");
        }
        const Vec3f wo = -ray_.direction;
        const BsdfHere bsdf(scene_.materials(), s.material, s.point, wo, eta_rel);
        if constexpr (kCollecting)
            if (depth_ == 0) record_->shading_normal(bsdf.frame().n);
        if constexpr (has(F, kNeedsGuide)) {
            const GuidedBsdf guided_bsdf(bsdf, hidden_light(s, bsdf), s.point.p);
            if constexpr (kRecording) here().guided = hidden_light(s, bsdf) != nullptr;
            return scatter_with(s, guided_bsdf, wo, lit_side(bsdf), last || bsdf.is_delta(), last);
        } else {
            return scatter_with(s, bsdf, wo, lit_side(bsdf), last || bsdf.is_delta(), last);
        }
    }

    /// The normal of a surface that is lit from its side alone, for the choice of lights.
    static Vec3f lit_side(const BsdfHere& bsdf) {
        if constexpr (!has(F, kNeedsLights)) return {};
        return (bsdf.lobes() & kTransmission) != 0 ? Vec3f{} : bsdf.frame().n;
    }

    template <class B>
    [[gnu::always_inline]] bool scatter_with(const SurfaceHit& s, const B& bsdf, Vec3f wo, Vec3f n,
                                             bool unlit, bool last) {
        if (!unlit && !scene_.lights().empty()) direct(s, bsdf, wo, n);
        const SampleBlock u = sampler_.block(std::uint32_t(depth_ + passed_), Purpose::kBsdf);
        const auto sample = bsdf.sample(wo, u.uniform3(0), counters_);
        if (!sample) return note_end("absorbed");
        if constexpr (kPasses)
            if ((sample->lobe & kNull) != 0) return pass(s);
        if (last) return note_end("max_depth");
        if constexpr (kRecording) depart(*sample);
        if constexpr (kCollecting)
            if (depth_ == 0) collect(bsdf, wo, *sample);
        beta_ *= sample->weight;
        if constexpr (kLayered) layer_.scatter(s.material, sample->lobe, depth_);
        ++depth_;
        specular_ = (sample->lobe & kSpecular) != 0;
        bsdf_pdf_ = sample->pdf;
        if constexpr (kTextured)
            if (!specular_) cone_.scatter(sample->pdf);
        from_ = s.point.p;
        if constexpr (has(F, kNeedsLights)) from_n_ = n;
        if (has(F, kNeedsModels) && (sample->lobe & kTransmission) != 0) {
            eta_scale_ *= sample->eta * sample->eta;
            if constexpr (kInteriors)
                if (material(s).has_interior)
                    move_through(scene_, s, dot(s.point.n_g, wo) > 0, interior_, counters_);
        }
        ray_ = {offset_origin(s.point.p, s.error, s.point.n_g, sample->wi), sample->wi};
        return survive(u.uniform(3));
    }

    /// Goes on as if the surface were not there: no event, and lights ahead are still seen from the
    /// last scattering point.
    bool pass(const SurfaceHit& s) {
        ++passed_;
        if constexpr (kRecording) here().event = "pass";
        if constexpr (kCollecting)
            if (depth_ == 0) record_->pass();
        if constexpr (kInteriors)
            if (material(s).has_interior)
                move_through(scene_, s, dot(s.point.n_g, ray_.direction) < 0, interior_, counters_);
        ray_.origin = offset_origin(s.point.p, s.error, s.point.n_g, ray_.direction);
        return true;
    }

    const PhotonGuide::Region* hidden_light(const SurfaceHit& s, const BsdfHere& bsdf) const {
        const PhotonGuide* caustics = settings_.guide_caustics ? scene_.caustics() : nullptr;
        if constexpr (kLayered)
            if (layer_.begins_wide(depth_)) caustics = caustics_beside_layer();
        return caustics != nullptr && guided(bsdf.lobes()) ? caustics->find(s.point.p) : nullptr;
    }

    const PhotonGuide* caustics_beside_layer() const {
        return settings_.guide_caustics ? scene_.caustics_beside_layer() : nullptr;
    }

    template <class B>
    [[gnu::always_inline]] void direct(const SurfaceHit& s, const B& bsdf, Vec3f wo,
                                       [[maybe_unused]] Vec3f n) {
        const SampleBlock u = sampler_.block(std::uint32_t(depth_ + passed_), Purpose::kLight);
        if constexpr (has(F, kNeedsLights)) {
            if (const auto light = scene_.lights().sample({s.point.p, n}, u))
                connect(s, bsdf, wo, *light);
        } else {
            const LightSample light = scene_.lights().sample_rectangle(s.point.p, u);
            if (light.pdf > 0) connect(s, bsdf, wo, light);
        }
    }

    template <class B>
    [[gnu::always_inline]] void connect(const SurfaceHit& s, const B& bsdf, Vec3f wo,
                                        const LightSample& light) {
        if (settings_.strategy == Strategy::kBsdfOnly && !light.delta) return;
        if constexpr (kLayered)
            if (layer_.owns_from(s.material, light.light)) return;
        const auto value = bsdf.eval(wo, light.wi, counters_);
        if (value.f.is_black()) return;
        const float w = light.delta || settings_.strategy == Strategy::kLightOnly
                            ? 1.0F
                            : power_heuristic(light.pdf, value.pdf);
        const Spectrumf contribution = beta_ * value.f * light.weight * w;
        if (contribution.is_black()) return;
        const Spectrumf arrived = contribution * shadow(s, light, wo);
        if constexpr (kCollecting)
            if (depth_ == 0) record_->split(lobes_of(bsdf, wo, light.wi));
        add(arrived, s.material, depth_ + 1);
        if constexpr (kRecording)
            here().lights.push_back({"light", light.light, light.wi, light.pdf, value.pdf, w,
                                     arrived, arrived.is_black()});
    }

    /// The part of a light sample that arrives.
    Spectrumf shadow(const SurfaceHit& s, const LightSample& light, Vec3f wo) {
        if constexpr (kInteriors) {
            InteriorStack inside = interior_;
            const float side = dot(s.point.n_g, wo) * dot(s.point.n_g, light.wi);
            if (side < 0 && material(s).has_interior)
                move_through(scene_, s, dot(s.point.n_g, wo) > 0, inside, counters_);
            return transmittance(scene_, s, light, inside, counters_);
        } else if constexpr (kPasses) {
            return transmittance(scene_, s, light, {}, counters_);
        } else {
            ++counters_.shadow_rays;
            return Spectrumf(scene_.occluded(shadow_ray(s, light)) ? 0.0F : 1.0F);
        }
    }

    /// Russian roulette on the throughput without its radiance compression, so that a path inside
    /// glass, whose radiance is scaled by 1/eta^2 until it leaves, does not die early.
    bool survive(float u) {
        if (beta_.is_black()) return note_end("black");
        const bool young = depth_ < kRouletteDepth;
        if (young && settings_.threshold <= 0) return true;
        float q = beta_.max_value() * eta_scale_;
        if (q * kept_ < settings_.threshold) {
            cut_ = Cut::kThreshold;
            return note_end("threshold");
        }
        if (young) return true;
        if constexpr (kScattering) q /= event_limit(inside_events_);
        if (q >= 1) return true;
        if constexpr (kRecording) here().survival = q;
        if (u >= q) return note_end("roulette");
        beta_ *= 1 / q;
        kept_ *= q;
        return true;
    }

    PathResult finish() const {
        if (!L_.is_finite()) {
            counters_.reject(Reject::kNonFiniteRadiance, -1);
            return {Spectrumf(), alpha_};
        }
        if (L_.has_negative()) counters_.reject(Reject::kNegativeRadiance, -1);
        return {L_, alpha_, cut_};
    }

    // What the recording kernel writes down; nothing in the others.

    PathVertex& here() { return record_->vertices.back(); }

    bool note_end(std::string_view why) {
        if constexpr (kRecording) record_->end = why;
        return false;
    }

    // What the layers of a film are told by the kernel that collects them.

    template <class B>
    static LobeSplit lobes_of(const B& bsdf, Vec3f wo, Vec3f wi) {
        if constexpr (requires { bsdf.split(wo, wi); })
            return bsdf.split(wo, wi);
        else
            return {{}, true};  // scattered inside a medium
    }

    template <class B>
    void collect(const B& bsdf, Vec3f wo, const BsdfSample<float>& sample) {
        if constexpr (requires { bsdf.split(wo, wo); }) record_->scatter(sample);
        const bool through = (sample.lobe & kTransmission) != 0;
        if (through || (sample.lobe & kSpecular) != 0)
            record_->split({{}, through});
        else
            record_->split(lobes_of(bsdf, wo, sample.wi));
    }

    void arrive(const SurfaceHit& s, float distance) {
        PathVertex v;
        v.event = "end";
        v.p = s.point.p;
        v.n_g = s.point.n_g;
        v.n_s = s.point.n_s;
        v.distance = distance;
        v.material = s.material;
        v.light = s.light;
        v.medium = interior_.current();
        v.outside = dot(s.point.n_g, ray_.direction) < 0;
        v.throughput = beta_;
        v.lane = lane_;
        record_->vertices.push_back(std::move(v));
    }

    void depart(const BsdfSample<float>& sample) {
        PathVertex& v = here();
        v.event = "scatter";
        v.lobe = sample.lobe;
        v.pdf = sample.pdf;
        v.weight = sample.weight;
        v.eta = sample.eta;
        v.lane = lane_;
    }

    LightMeeting met(int light, Vec3f direction, float pdf, float w, const Spectrumf& arrived) {
        return {
            depth_ == 0 ? "camera" : "bsdf", light, direction, pdf, bsdf_pdf_, w, arrived, false};
    }

    const Scene& scene_;
    const PathSettings& settings_;
    const Sampler& sampler_;
    Counters& counters_;
    [[no_unique_address]] Record record_;
    [[no_unique_address]] std::conditional_t<kTextured, RayCone, NoCone> cone_;
    [[no_unique_address]] std::conditional_t<kInteriors, InteriorStack, NoInteriors> interior_;
    Ray ray_;
    Vec3f from_;    // the last scattering point: densities of light sampling are seen from there
    Vec3f from_n_;  // and the side that it looks for light on
    Spectrumf beta_{1.0F}, L_;
    [[no_unique_address]] std::conditional_t<kLayered, LayerSplit, NoLayer> layer_;
    float alpha_ = 1, eta_scale_ = 1, bsdf_pdf_ = 0;
    float kept_ = 1;  // with which probability roulette let it live so far
    bool specular_ = true;
    Cut cut_ = Cut::kNone;
    int lane_ = -1;               // the one lane of a path that has met a dispersive interface
    int depth_ = 0, passed_ = 0;  // scattering events; surfaces passed through, which are none
    int inside_events_ = 0;       // of `depth_`: those inside media
    std::uint32_t flights_ = 0;   // ways through media that scatter
};

/// One sample.
template <Features F>
PathResult trace_path(const Scene& scene, const PathSettings& settings, const SampleId& id,
                      Counters& counters, typename Walk<F>::Record record) {
    const Sampler sampler(settings.seed, id.replicate, id.x, id.y, id.index);
    const SampleBlock u = sampler.block(0, Purpose::kFilm);
    const Vec2f offset = scene.film().filter.sample(u.uniform2(1));
    const CameraRay ray =
        scene.camera().ray({float(id.x) + 0.5F + offset.x, float(id.y) + 0.5F + offset.y},
                           {u.uniform(0), u.uniform(3)});
    ++counters.samples;
    if (!ray.sees) return {Spectrumf(), 0};
    if constexpr (has(F, kRecords)) {
        record->origin = ray.origin;
        record->direction = ray.direction;
    }
    return Walk<F>(scene, settings, sampler, counters, record).run({ray.origin, ray.direction});
}

template <Features F>
PathResult sample_path(const Scene& scene, const PathSettings& settings, const SampleId& id,
                       Counters& counters) {
    return trace_path<F>(scene, settings, id, counters, {});
}

}  // namespace matiere
