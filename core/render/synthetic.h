// Integrands of known mean and tail in place of a scene, for the tests of film, loop and estimator.
#pragma once

#include <cmath>
#include <cstdint>
#include <optional>
#include <string_view>

#include "base/rng.h"
#include "integrator/integrator.h"

namespace matiere {

enum class SyntheticKind { kZero, kConstant, kUniform, kGaussian, kLogNormal, kRare };

inline std::optional<SyntheticKind> synthetic_kind(std::string_view name) {
    constexpr std::string_view kNames[] = {"zero",     "constant",  "uniform",
                                           "gaussian", "lognormal", "rare"};
    for (std::size_t i = 0; i < std::size(kNames); ++i)
        if (name == kNames[i]) return SyntheticKind(i);
    return std::nullopt;
}

/// Every kind but `zero` has the mean synthetic_mean(x, y) in red, half of it in green, a quarter
/// in blue. `spread` is the relative standard deviation of a sample; for `rare`, one sample in 1 +
/// spread^2 carries everything.
struct Synthetic {
    SyntheticKind kind = SyntheticKind::kUniform;
    std::uint64_t seed = 0;
    double spread = 1.0;
    /// Replicates from here on repeat the first ones: with R / 2 an adaptive film decides on the
    /// very samples it counts, which the tests must notice. 0 = all are independent.
    std::uint32_t repeat_after = 0;

    static double mean(int x, int y) { return 0.2 + 0.05 * double((x / 8 + y / 8) % 16); }

    PathResult operator()(const SampleId& id, Counters& counters) const {
        ++counters.samples;
        ++counters.rays;
        const std::uint32_t set = repeat_after > 0 ? id.replicate % repeat_after : id.replicate;
        const double value =
            kind == SyntheticKind::kZero
                ? 0.0
                : mean(id.x, id.y) * unit_mean(hash_words(seed, set, id.x, id.y, id.index));
        return {Spectrumf(float(value), float(0.5 * value), float(0.25 * value)), 1.0F};
    }

 private:
    double unit_mean(std::uint64_t hash) const {
        const double u = (double(hash >> 32) + 0.5) * 0x1p-32;
        const double v = double(hash & 0xffffffffU) * 0x1p-32;
        switch (kind) {
            case SyntheticKind::kUniform:
                return 1.0 + spread * std::sqrt(12.0) * (u - 0.5);
            case SyntheticKind::kGaussian:
                return 1.0 + spread * normal(u, v);
            case SyntheticKind::kLogNormal: {
                const double s2 = std::log1p(spread * spread);
                return std::exp(std::sqrt(s2) * normal(u, v) - 0.5 * s2);
            }
            case SyntheticKind::kRare: {
                const double p = 1.0 / (1.0 + spread * spread);
                return u < p ? 1.0 / p : 0.0;
            }
            default:
                return 1.0;
        }
    }
    static double normal(double u, double v) {  // Box and Muller 1958
        return std::sqrt(-2.0 * std::log(u)) * std::cos(kTwoPi<double> * v);
    }
};

}  // namespace matiere
