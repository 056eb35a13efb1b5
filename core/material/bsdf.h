// The contract between material models and everything that scatters light with them.
#pragma once

#include <cstdint>
#include <optional>

#include "base/spectrum.h"
#include "base/vec.h"

namespace matiere {

/// What a scattering event was, as bit flags; also the set of lobes a material owns.
enum Lobe : std::uint8_t {
    kDiffuse = 1,
    kGlossy = 2,
    kSpecular = 4,  ///< a delta: never evaluates, only samples
    kReflection = 8,
    kTransmission = 16,
    kNull = 32,  ///< passes straight through as if nothing were there
};

/// Value and density of one pair of directions; both zero when impossible or delta.
template <class R>
struct BsdfEval {
    Spectrum<R> f;  ///< BSDF [1/sr] times |cos_theta_i|
    R pdf{};        ///< density of sample() per solid angle [1/sr]
};

/// A sampled direction. For a delta lobe pdf is the probability of choosing that lobe.
template <class R>
struct BsdfSample {
    Vec3<R> wi;
    Spectrum<R> weight;   ///< f cos / pdf; a transmission carries the radiance factor 1 / eta^2
    R pdf{};              ///< [1/sr]
    std::uint8_t lobe{};  ///< Lobe flags of this event
    R eta{R(1)};          ///< transmitted over incident index of this event; 1 for a reflection
};

/// By which lobes scattered light comes: all by transmission, or by diffuse and other reflection.
struct LobeSplit {
    Spectrumf diffuse;  ///< share per lane; the rest is glossy or specular
    bool transmission = false;
};

/// A sample of one lobe with the value and density of all lobes; nothing where those say so.
template <class R>
std::optional<BsdfSample<R>> finish(BsdfSample<R> s, const BsdfEval<R>& e) {
    if (!(e.pdf > R(0))) return {};
    s.weight = e.f * (R(1) / e.pdf);
    s.pdf = e.pdf;
    return s;
}

}  // namespace matiere
