#include "integrator/kernels.h"
#include "render/fill_chunk.h"
#include "render/render.h"
#include "scene/scene.h"

namespace matiere {

std::optional<ChunkFilm> render_chunk(const Scene& scene, const Settings& settings,
                                      const Plan& plan, std::uint32_t index,
                                      const CancelToken& cancel) {
    const PathIntegrator integrator(scene, settings);
    const auto& crop = scene.film().crop;
    ChunkSource source{{}, settings.seed, scene.features(), 0, 0};
    if (crop) source.origin = {(*crop)[0], (*crop)[1]};
    source.kernels = 1U << unsigned(&integrator.kernel() - kernels().data());
    source.aovs = settings.aovs;
    if (settings.aovs != 0)
        return fill_chunk(plan, index, source, cancel, [&](const SampleId& id, Counters& counters) {
            return integrator.sample_layers(id, counters);
        });
    return fill_chunk(plan, index, source, cancel, [&](const SampleId& id, Counters& counters) {
        return integrator.sample(id, counters);
    });
}

}  // namespace matiere
