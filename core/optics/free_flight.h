// How far light flies in a homogeneous medium before it meets something, for lanes that differ: one
// lane, picked in proportion to the light it carries, draws the distance; all lanes are weighed by
// the density of the mixture (balance heuristic; Veach 1997, 9.2.4; Wilkie et al. 2014, Hero
// wavelength spectral sampling; Chiang, Kutz & Burley 2016). With these shares the sum of the lanes
// never grows, so no weight is ever large, however unequal the lanes are.
#pragma once

#include <algorithm>
#include <cmath>

#include "base/spectrum.h"

namespace matiere {

template <class R>
struct Flight {
    bool meets = false;  ///< something is met before the end; else the end is reached
    R distance{};        ///< to what is met [m]
    Spectrum<R> carried;
};

/// `carried` is what the lanes bring, `end` [m] the finite way to the boundary; `u_lane` and `u`
/// are uniform. What comes out at a meeting has been scattered: it lacks the phase function alone.
/// The weights are ratios in double, rounded once, so that a white medium loses nothing to a
/// million roundings all one way.
template <class R>
inline Flight<R> sample_flight(const Spectrum<R>& sigma_s, const Spectrum<R>& sigma_t,
                               const Spectrum<R>& carried, R end, R u_lane, R u) {
    Flight<R> flight;
    if (!(carried.max_value() > R(0))) return flight;
    const R sigma = sigma_t[carried.pick(u_lane)];
    flight.distance = sigma > R(0) ? -std::log1p(-u) / sigma : kInfinity<R>;
    flight.meets = flight.distance < end;

    const R way = std::min(flight.distance, end);
    double left[kActiveLanes], before = 0, after = 0;
    for (int i = 0; i < kActiveLanes; ++i) {
        left[i] = double(carried[i]) * double(std::exp(-sigma_t[i] * way));
        before += double(carried[i]);
        after += left[i] * (flight.meets ? double(sigma_t[i]) : 1.0);
    }
    const double scale = before / after;
    for (int i = 0; i < kActiveLanes; ++i)
        flight.carried[i] = R(left[i] * (flight.meets ? double(sigma_s[i]) : 1.0) * scale);
    return flight;
}

}  // namespace matiere
