#include "integrator/kernels.h"
#include "integrator/light_path.h"
#include "render/fill_chunk.h"
#include "render/render.h"
#include "scene/scene.h"

namespace matiere {

namespace {

/// Camera samples for one path from the lights, which costs 1 to 3 of them and is seen in many
/// pixels: 4 and 8 had the least error in a given time on most scenes of
/// tests/bench/light_layer.py.
constexpr std::uint64_t kSamplesPerLightPath = 4;

/// The light paths that go with a chunk. Their indices are its own, without a gap from chunk to
/// chunk of a film that is not adaptive.
bool add_light_paths(const Scene& scene, const LightLayer& layer, const Settings& settings,
                     const CancelToken& cancel, ChunkFilm& film) {
    const FlushDenormals float_mode;
    const double start = thread_cpu_seconds();
    const Plan& plan = film.plan();
    const Chunk& c = film.chunk();
    const auto replicates = std::uint64_t(plan.replicates());
    const std::uint64_t each = (c.s1 - c.s0) / replicates;
    const auto before = std::uint64_t(c.y0) * std::uint64_t(plan.width()) +
                        std::uint64_t(c.height()) * std::uint64_t(c.x0);
    const std::uint64_t pixels = std::uint64_t(plan.width()) * std::uint64_t(plan.height());
    const auto rounded_up = [](std::uint64_t samples) {
        return (samples + kSamplesPerLightPath - 1) / kSamplesPerLightPath;
    };
    const std::uint64_t sample = c.s0 / replicates * pixels + before * each;
    const std::uint64_t first = rounded_up(sample);
    const std::uint64_t paths = rounded_up(sample + std::uint64_t(c.pixels()) * each) - first;
    SplatWindow window{&scene.film().filter, 0, 0, plan.width(), plan.height()};
    if (const auto& crop = scene.film().crop)
        window = {&scene.film().filter, (*crop)[0], (*crop)[1], (*crop)[2], (*crop)[3]};
    film.begin_splats(paths);
    const auto each_one = std::size_t(c.replicates());
    const bool lobes = film.layout().has_lobes();
    for (int r = c.r0; r < c.r1; ++r) {
        const auto own = std::size_t(r - c.r0);
        const LightPathSums sums{window,
                                 film.splats()[own],
                                 lobes ? &film.splats()[each_one] : nullptr,
                                 lobes ? &film.splats()[each_one + 1] : nullptr,
                                 film.cuts()[std::size_t(Cut::kDepth) - 1],
                                 film.work().counters};
        for (std::uint64_t i = 0; i < paths; ++i) {
            if (i % 1024 == 0 && cancel.cancelled()) return false;
            trace_light_path(scene, layer, settings, {std::uint32_t(r), first + i}, sums);
        }
    }
    film.work().cpu_s += thread_cpu_seconds() - start;
    return true;
}

}  // namespace

std::optional<ChunkFilm> render_chunk(const Scene& scene, const Settings& settings,
                                      const Plan& plan, std::uint32_t index,
                                      const CancelToken& cancel) {
    const PathIntegrator integrator(scene, settings);
    const auto& crop = scene.film().crop;
    ChunkSource source{{}, settings.seed, scene.features(), 0, 0};
    if (crop) source.origin = {(*crop)[0], (*crop)[1]};
    source.kernels = 1U << unsigned(&integrator.kernel() - kernels().data());
    source.aovs = settings.aovs;
    auto chunk = settings.aovs != 0 ? fill_chunk(plan, index, source, cancel,
                                                 [&](const SampleId& id, Counters& counters) {
                                                     return integrator.sample_layers(id, counters);
                                                 })
                                    : fill_chunk(plan, index, source, cancel,
                                                 [&](const SampleId& id, Counters& counters) {
                                                     return integrator.sample(id, counters);
                                                 });
    const LightLayer* layer = light_layer(scene, settings);
    if (chunk && layer != nullptr && !add_light_paths(scene, *layer, settings, cancel, *chunk))
        return std::nullopt;
    return chunk;
}

}  // namespace matiere
