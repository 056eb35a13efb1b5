#include "optics/coat_return.h"

#include <cmath>

#include "optics/fresnel.h"

namespace matiere {

double coat_escape(double eta, double tau) {
    if (!(tau < 1e3)) return 1.0;  // exp(-2000)
    // Midpoints in t^2 on both sides of the critical cosine: its root becomes smooth there.
    constexpr int kSteps = 4096;
    const double critical = eta > 1.0 ? std::sqrt((1.0 - 1.0 / eta) * (1.0 + 1.0 / eta)) : 0.0;
    double sum = 0.0;
    const auto add = [&](double mu, double dmu, const FresnelTerms<double>& F) {
        const double absorbed = tau > 0.0 ? -std::expm1(-2.0 * tau / mu) : 0.0;
        sum += 2.0 * mu * (F.transmittance + F.reflectance * absorbed) * dmu;
    };
    for (int i = 0; i < kSteps; ++i) {
        const double t = (i + 0.5) / kSteps;
        if (critical > 0.0) add(critical * t, critical / kSteps, {1.0, 0.0, 0.0});
        const double mu = critical + (1.0 - critical) * t * t;
        add(mu, (1.0 - critical) * 2.0 * t / kSteps, fresnel_dielectric(mu, 1.0 / eta));
    }
    return sum;
}

}  // namespace matiere
