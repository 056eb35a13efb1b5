// Quadrature rules, for tables that are filled while materials are built.
#pragma once

#include <cmath>
#include <vector>

#include "base/numeric.h"

namespace matiere {

struct GaussLegendre {
    std::vector<double> x, w;  ///< nodes in (0, 1), weights sum to 1

    explicit GaussLegendre(int n) {
        for (int i = 0; i < n; ++i) {
            double t = std::cos(kPi<double> * (i + 0.75) / (n + 0.5));
            double slope = 1.0;
            for (int step = 0; step < 50; ++step) {
                double p0 = 1.0, p1 = t;
                for (int k = 2; k <= n; ++k) {
                    const double p2 = ((2.0 * k - 1.0) * t * p1 - (k - 1.0) * p0) / k;
                    p0 = p1;
                    p1 = p2;
                }
                slope = n * (t * p1 - p0) / (t * t - 1.0);
                const double move = p1 / slope;
                t -= move;
                if (std::abs(move) < 1e-15) break;
            }
            x.push_back(0.5 * (1.0 - t));
            w.push_back(1.0 / ((1.0 - t * t) * slope * slope));
        }
    }
};

/// Tanh-sinh quadrature on (0, 1): nodes gather at both ends at every scale, for integrands that
/// are smooth inside and whatever they like near the ends (Takahasi & Mori 1974).
struct TanhSinh {
    std::vector<double> x, w;  ///< weights sum to 1

    explicit TanhSinh(int n) {
        constexpr double kReach = 3.4;  // ends within 1e-20 of 0 and 1
        double sum = 0.0;
        for (int i = 0; i < n; ++i) {
            const double t = kReach * (2.0 * (i + 0.5) / n - 1.0);
            const double g = kPi<double> / 2 * std::sinh(t);
            x.push_back(1.0 / (1.0 + std::exp(-2.0 * g)));
            w.push_back(std::cosh(t) / (std::cosh(g) * std::cosh(g)));
            sum += w.back();
        }
        for (double& v : w) v /= sum;
    }
};

}  // namespace matiere
