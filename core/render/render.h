// The pass loop: chunks in order from the plan, our own threads, a look at the error now and then.
#pragma once

#include <functional>
#include <optional>
#include <string_view>

#include "base/parallel.h"
#include "film/film.h"
#include "render/pass_log.h"
#include "render/stop_rule.h"

namespace matiere {

class Scene;

/// Renders one chunk on the calling thread; nothing if the token was raised meanwhile.
std::optional<ChunkFilm> render_chunk(const Scene& scene, const Settings& settings,
                                      const Plan& plan, std::uint32_t index,
                                      const CancelToken& cancel);

using ChunkFunction =
    std::function<std::optional<ChunkFilm>(std::uint32_t index, const CancelToken& cancel)>;

/// What a callback is told after every pass.
struct Progress {
    std::uint64_t spp = 0;
    std::uint64_t spp_limit = 0;
    double elapsed_s = 0.0;
    double seconds_left = -1.0;   ///< negative = not known
    std::uint64_t error_spp = 0;  ///< spp of the estimate below; 0 = no look yet
    ErrorEstimate error;
};

struct RenderHooks {
    /// Once per pass, on the calling thread; false ends the render after this pass.
    std::function<bool(const Progress&)> progress;
    /// At every look where Stop::measured, on the calling thread while no other touches the film:
    /// its target_excess, or nothing where that is unknown.
    std::function<std::optional<double>()> measure;
    /// At least every 20 ms on the calling thread; may throw, the render then ends and rethrows.
    std::function<void()> poll;
};

struct RenderOutcome {
    std::string_view reason;  ///< spp, cap, seconds, target_error, callback or cancelled
    int threads = 0;
    double wall_s = 0.0;  ///< of this call
    double pass_s = 0.0;  ///< of its last pass
    ErrorEstimate error;  ///< of the film at the end
    PassLog log;          ///< looks of this call
};

/// Threads this process may use (its affinity mask).
int available_threads();

/// Continues `film` to the first of the stop conditions. After a cancel or an exception the film
/// holds whole chunks and can be continued; its pixels may then differ in sample count.
RenderOutcome render_passes(const ChunkFunction& chunk, const Stop& stop, Film& film, int threads,
                            const RenderHooks& hooks, const CancelToken& cancel);

}  // namespace matiere
