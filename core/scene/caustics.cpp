#include "scene/caustics.h"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <thread>

#include "base/parallel.h"
#include "base/rng.h"
#include "material/bsdf_for.h"
#include "sampling/discrete.h"
#include "sampling/warp.h"
#include "scene/light_layer.h"
#include "scene/scene.h"

namespace matiere {

namespace {

constexpr std::uint64_t kSeed = 0x63617573746963ULL;
/// Photons started from every sharp surface to see what they are worth, and in all after that: at
/// most so many, fewer for a small film, whose samples would take less time than the search.
constexpr std::uint32_t kPilot = 1 << 11, kStarts = 1 << 19;
constexpr std::uint32_t kLeastPilot = 1 << 10, kLeastStarts = 1 << 13, kStartsPerPixel = 8;
constexpr std::uint32_t kBlock = 1 << 10;  // photons of one unit of work
constexpr int kMaxDepth = 16;
/// A direction sampled with less density than this [1/sr] is one that camera paths find well.
constexpr float kSharpDensity = 4;
/// Light this many times the mean is hard to find by luck.
constexpr float kHardness = 8;
/// Landed photons of the pilot below which the rest is not worth a search.
constexpr std::size_t kFewLanded = 8;
constexpr float kShadowEnd = 1 - 0x1p-16F;

struct Landed {
    GuidePhoton photon;
    float radiance;  ///< what a camera path would find in its direction
    int light;
};

struct Harvest {
    std::vector<Landed> landed;
    double irradiance = 0;  ///< sum over the starts of the light before anything shadows it
};

/// One photon: from a point on a sharp surface, where a light was seen, onwards.
class Photon {
 public:
    Photon(const Scene& scene, Pcg32& rng, Harvest& harvest)
        : scene_(scene), rng_(rng), harvest_(harvest) {}

    /// `area` is the surface that this photon stands for.
    void run(SurfaceHit s, float area) {
        const auto light = scene_.lights().sample({s.point.p}, block());
        if (!light) return;
        light_ = light->light;
        const float cosine = std::abs(dot(s.point.n_g, light->wi));
        flux_ = light->weight.luminance() * cosine * area;
        harvest_.irradiance += double(light->weight.luminance() * cosine);
        if (!(flux_ > 0) || shadowed(s, *light)) return;
        if (!first_event(s, *light)) return;
        for (int depth = 0; depth < kMaxDepth; ++depth) {
            const RayHit hit = scene_.intersect(ray_);
            if (hit.missed()) return;
            fade(hit.t);
            const SurfaceHit next = scene_.surface(ray_, hit);
            if (next.material < 0) return;
            land(s, next);
            if (!event(next)) return;
            s = next;
        }
    }

 private:
    SampleBlock block() { return {{rng_.next(), rng_.next(), rng_.next(), rng_.next()}}; }

    bool shadowed(const SurfaceHit& s, const LightSample& light) const {
        const Vec3f origin = offset_origin(s.point.p, s.error, s.point.n_g, light.wi);
        if (light.infinite) return scene_.occluded({origin, light.wi});
        const Vec3f target = offset_origin(light.p, light.error, light.n, -light.wi);
        return scene_.occluded({origin, target - origin, kShadowEnd});
    }

    bool first_event(const SurfaceHit& s, const LightSample& light) {
        const bool interior = scene_.materials()[s.material].has_interior;
        if (interior && dot(s.point.n_g, light.wi) < 0)
            inside_.enter(s.material, scene_.materials()[s.material], counters_);
        const auto sample = scatter(s, light.wi);
        if (!sample) return false;
        const bool delta = (sample->lobe & kSpecular) != 0;
        if (delta && light.delta) return false;  // no camera path can find it
        // Found by a sampled direction that meets the light, or by looking for the light from here.
        float radiance = kInfinity<float>;
        if (!light.delta) radiance = light.weight.luminance() * light.pdf;
        if (!delta) {
            const float cosine = std::max(std::abs(dot(s.point.n_g, sample->wi)), 1e-3F);
            const float f = sample->weight.luminance() * sample->pdf / cosine;
            radiance = std::min(radiance, f * flux_per_area(s, light));
        }
        radiance_ *= radiance;
        return true;
    }

    static float flux_per_area(const SurfaceHit& s, const LightSample& light) {
        return light.weight.luminance() * std::abs(dot(s.point.n_g, light.wi));
    }

    /// A medium that scatters takes its part away; one that only absorbs changes no order of
    /// places.
    void fade(float t) {
        const int medium = inside_.current();
        if (medium < 0 || !scene_.materials()[medium].scatters) return;
        const float left = std::exp(-scene_.materials()[medium].sigma_t.min_value() * t);
        flux_ *= left;
        radiance_ *= left;
    }

    bool event(const SurfaceHit& s) { return scatter(s, -ray_.direction).has_value(); }

    /// The next sharp event, or nothing where the photon ends.
    std::optional<BsdfSample<float>> scatter(const SurfaceHit& s, Vec3f wo) {
        float eta_rel = 1;
        const MaterialRecord& record = scene_.materials()[s.material];
        const bool entering = dot(s.point.n_g, wo) > 0;
        if (record.has_interior) {
            const auto crossing =
                cross_interface(scene_.materials(), s.material, entering, inside_);
            if (crossing.hidden) return std::nullopt;
            eta_rel = crossing.eta_rel;
        }
        const Bsdf bsdf(scene_.materials(), s.material, s.point, wo, eta_rel);
        const auto sample =
            bsdf.sample(wo, {rng_.uniform(), rng_.uniform(), rng_.uniform()}, counters_);
        if (!sample || !is_sharp(*sample)) return std::nullopt;
        const float through = sample->weight.luminance() * sample->eta * sample->eta;
        const float survival = std::min(through, 1.0F);
        if (!(rng_.uniform() < survival)) return std::nullopt;
        flux_ *= through / survival;
        radiance_ *= through / survival;
        if ((sample->lobe & kTransmission) != 0 && record.has_interior) {
            if (entering)
                inside_.enter(s.material, record, counters_);
            else
                inside_.leave(s.material, counters_);
        }
        ray_ = {offset_origin(s.point.p, s.error, s.point.n_g, sample->wi), sample->wi};
        return sample;
    }

    static bool is_sharp(const BsdfSample<float>& sample) {
        return (sample.lobe & kSpecular) != 0 || sample.pdf > kSharpDensity;
    }

    void land(const SurfaceHit& from, const SurfaceHit& s) {
        if (guided(scene_.materials()[s.material].lobes))
            harvest_.landed.push_back({{s.point.p, from.point.p, flux_}, radiance_, light_});
    }

    const Scene& scene_;
    Pcg32& rng_;
    Harvest& harvest_;
    Counters counters_;
    InteriorStack inside_;
    Ray ray_;
    float flux_ = 0, radiance_ = 1;
    int light_ = 0;
};

/// A mesh or a sphere whose material has a lobe that may be sharp.
class SharpSurface {
 public:
    SharpSurface(const Scene& scene, std::uint32_t mesh) : scene_(&scene), geometry_(mesh) {
        const Mesh& m = *scene.meshes()[mesh];
        std::vector<double> areas(m.triangle_count());
        for (std::size_t i = 0; i < areas.size(); ++i) {
            areas[i] = triangle_area(m, i);
            area_ += areas[i];
        }
        triangles_ = DiscreteDistribution(areas);
    }
    SharpSurface(const Scene& scene, const Sphere& sphere, std::uint32_t index)
        : scene_(&scene), geometry_(std::uint32_t(scene.meshes().size())), sphere_(&sphere) {
        primitive_ = index;
        area_ = 4 * kPi<double> * double(sphere.radius) * double(sphere.radius);
    }

    double area() const { return area_; }

    /// A point uniform on the surface.
    SurfaceHit sample(Pcg32& rng) const {
        if (sphere_ != nullptr) {
            const float u1 = rng.uniform(), u2 = rng.uniform();
            const Ray ray{sphere_->center, square_to_sphere(u1, u2)};
            return scene_->surface(ray, {sphere_->radius, geometry_, primitive_, 0, 0});
        }
        const auto choice = triangles_.sample(rng.next());
        const float r = std::sqrt(rng.uniform()), v = rng.uniform() * r;
        return scene_->surface(Ray{}, {0, geometry_, choice.index, 1 - r, v});
    }

 private:
    const Scene* scene_;
    std::uint32_t geometry_, primitive_ = 0;
    const Sphere* sphere_ = nullptr;
    DiscreteDistribution triangles_;
    double area_ = 0;
};

std::vector<SharpSurface> sharp_surfaces(const Scene& scene) {
    const auto sharp = [&](int material) {
        if (material < 0) return false;
        const std::uint8_t lobes = scene.materials()[material].lobes;
        return lobes != kNullLobes && (lobes & (kGlossy | kSpecular)) != 0;
    };
    std::vector<SharpSurface> out;
    for (std::uint32_t i = 0; i < scene.meshes().size(); ++i)
        if (sharp(scene.meshes()[i]->material)) out.emplace_back(scene, i);
    for (std::uint32_t i = 0; i < scene.spheres().size(); ++i)
        if (sharp(scene.spheres()[i].material)) out.emplace_back(scene, scene.spheres()[i], i);
    std::erase_if(out, [](const SharpSurface& s) { return !(s.area() > 0); });
    return out;
}

bool has_receiver(const MaterialTable& materials) {
    for (int i = 0; i < materials.size(); ++i)
        if (guided(materials[i].lobes)) return true;
    return false;
}

/// Photons of one surface; `first` sets them apart from those of another call.
struct Job {
    const SharpSurface* surface;
    std::uint32_t target, first, count;
    double area;  ///< that each photon stands for
};

bool raised(const CancelToken* cancel) { return cancel != nullptr && cancel->cancelled(); }

Harvest shoot(const Scene& scene, const Job& job, const CancelToken* cancel) {
    const FlushDenormals float_mode;
    Harvest harvest;
    for (std::uint32_t i = 0; i < job.count && !raised(cancel); ++i) {
        Pcg32 rng(hash_words(kSeed, job.target, job.first + i));
        const SurfaceHit start = job.surface->sample(rng);
        Photon(scene, rng, harvest).run(start, float(job.area));
    }
    return harvest;
}

/// The harvests of all jobs in their order, however many threads there are.
std::vector<Harvest> shoot_all(const Scene& scene, const std::vector<Job>& jobs, int threads,
                               const CancelToken* cancel) {
    std::vector<Harvest> out(jobs.size());
    std::atomic<std::size_t> next{0};
    const auto work = [&] {
        for (std::size_t i = next++; i < jobs.size(); i = next++)
            out[i] = shoot(scene, jobs[i], cancel);
    };
    if (threads <= 0) threads = int(std::thread::hardware_concurrency());
    std::vector<std::jthread> helpers;
    for (int i = 1; i < std::min(threads, int(jobs.size())); ++i) helpers.emplace_back(work);
    work();
    helpers.clear();
    return out;
}

/// Leaves the photons of light that is hard to find.
void keep_hard(std::vector<Harvest>& harvests, double threshold) {
    for (Harvest& h : harvests)
        std::erase_if(h.landed, [&](const Landed& l) {
            return !(double(l.radiance) > threshold && l.photon.weight > 0 &&
                     std::isfinite(l.photon.weight) &&
                     length_squared(l.photon.from - l.photon.p) > 0);
        });
}

/// How many photons the search is worth.
struct Effort {
    std::uint32_t pilot, starts;

    /// A function of film size, never of samples: a longer render goes on with the same guide.
    Effort(const FilmDescription& film, std::size_t surfaces) {
        const std::uint64_t pixels = std::uint64_t(film.width) * std::uint64_t(film.height);
        const auto wanted = std::min<std::uint64_t>(kStartsPerPixel * pixels, kStarts);
        starts = std::max(std::uint32_t(wanted), kLeastStarts);
        const std::uint32_t first = std::max(starts / (kStarts / kPilot), kLeastPilot);
        pilot = std::min(first, std::max(1U, kStarts / std::uint32_t(surfaces)));
    }
};

/// The photons of the second round: every surface gets its part of what the first found.
std::vector<Job> share_out(const std::vector<SharpSurface>& surfaces,
                           const std::vector<Harvest>& first, const Effort& effort) {
    std::vector<double> flux(surfaces.size());
    double total = 0;
    for (std::size_t k = 0; k < surfaces.size(); ++k) {
        for (const Landed& l : first[k].landed) flux[k] += double(l.photon.weight);
        total += flux[k];
    }
    std::vector<Job> jobs;
    for (std::size_t k = 0; k < surfaces.size(); ++k) {
        const auto n = std::uint32_t(double(effort.starts) * flux[k] / total);
        for (std::uint32_t i = 0; i < n; i += kBlock)
            jobs.push_back({&surfaces[k], std::uint32_t(k), effort.pilot + i,
                            std::min(kBlock, n - i), surfaces[k].area() / n});
    }
    return jobs;
}

}  // namespace

CausticScan trace_caustics(const Scene& scene, int threads, const CancelToken* cancel) {
    if (scene.lights().empty() || !has_receiver(scene.materials())) return {};
    const std::vector<SharpSurface> surfaces = sharp_surfaces(scene);
    if (surfaces.empty()) return {};

    const Effort effort(scene.film(), surfaces.size());
    const std::uint32_t pilot = effort.pilot;
    std::vector<Job> jobs;
    for (const SharpSurface& s : surfaces)
        jobs.push_back({&s, std::uint32_t(&s - surfaces.data()), 0, pilot, s.area() / pilot});
    std::vector<Harvest> found = shoot_all(scene, jobs, threads, cancel);
    if (raised(cancel)) return {};
    double irradiance = 0;
    for (const Harvest& h : found) irradiance += h.irradiance;
    irradiance /= double(pilot) * double(surfaces.size());
    const double threshold = kHardness * irradiance / kPi<double>;
    keep_hard(found, threshold);
    std::size_t landed = 0;
    for (const Harvest& h : found) landed += h.landed.size();
    if (landed < kFewLanded) return {};

    found = shoot_all(scene, share_out(surfaces, found, effort), threads, cancel);
    if (raised(cancel)) return {};
    keep_hard(found, threshold);
    CausticScan scan;
    scan.ordinary = irradiance;
    scan.hard.resize(std::size_t(scene.lights().size()));
    for (const Harvest& h : found)
        for (const Landed& l : h.landed) {
            scan.photons.push_back(l.photon);
            scan.lights.push_back(l.light);
            ++scan.hard[std::size_t(l.light)];
        }
    scan.guide = PhotonGuide(scan.photons, irradiance);
    return scan;
}

PhotonGuide guide_beside(CausticScan scan, const LightLayer& layer) {
    std::vector<GuidePhoton> left;
    for (std::size_t i = 0; i < scan.photons.size(); ++i)
        if (!layer.owns(scan.lights[i])) left.push_back(scan.photons[i]);
    if (left.empty()) return {};
    return {std::move(left), scan.ordinary};
}

}  // namespace matiere
