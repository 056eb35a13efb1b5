// What a rough interface between two clear media scatters at all, reflected and transmitted
// together: what is missing to 1 has met more than one facet.
#pragma once

#include "optics/microfacet.h"

namespace matiere {

/// Share of the light from wo that single scattering reflects or transmits, by quadrature; `eta` is
/// the index beyond the surface over that on the side of wo. Fine: four times the points.
double interface_albedo(const Microfacet<double>& surface, Vec3d wo, double eta, bool fine);

}  // namespace matiere
