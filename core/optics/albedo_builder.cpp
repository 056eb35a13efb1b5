#include "optics/albedo_builder.h"

#include <cmath>
#include <vector>

#include "optics/quadrature.h"

namespace matiere {
namespace {

/// How the facets are visited: in proportion to what a viewer sees of a GGX surface of the same
/// widths (no other distribution has heavier tails) and would see reflected above the horizon; or,
/// for V-cavities, whose masking has kinks that visible normals of Smith do not follow, to D cos.
struct FacetGrid {
    const Microfacet<double>& surface;
    Microfacet<double> ggx;
    Vec3d wo;

    FacetGrid(const Microfacet<double>& s, Vec3d o) : surface(s), ggx(s), wo(o) {
        ggx.distribution = Distribution::kGgx;
        ggx.masking = Masking::kSmith;
    }

    bool cavity() const { return surface.masking == Masking::kVCavity; }

    Vec3d facet(double u1, double u2) const {
        const Vec3d zenith{0.0, 0.0, 1.0};
        if (cavity()) return ggx.sample_visible(zenith, {0.0, u1, u2}).h;
        return ggx.sample_for_reflection(wo, {0.0, u1, u2});
    }

    /// What the facet h reflects, over the density of visiting it.
    Spectrumd value(Vec3d h, const FacetReflectance& reflectance) const {
        const double oh = dot(wo, h);
        if (!(oh > 0.0)) return {};
        const Vec3d wi = reflect(wo, h);
        if (!(wi.z > 0.0)) return {};
        const double over_D = cavity() ? h.z : 4.0 * oh * ggx.reflection(wo, wi, h).density;
        const double density = ggx.D(h) * over_D;
        const double reflected = surface.D(h) * surface.reflection(wo, wi, h).visibility * 4.0 * oh;
        return reflectance(oh) * (reflected / density);
    }
};

}  // namespace

Spectrumd directional_albedo(const Microfacet<double>& surface, Vec3d wo,
                             const FacetReflectance& reflectance) {
    if (surface.is_delta()) return reflectance(wo.z);
    // Errors against 300 x 600 nodes: 3e-4 for Smith, 6e-4 for V-cavities.
    static const GaussLegendre smith(32), cavities(48);
    // A round surface looks the same from every azimuth, and left and right of the view.
    const bool round = !surface.is_anisotropic();
    if (round) wo = {std::sqrt(wo.x * wo.x + wo.y * wo.y), 0.0, wo.z};
    const FacetGrid grid(surface, wo);
    const GaussLegendre& nodes = grid.cavity() ? cavities : smith;
    const int full = grid.cavity() ? 384 : 96;
    const int azimuths = round ? full / 2 : full;
    Spectrumd sum;
    for (int j = 0; j < azimuths; ++j)
        for (std::size_t i = 0; i < nodes.x.size(); ++i) {
            const Vec3d h = grid.facet((j + 0.5) / full, nodes.x[i]);
            sum += grid.value(h, reflectance) * nodes.w[i];
        }
    return sum * (1.0 / azimuths);
}

Spectrumd cosine_average(const FacetReflectance& f) {
    // mu = t^2 gathers nodes at grazing, where Fresnel reflectance bends.
    constexpr int kPanels = 32;
    static const GaussLegendre nodes(8);
    Spectrumd sum;
    for (int p = 0; p < kPanels; ++p)
        for (std::size_t i = 0; i < 8; ++i) {
            const double t = (p + nodes.x[i]) / kPanels;
            sum += f(t * t) * (4.0 * t * t * t * nodes.w[i] / kPanels);
        }
    return sum;
}

AlbedoRow surface_row(const Microfacet<double>& surface, double azimuth,
                      const FacetReflectance& reflectance) {
    const double width =
        std::hypot(surface.alpha_x * std::cos(azimuth), surface.alpha_y * std::sin(azimuth));
    return {width, azimuth, [=](Vec3d wo) { return directional_albedo(surface, wo, reflectance); }};
}

AlbedoTable<double> tabulate_albedo(std::span<const AlbedoRow> rows, double ceiling, int nodes) {
    AlbedoTable<double> table;
    table.nodes = nodes;
    table.ceiling = ceiling;
    table.average.resize(rows.size());
    for (const AlbedoRow& row : rows) {
        const double scale = AlbedoTable<double>::cosine_scale(row.width);
        table.stretch.push_back(Stretch<double>::make(scale));
        const int r = int(table.stretch.size()) - 1;
        for (int i = 0; i < nodes; ++i) {
            // Grazing itself is a limit: taken just above it.
            const double mu = std::max(table.node_cosine(r, i), 1e-9);
            const double s = std::sqrt((1.0 - mu) * (1.0 + mu));
            table.E.push_back(
                row.albedo({s * std::cos(row.azimuth), s * std::sin(row.azimuth), mu}));
        }
    }
    for (int r = 0; r < table.rows(); ++r) {
        const double t = table.rows() > 1 ? double(r) / (table.rows() - 1) : 0.0;
        table.average[std::size_t(r)] =
            cosine_average([&](double mu) { return table.lookup(mu, t); });
    }
    return table;
}

}  // namespace matiere
