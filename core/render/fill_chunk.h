// The sample loop of one chunk, written once for any sampler.
#pragma once

#include <ctime>
#include <optional>

#include "base/parallel.h"
#include "film/film.h"
#include "integrator/integrator.h"

namespace matiere {

/// CPU time of the calling thread in seconds.
inline double thread_cpu_seconds() {
    timespec t{};
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
    return double(t.tv_sec) + 1e-9 * double(t.tv_nsec);
}

/// Where the stored pixels (the crop) lie in the whole film.
struct CropOrigin {
    int x = 0, y = 0;
};

/// What a chunk's samples come from, beside their own numbers.
struct ChunkSource {
    CropOrigin origin;
    std::uint64_t seed = 0;
    Features found = 0;
    std::uint32_t kernels = 0;
    AovSet aovs = 0;
};

/// A cut path, and what was cut off where that is known. What is not finite would be counted as
/// such in a render without limits.
inline void book(ChunkFilm& film, const PathResult& p) {
    CutSums& sums = film.cuts()[std::size_t(p.cut) - 1];
    ++sums.paths;
    if (p.followed && p.lost.is_finite())
        sums.add({double(p.lost[0]), double(p.lost[1]), double(p.lost[2])});
}

/// Renders one chunk in order: rows, pixels, samples. `sample(id, counters)` returns a
/// PathResult, or an AovResult where layers are asked for, and gets pixels of the whole film.
/// Nothing comes back if the token was raised.
template <class SampleFn>
std::optional<ChunkFilm> fill_chunk(const Plan& plan, std::uint32_t index,
                                    const ChunkSource& source, const CancelToken& cancel,
                                    SampleFn&& sample) {
    const FlushDenormals float_mode;
    const double start = thread_cpu_seconds();
    ChunkFilm film(plan, index, source.aovs);
    const Chunk& chunk = film.chunk();
    const auto replicates = std::uint64_t(plan.replicates());
    Counters& counters = film.work().counters;
    film.provenance() = {source.found, source.kernels, {}};
    for (int y = 0; y < chunk.height(); ++y) {
        if (cancel.cancelled()) return std::nullopt;
        for (int x = 0; x < chunk.width(); ++x)
            for (std::uint64_t s = chunk.s0; s < chunk.s1; ++s) {
                const auto r = std::uint32_t(s % replicates);
                if (int(r) < chunk.r0 || int(r) >= chunk.r1) continue;
                const SampleId id{source.origin.x + chunk.x0 + x, source.origin.y + chunk.y0 + y, r,
                                  s / replicates};
                const auto made = sample(id, counters);
                const PathResult& p = made;
                if constexpr (requires { made.aovs; }) film.add_aovs(x, y, s, made.aovs);
                film.provenance().outliers.offer(
                    {source.seed, id.index, id.replicate, id.x, id.y, {p.L[0], p.L[1], p.L[2]}});
                if (p.cut != Cut::kNone) book(film, p);
                film.add(x, y, s,
                         {double(p.L[0]), double(p.L[1]), double(p.L[2]), double(p.alpha)});
            }
    }
    film.work().cpu_s = thread_cpu_seconds() - start;
    return film;
}

}  // namespace matiere
