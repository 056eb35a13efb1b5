// A clear or absorbing layer with a dielectric surface on top, as coats are made of. Inside
// directions are given as seen from the base: they leave it upwards.
#pragma once

#include "material/microfacet_lobe.h"
#include "material/models/dielectric.h"

namespace matiere {

template <class R>
struct Coat {
    Dielectric<R> above;     ///< the surface seen from outside
    Dielectric<R> below;     ///< and from the base, with the inverse index
    MicrofacetLobe<R> lobe;  ///< its reflection alone
    Spectrum<R> tau;         ///< absorption times thickness

    struct Refracted {
        Vec3<R> w;  ///< the same azimuth on the other side
        R T{};      ///< transmittance of a smooth surface; 0 beyond the critical angle
        R F{R(1)};  ///< 1 - T
    };

    R eta() const { return above.eta; }
    bool is_delta() const { return above.is_delta(); }

    /// Through the mean surface, into the coat and out of it.
    Refracted enter(Vec3<R> w) const { return through(w, eta()); }
    Refracted leave(Vec3<R> w) const { return through(w, R(1) / eta()); }

    /// What one way through the coat leaves; `cos_theta` inside.
    Spectrum<R> transmittance(R cos_theta) const {
        return tau.map([&](R t) { return t > R(0) ? std::exp(-t / cos_theta) : R(1); });
    }

 private:
    static Refracted through(Vec3<R> w, R eta_rel) {
        const FresnelTerms<R> F = fresnel_dielectric(w.z, eta_rel);
        if (!(F.cos_theta_t > R(0))) return {};
        return {{w.x / eta_rel, w.y / eta_rel, F.cos_theta_t}, F.transmittance, F.reflectance};
    }
};

}  // namespace matiere
