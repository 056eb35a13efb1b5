// When to look at the error, when to stop, and what to do next: pure functions of what is known,
// shared by the pass loop and by the jobs.
#pragma once

#include <cstdint>
#include <optional>
#include <string_view>

#include "base/numeric.h"
#include "film/estimate.h"
#include "film/plan.h"
#include "render/settings.h"

namespace matiere {

/// A pass starts only if it is expected to end within this share past `seconds`; the other half of
/// the promised 10 % is left for a pass that takes longer than expected.
inline constexpr double kStartSlack = 0.05;
/// No error target is believed before this many boundaries: rarer paths need the chance to show.
inline constexpr std::uint64_t kFirstTargetRange = 3;  // 4R samples per pixel
inline constexpr int kLooksPerOctave = 2;
inline constexpr int kTargetLooksPerOctave = 8;

struct RenderState {
    std::uint64_t spp = 0;        ///< samples every pixel has
    double elapsed_s = 0.0;       ///< since the start of this call
    double s_per_spp = 0.0;       ///< of this call; 0 = not measured yet
    std::uint64_t error_spp = 0;  ///< spp of the newest look at the error; 0 = none
    bool error_known = false;
    double excess = 0.0;  ///< of the error target at that look, see below
};

struct Step {
    bool go_on = false;
    std::uint64_t next_spp = 0;  ///< boundary to render to if go_on
    std::string_view reason;     ///< why it stops: spp, cap, seconds or target_error
};

/// How many times the samples a target is expected to need: the variance of independent samples
/// falls as 1 / spp. At most 1 = reached. Nothing where the error is unknown.
inline std::optional<double> target_excess(const Stop& stop, const ErrorEstimate& e) {
    if (!e.known) return std::nullopt;
    const double confidence = look_confidence(e.look);
    if (stop.relmse > 0.0) return relmse_interval(e, confidence).upper / stop.relmse;
    if (!(stop.rmse_percent > 0.0) || !(e.rmse_percent > 0.0)) return std::nullopt;
    return sqr(rmse_percent_interval(e, confidence).upper / stop.rmse_percent);
}

/// True if the error is to be estimated and logged at this boundary.
inline bool look_due(const Plan& plan, const Stop& stop, std::uint64_t spp) {
    return plan.is_look(spp, stop.has_target() ? kTargetLooksPerOctave : kLooksPerOctave);
}

/// Boundary at which the render ends if nothing else ends it.
inline std::uint64_t spp_limit(const Plan& plan, const Stop& stop) {
    return plan.round_up(stop.spp > 0 ? stop.spp : Plan::kOpenEndedSpp);
}

inline Step next_step(const Plan& plan, const Stop& stop, const RenderState& now) {
    const bool fresh = now.error_known && now.spp > 0 && now.error_spp == now.spp;
    if (stop.has_target() && fresh && now.spp >= plan.boundary(kFirstTargetRange) &&
        now.excess <= 1.0)
        return {false, now.spp, "target_error"};
    if (now.spp >= spp_limit(plan, stop)) return {false, now.spp, stop.spp > 0 ? "spp" : "cap"};
    const std::uint64_t next = plan.round_up(now.spp + 1);
    const double end = now.elapsed_s + now.s_per_spp * double(next - now.spp);
    if (stop.seconds > 0.0 && now.spp > 0 && end > stop.seconds * (1.0 + kStartSlack))
        return {false, now.spp, "seconds"};
    return {true, next, {}};
}

/// Seconds until the first of the stop conditions is expected to hold; negative if unknown.
inline double seconds_left(const Plan& plan, const Stop& stop, const RenderState& now) {
    double least = -1.0;
    const auto consider = [&least](double s) {
        if (least < 0.0 || s < least) least = s < 0.0 ? 0.0 : s;
    };
    if (stop.seconds > 0.0) consider(stop.seconds - now.elapsed_s);
    if (now.s_per_spp <= 0.0) return least;
    const double spp = double(now.spp);
    if (stop.spp > 0) consider((double(spp_limit(plan, stop)) - spp) * now.s_per_spp);
    if (stop.has_target() && now.error_known && now.error_spp > 0)
        consider((double(now.error_spp) * now.excess - spp) * now.s_per_spp);
    return least;
}

}  // namespace matiere
