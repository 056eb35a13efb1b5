// Interface between two media, smooth or rough, whose inside may absorb and scatter.
// Smooth: exact Fresnel, Snell, total internal reflection. Rough: Walter et al. 2007 with visible
// normals, reflection and transmission chosen per facet by F. Transmission carries 1 / eta^2, as
// radiance does (camera paths).
// Sources: Walter, Marschner, Li, Torrance 2007, eqs 16, 17, 21; Heitz 2014; Heitz et al. 2016
// (transmission masking). Single scattering between facets, as in those papers, loses energy at
// high alpha (22 to 53 % at alpha 1); multiscatter adds the rest (interface_loss.h).
// The relative index comes with the hit: the media that really meet there, by priority. It is one
// number: at the first hit where an index differs between channels the integrator picks a channel.
#pragma once

#include "material/interface_loss.h"
#include "material/medium_params.h"
#include "material/model.h"
#include "optics/fresnel.h"

namespace matiere {

/// The lane whose index stands for a dispersive medium where no path has picked one.
inline constexpr int kMiddleLane = 1;

template <class R>
struct Dielectric {
    static constexpr std::string_view kName = "dielectric";
    static constexpr std::string_view kDoc = "Medium with a surface: glass, water, milk, wax.";
    static constexpr std::string_view kSource =
        "Walter et al. 2007; Heitz 2014; Kulla & Conty 2017; Beer-Lambert; Henyey & Greenstein "
        "1941";
    static constexpr std::uint32_t kFeatures = kFeatureReflection | kFeatureTransmission |
                                               kFeatureInterior | kFeatureDelta |
                                               kFeatureAnisotropic;

    struct Params : AlphaParams<R>, MediumParams<R> {
        Value<Spectrum<R>> eta;
        const InterfaceSides<R>* sides = nullptr;

        static constexpr auto table() {
            return join(
                std::array{color<Params, R>(
                               "eta", &Params::eta,
                               "Index of refraction of the interior; [r, g, b] disperses light.")
                               .above(0, 1000)
                               .initially(1.5)
                               .constant_only()},
                join(join(MediumParams<R>::template absorption_rows<Params>(),
                          MediumParams<R>::template scattering_rows<Params>()),
                     join(AlphaParams<R>::template rows<Params>(0.0),
                          AlphaParams<R>::template multiscatter_row<Params>())));
        }
        static constexpr auto rules() {
            return join(MediumParams<R>::rules(), AlphaParams<R>::rules());
        }
    };

    Microfacet<R> surface;
    R eta{R(1.5)};  ///< relative: transmitted side over the side of wo
    Interior<R> inside;
    const InterfaceSides<R>* sides = nullptr;  ///< null: single scattering only
    CoatAlbedo<R> view;
    InterfaceLoss<R> loss;

    static ParamError check(const Params& p) {
        return p.multiscatter.v ? check_coat_textures(p) : p.check_shape();
    }
    static void tabulate(Params& p, TableStore<R>& store) {
        const Vec2<R> a = p.alphas();
        const bool rough = p.any_textured() || !is_delta_alpha(a.x, a.y);
        if (p.multiscatter.v && rough) p.sides = tabulate_interface(p, p.eta.v, store);
    }
    static Dielectric prepare(const Params& p) {
        const R middle = p.eta.v[kMiddleLane];
        const Interior<R> inside = p.interior(p.eta.v);
        const Dielectric d{p.microfacet(), middle, inside, p.sides, CoatTables<R>{}.view(p), {}};
        return d.at_interface(middle);
    }

    const Interior<R>& interior() const { return inside; }
    Dielectric at_interface(R eta_rel) const {
        Dielectric d = *this;
        d.eta = eta_rel;
        if (sides && !d.is_delta()) d.loss = InterfaceLoss<R>::make(*sides, view, eta_rel);
        return d;
    }

    /// Smooth, or so near to equal indices that the density of refracted directions leaves float:
    /// then transmission is a delta too (the largest density is D(0) times the Jacobian below).
    bool is_delta() const {
        if (surface.is_delta()) return true;
        return sqr(e()) * double(surface.alpha_x) * double(surface.alpha_y) < kDeltaTransmission;
    }

    bool is_anisotropic() const { return surface.is_anisotropic(); }
    std::uint8_t lobes() const {
        const int facets = is_delta() ? kSpecular : loss.on() ? kGlossy | kDiffuse : kGlossy;
        return std::uint8_t(facets | kReflection | kTransmission);
    }

    BsdfEval<R> eval(Vec3<R> wo, Vec3<R> wi) const {
        if (is_delta() || !(wo.z > R(0)) || wi.z == R(0)) return {};
        const BsdfEval<R> facets = eval_facets(wo, wi);
        return loss.on() ? mixed(facets, loss.lost(wo), wi) : facets;
    }

    std::optional<BsdfSample<R>> sample(Vec3<R> wo, Vec3<R> u) const {
        if (is_delta()) return sample_smooth(wo, u.x);
        if (loss.on()) return sample_mixed(wo, u);
        return sample_facets(wo, u);
    }

 private:
    /// Largest pdf that its square still fits into float, with room for grazing factors: 1e18.
    static constexpr double kDeltaTransmission = 4.0 / (3.14159265358979 * 1e18);

    double e() const { return (double(eta) - 1.0) * (double(eta) + 1.0); }

    /// dw_h / dw_i of a refraction: |i.h| / (i.h + o.h / eta)^2, with the difference taken on
    /// paper.
    double jacobian(double cos_o, double cos_t) const {
        const double g = double(eta) * cos_t;
        return cos_t * sqr(double(eta) * (cos_o + g) / e());
    }

    BsdfEval<R> eval_facets(Vec3<R> wo, Vec3<R> wi) const {
        return wi.z > R(0) ? eval_reflection(wo, wi) : eval_transmission(wo, wi);
    }
    std::optional<BsdfSample<R>> sample_facets(Vec3<R> wo, Vec3<R> u) const {
        const auto facet = surface.sample_visible(wo, u);
        return sample_facet(wo, facet.h, facet.u);
    }

    /// Single and multiple scattering together, the latter chosen as often as wo loses light to it.
    BsdfEval<R> mixed(BsdfEval<R> e, R lost_o, Vec3<R> wi) const {
        const BsdfEval<R> more = loss.eval(lost_o, wi);
        e.f += more.f;
        e.pdf = (R(1) - lost_o) * e.pdf + lost_o * more.pdf;
        return e;
    }

    std::optional<BsdfSample<R>> sample_mixed(Vec3<R> wo, Vec3<R> u) const {
        const R lost_o = loss.lost(wo);
        BsdfSample<R> s;
        BsdfEval<R> e;
        if (u.x < lost_o) {
            u.x = std::min(u.x / lost_o, kOneMinusEpsilon<R>);
            s.wi = loss.sample(u);
            if (s.wi.z == R(0)) return {};
            const bool crosses = s.wi.z < R(0);
            s.lobe = std::uint8_t(kDiffuse | (crosses ? kTransmission : kReflection));
            s.eta = crosses ? eta : R(1);
            e = mixed(eval_facets(wo, s.wi), lost_o, s.wi);
        } else {
            u.x = std::min((u.x - lost_o) / (R(1) - lost_o), kOneMinusEpsilon<R>);
            const auto facet = sample_facets(wo, u);
            if (!facet) return {};
            s = *facet;
            e = mixed({s.weight * s.pdf, s.pdf}, lost_o, s.wi);
        }
        if (!(e.pdf > R(0))) return {};
        s.weight = e.f * (R(1) / e.pdf);
        s.pdf = e.pdf;
        return s;
    }

    BsdfEval<R> eval_reflection(Vec3<R> wo, Vec3<R> wi) const {
        const auto half = HalfVector<R>::between(wo, wi);
        if (!(half.oh > R(0))) return {};
        const R F = fresnel_dielectric(half.oh, eta).reflectance;
        const R D = surface.D(half.h);
        const auto r = surface.reflection(wo, wi, half.h, false);
        return {Spectrum<R>(F * D * r.visibility), F * D * r.density};
    }

    BsdfEval<R> eval_transmission(Vec3<R> wo, Vec3<R> wi) const {
        // In double and to exact unit length: for indices near 1 the sum nearly vanishes, and at
        // the critical angle the cosines do.
        const Vec3d o = normalize(vec_cast<double>(wo));
        const Vec3d i = normalize(vec_cast<double>(wi));
        const Vec3d sum = o + i * double(eta);
        const Vec3d unit = normalize(eta > R(1) ? -sum : sum);
        const double cos_o = dot(o, unit);
        const double cos_t = -dot(i, unit);
        if (!(unit.z > 0.0) || !(cos_o > 0.0) || !(cos_t > 0.0)) return {};
        const Vec3<R> h = vec_cast<R>(unit);
        const double T = dielectric_transmittance(cos_o, double(eta) * cos_t, double(eta));
        const R pdf = R(T * jacobian(cos_o, cos_t)) * surface.D(h) * surface.visible_over_D(wo, h);
        if (!(pdf > R(0))) return {};
        const R weight = surface.transmission_weight(wo, wi, h) / (eta * eta);
        return {Spectrum<R>(pdf * weight), pdf};
    }

    Vec3<R> refract(Vec3<R> wo, Vec3<R> h, R cos_o, R cos_t) const {
        return normalize(h * (cos_o / eta - cos_t) - wo * (R(1) / eta));
    }

    std::optional<BsdfSample<R>> sample_smooth(Vec3<R> wo, R u) const {
        const FresnelTerms<R> F = fresnel_dielectric(wo.z, eta);
        if (u < F.reflectance)
            return BsdfSample<R>{
                {-wo.x, -wo.y, wo.z}, Spectrum<R>(R(1)), F.reflectance, kSpecular | kReflection};
        if (!(F.cos_theta_t > R(0))) return {};
        const Vec3<R> wi = refract(wo, {R(0), R(0), R(1)}, wo.z, F.cos_theta_t);
        return BsdfSample<R>{wi, Spectrum<R>(R(1) / (eta * eta)), F.transmittance,
                             kSpecular | kTransmission, eta};
    }

    std::optional<BsdfSample<R>> sample_facet(Vec3<R> wo, Vec3<R> h, R u) const {
        const R oh = dot(wo, h);
        if (!(oh > R(0))) return {};
        const FresnelTerms<R> F = fresnel_dielectric(oh, eta);
        const R D = surface.D(h);
        if (u < F.reflectance) {
            const Vec3<R> wi = reflect(wo, h);
            if (!(wi.z > R(0))) return {};
            const auto r = surface.reflection(wo, wi, h, false);
            return BsdfSample<R>{wi, Spectrum<R>(r.weight), F.reflectance * D * r.density,
                                 kGlossy | kReflection};
        }
        if (!(F.cos_theta_t > R(0))) return {};
        const Vec3<R> wi = refract(wo, h, oh, F.cos_theta_t);
        if (!(wi.z < R(0))) return {};
        const R through = surface.transmission_weight(wo, wi, h) / (eta * eta);
        const R J = R(jacobian(double(oh), double(F.cos_theta_t)));
        const R pdf = F.transmittance * D * surface.visible_over_D(wo, h) * J;
        return BsdfSample<R>{wi, Spectrum<R>(through), pdf, kGlossy | kTransmission, eta};
    }
};

}  // namespace matiere
