// Facets of a Blinn-Phong surface, D = nu / (2 pi) cos^(nu-2): along any direction their slopes
// follow Student's t with nu degrees of freedom (Ribardiere, Bringier, Meneveaux, Simonot 2017,
// "STD: Student's t-distribution of slopes for microfacet based BSDFs"), so that Smith's masking
// and the visible normals have closed integrals. Everything is written in the angle of the slope,
// phi = atan x: it is bounded where slopes are not (nu = 2, exponent 0).
#pragma once

#include <algorithm>
#include <array>
#include <cmath>

#include "base/numeric.h"
#include "base/vec.h"
#include "optics/beckmann_slopes.h"

namespace matiere {

/// K = Gamma((nu+1)/2) / (sqrt(pi) Gamma(nu/2)): integral of K cos^(nu-1) over (-pi/2, pi/2) is 1.
inline double phong_slope_norm(double nu) {
    constexpr double kAsymptotic = 100.0;  // beyond: the series to 1e-12, lgamma would cancel
    if (nu < kAsymptotic)
        return std::exp(std::lgamma(0.5 * (nu + 1.0)) - std::lgamma(0.5 * nu)) /
               std::sqrt(kPi<double>);
    const double r = 1.0 / nu;
    const double series =
        1.0 + r * (-1.0 / 4 + r * (1.0 / 32 + r * (5.0 / 128 + r * (-21.0 / 2048))));
    return std::sqrt(nu * kInvPi<double> / 2.0) * series;
}

/// log(cos angle) from the sine, with its digits near 0.
template <class R>
inline R log_cos(R sine) {
    return R(0.5) * std::log1p(-std::min(sine * sine, kOneMinusEpsilon<R>));
}

template <class R>
struct PhongSlopes {
    R nu{R(2)};
    R norm{R(0.5)};  ///< K of nu

    static PhongSlopes make(double nu) { return {R(nu), R(phong_slope_norm(nu))}; }

    /// Those of one more degree of freedom: the slopes across a given one.
    PhongSlopes across() const { return {nu + R(1), nu / (kTwoPi<R> * norm)}; }

    /// K times the integral of cos^(nu-1) over angles from 0 to that of sine q in [0, 1], whose
    /// cosine is given too.
    R mass(R q, R cosine) const { return q * q < R(0.5) ? centre(q) : R(0.5) - tail(q, cosine); }

    /// Projected area of the facets that a direction of cosine z and sine s sees.
    R sigma(R z, R s) const {
        if (!(s > R(0))) return z;
        const R power = std::exp(nu * log_cos(z));  // s^nu
        return z * (R(0.5) + mass(z, s)) + norm * power / (nu - R(1));
    }

    /// Angle of the slope towards a viewer of cosine z and sine s: density proportional to
    /// cos^(nu-2) (z cos - s sin). `u` in [0, 1).
    R sample_along(R z, R s, R u) const {
        if (!(s > R(0))) return sample_symmetric(u);
        const auto cumulative = [&](R sine, R cosine) {
            const R half = std::copysign(mass(std::abs(sine), cosine), sine);
            const R rise = norm * std::exp((nu - R(1)) * log_cos(sine)) / (nu - R(1));
            return z * (R(0.5) + half) + s * rise;
        };
        const R end = std::min(std::atan2(z, s), reach());
        const R target = u * sigma(z, s);
        const R unit = std::sqrt(R(2) / nu);
        const R guess = unit * (erf_inv(R(2) * u - R(1)) - R(0.5) / (R(1) + z / (s * unit)));
        const auto step = [&](R phi) {
            const R sine = std::sin(phi), cosine = std::cos(phi);
            const R towards = z * cosine - s * sine;
            const R density = norm * std::exp((nu - R(2)) * log_cos(sine)) * towards;
            const R error = cumulative(sine, cosine) - target;
            const R bend = (nu - R(2)) * sine / cosine + (z * sine + s * cosine) / towards;
            return Step{error, density, -bend};
        };
        return invert(step, -reach(), end, guess, unit);
    }

    /// Angle with density K cos^(nu-1), symmetric about 0.
    R sample_symmetric(R u) const {
        const R unit = std::sqrt(R(2) / nu);
        const auto step = [&](R phi) {
            const R sine = std::sin(phi), cosine = std::cos(phi);
            const R half = std::copysign(mass(std::abs(sine), cosine), sine);
            const R density = norm * std::exp((nu - R(1)) * log_cos(sine));
            return Step{R(0.5) + half - u, density, (R(1) - nu) * sine / cosine};
        };
        return invert(step, -reach(), reach(), unit * erf_inv(R(2) * u - R(1)), unit);
    }

 private:
    /// Angle beyond which cos^(nu-1) is below rounding.
    R reach() const {
        constexpr R kLog = sizeof(R) == sizeof(float) ? R(40) : R(80);
        return std::asin(std::sqrt(-std::expm1(-kLog / (nu - R(1)))));
    }

    struct Step {
        R error{};    ///< of the cumulative distribution
        R density{};  ///< its slope
        R bend{};     ///< the slope of log density
    };

    /// Root of a growing function between two angles: Halley's steps inside a bracket.
    template <class F>
    static R invert(F&& f, R low, R high, R guess, R unit) {
        constexpr R kSmallStep = sizeof(R) == sizeof(float) ? R(1e-3) : R(1e-6);
        constexpr int kMaxSteps = 60;
        const R top = high;
        R x = guess > low && guess < high ? guess : R(0.5) * (low + high);
        for (int i = 0; i < kMaxSteps; ++i) {
            const Step s = f(x);
            (s.error > R(0) ? high : low) = x;
            const R newton = s.error / s.density;
            const R curved = R(1) - R(0.5) * newton * s.bend;
            R next = x - newton / std::max(curved, R(0.5));
            if (!(next >= low && next <= high)) next = R(0.5) * (low + high);
            const R moved = std::abs(next - x);
            x = next;
            if (moved <= kSmallStep * std::min({unit, top - x, R(1)})) break;
        }
        return x;
    }

    /// Gauss-Legendre in the sine; the integrand (1 - q^2)^(nu/2 - 1) is 0 to rounding beyond 8.5
    /// standard deviations.
    R centre(R q) const {
        constexpr std::array<R, 8> kNodes{R(0.09501250983763744), R(0.28160355077925891),
                                          R(0.45801677765722739), R(0.61787624440264375),
                                          R(0.75540440835500303), R(0.86563120238783174),
                                          R(0.94457502307323258), R(0.98940093499164993)};
        constexpr std::array<R, 8> kWeights{R(0.18945061045506850), R(0.18260341504492359),
                                            R(0.16915651939500254), R(0.14959598881657673),
                                            R(0.12462897125553387), R(0.09515851168249278),
                                            R(0.06225352393864789), R(0.02715245941175409)};
        const R half = R(0.5) * std::min(q, R(8.5) / std::sqrt(nu));
        R sum{};
        for (std::size_t i = 0; i < kNodes.size(); ++i)
            for (const R side : {R(-1), R(1)}) {
                const R x = half * (R(1) + side * kNodes[i]);
                sum += kWeights[i] * std::exp((nu - R(2)) * log_cos(x));
            }
        return norm * half * sum;
    }

    /// Mass beyond the angle of sine q: half a regularised incomplete beta function, by its
    /// hypergeometric series in cosine^2 < 1/2.
    R tail(R q, R cosine) const {
        const R x = cosine * cosine;
        const R first = norm * q * std::pow(cosine, nu) / nu;
        R term = R(1), sum = R(1);
        for (R k = 0; term > std::numeric_limits<R>::epsilon() / R(2) && k < R(60); k += R(1)) {
            term *= x * (nu + R(1) + R(2) * k) / (nu + R(2) + R(2) * k);
            sum += term;
        }
        return first * sum;
    }
};

}  // namespace matiere
