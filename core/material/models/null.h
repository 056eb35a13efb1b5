// A surface that is not there: light passes straight through. For shapes that only carry a medium
// (smoke, fog: matched in index to what surrounds it) or an emission, and as the other half of a
// mix. Passing counts as no scattering event.
#pragma once

#include "material/medium_params.h"
#include "material/model.h"

namespace matiere {

template <class R>
struct NullModel {
    static constexpr std::string_view kName = "null";
    static constexpr std::string_view kDoc =
        "Invisible: light passes straight through. May hold smoke, fog or dye.";
    static constexpr std::string_view kSource =
        "definition; Beer-Lambert; Henyey & Greenstein 1941";
    static constexpr std::uint32_t kFeatures = kFeatureTransmission | kFeatureDelta;
    static constexpr std::uint8_t kLobes = kSpecular | kTransmission | kNull;

    struct Params : MediumParams<R> {
        static constexpr auto table() {
            return join(MediumParams<R>::template absorption_rows<Params>(),
                        MediumParams<R>::template scattering_rows<Params>());
        }
        static constexpr auto rules() { return MediumParams<R>::rules(); }
    };

    Interior<R> inside;
    bool filled = false;

    static NullModel prepare(const Params& p) {
        NullModel m{p.interior(Spectrum<R>(R(1))), p.given()};
        m.inside.matched = true;
        return m;
    }

    /// Only a shape that something is said about the inside of bounds a medium.
    bool bounds_medium() const { return filled; }
    const Interior<R>& interior() const { return inside; }
    NullModel at_interface(R) const { return *this; }

    std::uint8_t lobes() const { return kLobes; }
    R null_share() const { return R(1); }
    BsdfEval<R> eval(Vec3<R>, Vec3<R>) const { return {}; }
    std::optional<BsdfSample<R>> sample(Vec3<R> wo, Vec3<R>) const {
        return BsdfSample<R>{-wo, Spectrum<R>(R(1)), R(1), kLobes};
    }
};

}  // namespace matiere
