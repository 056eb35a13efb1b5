#include "render/fill_chunk.h"
#include "render/render.h"
#include "scene/scene.h"

namespace matiere {

std::optional<ChunkFilm> render_chunk(const Scene& scene, const Settings& settings,
                                      const Plan& plan, std::uint32_t index,
                                      const CancelToken& cancel) {
    const PathIntegrator integrator(scene, settings);
    const auto& crop = scene.film().crop;
    const CropOrigin origin = crop ? CropOrigin{(*crop)[0], (*crop)[1]} : CropOrigin{};
    return fill_chunk(
        plan, index, origin, cancel,
        [&](int x, int y, std::uint32_t replicate, std::uint64_t sample, Counters& counters) {
            return integrator.sample(x, y, replicate, sample, counters);
        });
}

}  // namespace matiere
