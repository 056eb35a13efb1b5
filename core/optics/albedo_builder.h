// Fills tables of directional albedo by quadrature, in double, while materials are built.
#pragma once

#include <cmath>
#include <functional>
#include <span>

#include "optics/directional_albedo.h"
#include "optics/microfacet.h"

namespace matiere {

/// One row of a table: how wide the lobe is, from which azimuth [rad] about the tangent it is seen,
/// and its directional albedo as a function of wo.
struct AlbedoRow {
    double width = 0.0;
    double azimuth = 0.0;
    std::function<Spectrumd(Vec3d)> albedo;
};

/// Reflectance of a facet as a function of the cosine with its normal; three lanes.
using FacetReflectance = std::function<Spectrumd(double)>;

/// Directional albedo of single scattering: integral over the visible normals of F G2 / G1.
Spectrumd directional_albedo(const Microfacet<double>& surface, Vec3d wo,
                             const FacetReflectance& reflectance);

/// The row of a microfacet surface seen from an azimuth.
AlbedoRow surface_row(const Microfacet<double>& surface, double azimuth,
                      const FacetReflectance& reflectance);

/// A table with the given rows; averages come from the interpolated table itself, so that couplings
/// built on both conserve energy exactly. `ceiling` is above 1 for lobes that gain energy.
AlbedoTable<double> tabulate_albedo(std::span<const AlbedoRow> rows, double ceiling = 1.0,
                                    int nodes = AlbedoTable<double>::kNodes);

/// 2 * integral of f(mu) mu dmu over [0, 1].
Spectrumd cosine_average(const FacetReflectance& f);

}  // namespace matiere
