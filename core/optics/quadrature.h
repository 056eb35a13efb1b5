// Gauss-Legendre quadrature, for tables that are filled while materials are built.
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

}  // namespace matiere
