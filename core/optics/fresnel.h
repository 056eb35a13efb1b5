// Fresnel reflectance at a smooth interface, in forms that keep their digits for indices near 1,
// near the critical angle and at grazing incidence.
//
// Dielectric: with e = eta^2 - 1 and g^2 = e + c^2 the amplitude differences are taken on paper, so
// that nothing cancels (spec section 8). Conductor: exact complex form. Schlick 1994; F82 tint
// (Hoffman 2019; Kutz, Hasan, Edmondson 2021).
#pragma once

#include <algorithm>
#include <cmath>

#include "base/numeric.h"
#include "base/spectrum.h"

namespace matiere {

/// Unpolarised reflectance and transmittance, and the cosine of the refracted direction.
template <class R>
struct FresnelTerms {
    R reflectance{};    ///< F
    R transmittance{};  ///< 1 - F, without cancellation; 0 beyond the critical angle
    R cos_theta_t{};    ///< >= 0; 0 beyond the critical angle
};

/// 1 - F from both cosines: c on the incident side, g = eta times the cosine on the transmitted
/// side. Where both directions are known this keeps its digits at the critical angle, which a root
/// of eta^2 - 1 + c^2 does not.
template <class R>
inline R dielectric_transmittance(R c, R g, R eta) {
    const R eta2 = eta * eta;
    const R s_den = c + g;
    const R p_den = eta2 * c + g;
    return R(2) * ((c / s_den) * (g / s_den) + (eta2 * c / p_den) * (g / p_den));
}

/// `eta` is the transmitted over the incident index, `cos_theta_i` >= 0.
template <class R>
inline FresnelTerms<R> fresnel_dielectric(R cos_theta_i, R eta) {
    const R c = std::min(std::abs(cos_theta_i), R(1));
    if (eta == R(1)) return {R(0), R(1), c};
    // In double: near the critical angle e and c^2 cancel.
    const double e = (double(eta) - 1.0) * (double(eta) + 1.0);
    const double g2 = e + double(c) * double(c);
    if (!(g2 > 0.0)) return {R(1), R(0), R(0)};
    const R g = R(std::sqrt(g2));

    const R eta2 = eta * eta;
    const R s_den = c + g;
    const R p_den = eta2 * c + g;
    const R r_s = R(-e) / (s_den * s_den);
    // (eta^2 + 1) c^2 - 1 in double too: it vanishes at Brewster's angle.
    const R brewster = R((double(eta) * double(eta) + 1.0) * double(c) * double(c) - 1.0);
    const R r_p = R(e) / p_den * (brewster / p_den);
    const R T = dielectric_transmittance(c, g, eta);
    // The smaller of the two carries the digits, and together they make 1.
    if (T < R(0.5)) return {R(1) - T, T, g / eta};
    return {R(0.5) * (r_s * r_s + r_p * r_p), T, g / eta};
}

/// Reflectance of a metal of complex index eta + i k, relative to the incident medium.
template <class R>
inline R fresnel_conductor(R cos_theta_i, R eta, R k) {
    const R c = std::min(std::abs(cos_theta_i), R(1));
    const R s2 = (R(1) - c) * (R(1) + c);
    // (a + ib)^2 = (eta + ik)^2 - s^2 with a, b >= 0 (Born & Wolf 1999, section 14.2); the larger
    // of a, b comes from a sum without cancellation, the other from ab = eta k.
    const R t = (eta - k) * (eta + k) - s2;
    const R ab = eta * k;
    const R modulus = std::sqrt(t * t + R(4) * ab * ab);
    const R larger = std::sqrt(R(0.5) * (modulus + std::abs(t)));
    const R smaller = larger > R(0) ? ab / larger : R(0);
    const R a = t >= R(0) ? larger : smaller;
    const R b = t >= R(0) ? smaller : larger;
    const R b2 = b * b;

    // a - c from the difference of squares where the two are close (index near 1).
    R a_minus_c = a - c;
    const R a_plus_c = a + c;
    if (std::abs(a_minus_c) < R(0.1) * a_plus_c)
        a_minus_c = ((eta - R(1)) * (eta + R(1)) - k * k + b2) / a_plus_c;
    const R s_den = a_plus_c * a_plus_c + b2;
    if (s_den == R(0)) return R(1);
    const R F_s = (a_minus_c * a_minus_c + b2) / s_den;
    const R b2c2 = b2 * c * c;
    const R p_den = sqr(a * c + s2) + b2c2;
    const R ratio = p_den > R(0) ? (sqr(a * c - s2) + b2c2) / p_den : R(1);
    return R(0.5) * F_s * (R(1) + ratio);
}

template <class R>
inline Spectrum<R> fresnel_conductor(R cos_theta_i, const Spectrum<R>& eta, const Spectrum<R>& k) {
    return {fresnel_conductor(cos_theta_i, eta[0], k[0]),
            fresnel_conductor(cos_theta_i, eta[1], k[1]),
            fresnel_conductor(cos_theta_i, eta[2], k[2])};
}

/// (1 - c)^5 for a cosine c in [0, 1].
template <class R>
inline R schlick_weight(R cos_theta) {
    const R m = std::clamp(R(1) - cos_theta, R(0), R(1));
    const R m2 = m * m;
    return m2 * m2 * m;
}

template <class R>
inline Spectrum<R> fresnel_schlick(R cos_theta, const Spectrum<R>& F0) {
    const R w = schlick_weight(cos_theta);
    return F0 * (R(1) - w) + Spectrum<R>(w);
}

/// Reflectance at normal incidence of a dielectric.
template <class R>
inline R F0_from_eta(R eta) {
    return sqr((eta - R(1)) / (eta + R(1)));
}

/// The index >= 1 whose normal reflectance is F0 (Cook & Torrance 1982, section 5); infinite at 1.
template <class R>
inline R eta_from_F0(R F0) {
    const R s = std::sqrt(F0);
    return (R(1) + s) / (R(1) - s);
}

}  // namespace matiere
