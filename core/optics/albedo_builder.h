// Fills tables of directional albedo by quadrature, in double, while materials are built.
#pragma once

#include <cmath>
#include <functional>
#include <span>

#include "optics/directional_albedo.h"
#include "optics/microfacet.h"

namespace matiere {

/// One row of a table: a surface, seen from an azimuth [rad] about its tangent.
struct AlbedoRow {
    Microfacet<double> surface;
    double azimuth = 0.0;

    /// Width of the surface as seen from the azimuth.
    double width() const {
        return std::hypot(surface.alpha_x * std::cos(azimuth), surface.alpha_y * std::sin(azimuth));
    }
};

/// Reflectance of a facet as a function of the cosine with its normal; three lanes.
using FacetReflectance = std::function<Spectrumd(double)>;

/// Directional albedo of single scattering: integral over the visible normals of F G2 / G1.
Spectrumd directional_albedo(const Microfacet<double>& surface, Vec3d wo,
                             const FacetReflectance& reflectance);

/// A table with one row per surface; averages come from the interpolated table itself, so that
/// couplings built on both conserve energy exactly.
AlbedoTable<double> tabulate_albedo(std::span<const AlbedoRow> rows,
                                    const FacetReflectance& reflectance);

/// 2 * integral of f(mu) mu dmu over [0, 1].
Spectrumd cosine_average(const FacetReflectance& f);

}  // namespace matiere
