#include "optics/interface_albedo.h"

#include "optics/fresnel.h"

namespace matiere {
namespace {

Vec3d refract(Vec3d o, Vec3d h, double oh, double cos_t, double eta) {
    return normalize(h * (oh / eta - cos_t) - o * (1.0 / eta));
}

/// What the facet h passes on, before it is weighted by how much of it wo sees.
double scattered(const Microfacet<double>& surface, Vec3d wo, Vec3d h, double eta) {
    const double oh = dot(wo, h);
    const FresnelTerms<double> F = fresnel_dielectric(oh, eta);
    const Vec3d wi = reflect(wo, h);
    double sum = 0.0;
    if (wi.z > 0.0) sum += F.reflectance * surface.reflection(wo, wi, h, false).weight;
    if (!(F.transmittance > 0.0)) return sum;
    const Vec3d wt = refract(wo, h, oh, F.cos_theta_t, eta);
    if (wt.z < 0.0) sum += F.transmittance * surface.transmission_weight(wo, wt, h);
    return sum;
}

}  // namespace

double interface_albedo(const Microfacet<double>& surface, Vec3d wo, double eta, bool fine) {
    if (surface.is_delta()) return 1.0;
    // Facets are visited as a GGX surface of the same widths shows them (it has the heaviest
    // tails); of V-cavities, by D cos.
    const bool cavity = surface.masking == Masking::kVCavity;
    Microfacet<double> ggx = surface;
    ggx.distribution = Distribution::kGgx;
    ggx.masking = Masking::kSmith;
    const bool round = !surface.is_anisotropic();
    if (round) wo = {std::sqrt(wo.x * wo.x + wo.y * wo.y), 0.0, wo.z};
    const Vec3d seen_from = cavity ? Vec3d{0.0, 0.0, 1.0} : wo;
    // A Fibonacci lattice: critical angle and horizon cut across any product of nodes.
    const int points = fine ? 17711 : 4181, generator = fine ? 10946 : 2584;
    double sum = 0.0;
    for (int i = 0; i < points; ++i) {
        const double turn = (double(i) * generator / points);
        const double azimuth = (turn - std::floor(turn)) * (round ? 0.5 : 1.0);
        const Vec3d h = ggx.sample_visible(seen_from, {0.0, azimuth, (i + 0.5) / points}).h;
        if (!(dot(wo, h) > 0.0)) continue;
        const double seen = surface.D(h) * surface.visible_over_D(wo, h);
        const double visited = ggx.D(h) * ggx.visible_over_D(seen_from, h);
        sum += scattered(surface, wo, h, eta) * (seen / visited);
    }
    return std::min(sum / points, 1.0);
}

}  // namespace matiere
