// A surface that is not there: light passes straight through. For shapes that only carry a medium
// or an emission, and as the other half of a mix. Passing counts as no scattering event.
#pragma once

#include "material/model.h"

namespace matiere {

template <class R>
struct NullModel {
    static constexpr std::string_view kName = "null";
    static constexpr std::string_view kDoc = "Invisible: light passes straight through.";
    static constexpr std::string_view kSource = "definition";
    static constexpr std::uint32_t kFeatures = kFeatureTransmission | kFeatureDelta;
    static constexpr std::uint8_t kLobes = kSpecular | kTransmission | kNull;

    struct Params {
        static constexpr std::array<Param<Params, R>, 0> table() { return {}; }
        static constexpr std::array<Rule, 0> rules() { return {}; }
    };

    static NullModel prepare(const Params&) { return {}; }

    std::uint8_t lobes() const { return kLobes; }
    R null_share() const { return R(1); }
    BsdfEval<R> eval(Vec3<R>, Vec3<R>) const { return {}; }
    std::optional<BsdfSample<R>> sample(Vec3<R> wo, Vec3<R>) const {
        return BsdfSample<R>{-wo, Spectrum<R>(R(1)), R(1), kLobes};
    }
};

}  // namespace matiere
