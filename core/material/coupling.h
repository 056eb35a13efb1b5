// How a diffuse body goes with the lobe above it, for models that let the user choose.
#pragma once

#include "material/coated_diffuse.h"
#include "material/param.h"

namespace matiere {

inline constexpr std::array<std::string_view, 2> kPlainCouplingNames{"energy", "add"};

/// Tables of lobes that gain energy hold up to this.
inline constexpr double kGainCeiling = 1e3;

/// Refuses what an added diffuse part would gain: `most` is what the lobe reflects at most.
template <class R>
ParamError check_sum(Coupling coupling, const Spectrum<R>& diffuse, const Spectrum<R>& most) {
    constexpr R kRounding = R(1e-6);
    if (coupling != Coupling::kAdd || (diffuse + most).max_value() <= R(1) + kRounding) return {};
    return {"diffuse",
            "with coupling add, diffuse and what the specular lobe reflects must sum to at most 1 "
            "in each channel; lower one of them or take coupling energy"};
}

/// A lobe over a diffuse body of albedo rho. A lobe that gains energy (conserving = false) leaves
/// the body what is below 1, without light between the two.
template <class R, class Lobe>
CoatedDiffuse<R, Lobe> couple(const Lobe& lobe, const CoatAlbedo<R>& albedo, const Spectrum<R>& rho,
                              Coupling coupling, bool conserving) {
    using Coated = CoatedDiffuse<R, Lobe>;
    if (coupling == Coupling::kEnergy && conserving) return Coated::make(lobe, albedo, rho, R(1));
    return Coated::uncoupled(lobe, albedo, rho, coupling);
}

}  // namespace matiere
