// A coat (varnish, lacquer, glaze) over any other opaque material; coats over coats by nesting. The
// base scatters as it is, under directions refracted into the coat. Methods:
//   walk             every bounce between surface and base, by an unbiased random walk: the
//                    reference (Guo, Hasan & Zhao 2018). Each evaluation is an estimate.
//   weidlich_wilkie  one pass down and up (Weidlich & Wilkie 2007): f = f_coat + T(o) T(i) a(o)
//                    a(i) f_base(o', i') / eta^2. With the 1 / eta^2 and the density's Jacobian
//                    that the paper lacks, refraction at the mean surface, and without its
//                    heuristic t: reciprocal, loses what bounces again (docs/layered-gap.md).
//   exact            a smooth coat over Lambert, all bounces in closed form, absorption included:
//                    f = T(o) T(i) a(o) a(i) rho / (pi eta^2 (1 - rho r)), r from coat_return.h.
// a(w) = exp(-sigma_a thickness / cos w'). Reciprocal (walk: in the mean) where the base is.
#pragma once

#include "material/coat_walk.h"
#include "material/model.h"
#include "optics/coat_return.h"

namespace matiere {

inline constexpr std::array<std::string_view, 3> kLayerMethodNames = {"walk", "weidlich_wilkie",
                                                                      "exact"};
enum class LayerMethod : std::uint8_t { kWalk, kWeidlichWilkie, kExact };

template <class R>
struct Layered {
    static constexpr std::string_view kName = "layered";
    static constexpr std::string_view kDoc = "A clear or absorbing coat over another material.";
    static constexpr std::string_view kSource =
        "Weidlich & Wilkie 2007, corrected; Guo, Hasan & Zhao 2018";
    static constexpr std::uint32_t kFeatures =
        kFeatureReflection | kFeatureDelta | kFeatureAnisotropic;

    struct Params : AlphaParams<R> {
        Value<Nested<R>> base;
        Value<R> eta, thickness;
        Value<Spectrum<R>> sigma_a;
        Value<int> method;
        Spectrum<R> escaping;                   ///< 1 - r of the closed form
        typename Dielectric<R>::Params walked;  ///< the surface as walks see it, with its tables

        static constexpr auto table() {
            return join(
                std::array{
                    material<Params, R>("base", &Params::base, "What lies under the coat.")
                        .required(),
                    scalar<Params, R>("eta", &Params::eta,
                                      "Index of the coat over that of what lies above it.")
                        .above(0, 1000)
                        .initially(1.5)
                        .constant_only(),
                    color<Params, R>("sigma_a", &Params::sigma_a, "Absorption of the coat.")
                        .range(0, kUnlimited)
                        .initially(0)
                        .unit("1/m"),
                    scalar<Params, R>("thickness", &Params::thickness, "Thickness of the coat.")
                        .range(0, kUnlimited)
                        .initially(0)
                        .unit("m"),
                    choice<Params, R>("method", &Params::method, kLayerMethodNames,
                                      "How light between surface and base is counted.")
                        .initially(0),
                    flag<Params, R>("multiscatter", &Params::multiscatter,
                                    "Walks count light that meets several facets of the surface.")
                        .initially(1)},
                AlphaParams<R>::template rows<Params>(0.0));
        }
        static constexpr auto rules() {
            return join(std::array{together("sigma_a", "thickness")}, AlphaParams<R>::rules());
        }
        Spectrum<R> tau() const {
            return sigma_a.v.map(
                [&](R s) { return s > R(0) && thickness.v > R(0) ? s * thickness.v : R(0); });
        }
    };

    Coat<R> coat;
    Nested<R> base;
    LayerMethod method{};
    Spectrum<R> escaping;

    static ParamError check(const Params& p) {
        if ((p.base.v.lobes() & kTransmission) != 0)
            return {"base", "what lies under a coat must not let light through"};
        if (LayerMethod(p.method.v) == LayerMethod::kWalk)
            return Dielectric<R>::check(surface_params(p));
        if (LayerMethod(p.method.v) == LayerMethod::kWeidlichWilkie) return p.check_shape();
        if (p.base.v.name() != "lambert")
            return {"method", "exact is for a lambert base; use walk for others"};
        if (p.any_textured() || p.alphas().x > R(0) || p.alphas().y > R(0))
            return {"method", "exact is for a smooth coat, alpha 0; use walk for rough ones"};
        if (p.sigma_a.textured || p.thickness.textured)
            return {"method", "exact takes a constant sigma_a and thickness; use walk"};
        return {};
    }
    static void tabulate(Params& p, TableStore<R>& store) {
        p.walked = surface_params(p);
        if (LayerMethod(p.method.v) == LayerMethod::kWalk) Dielectric<R>::tabulate(p.walked, store);
        if (LayerMethod(p.method.v) == LayerMethod::kExact)
            p.escaping =
                p.tau().map([&](R t) { return R(coat_escape(double(p.eta.v), double(t))); });
    }
    static Layered prepare(const Params& p) {
        const Dielectric<R> d = Dielectric<R>::prepare(surface_params(p));
        const MicrofacetLobe<R> lobe{p.microfacet(),
                                     FresnelTerm<R>::dielectric(Spectrum<R>(p.eta.v))};
        return {{d.at_interface(p.eta.v), d.at_interface(R(1) / p.eta.v), lobe, p.tau()},
                p.base.v,
                LayerMethod(p.method.v),
                p.escaping};
    }

    bool is_anisotropic() const { return coat.lobe.surface.is_anisotropic(); }
    bool is_stochastic() const { return method == LayerMethod::kWalk || base.is_stochastic(); }

    std::uint8_t lobes() const {
        const auto below = std::uint8_t(base.lobes() & ~kReflection);
        if (coat.is_delta()) return std::uint8_t(below | kSpecular | kReflection);
        const bool blurs = method == LayerMethod::kWalk;
        return std::uint8_t((blurs ? below & ~kSpecular : below) | kGlossy | kReflection);
    }

    /// All that a base with a diffuse lobe scatters, through the coat and within it.
    Spectrum<R> diffuse(Vec3<R> wo, Vec3<R> wi) const {
        if ((base.lobes() & kDiffuse) == 0) return {};
        const Spectrum<R> below = eval(wo, wi).f - coat.lobe.eval(wo, wi).f;
        return below.map([](R x) { return x > R(0) ? x : R(0); });
    }

    BsdfEval<R> eval(Vec3<R> wo, Vec3<R> wi) const {
        if (method == LayerMethod::kWalk) return CoatWalk<R>(coat, base).eval(wo, wi);
        if (!(wo.z > R(0)) || !(wi.z > R(0))) return {};
        const auto o = coat.enter(wo);
        const R q = base_probability(o);
        const BsdfEval<R> e = coat.lobe.eval(wo, wi);
        const BsdfEval<R> b = eval_base(o, coat.enter(wi), wi);
        return {e.f + b.f, (R(1) - q) * e.pdf + q * b.pdf};
    }

    std::optional<BsdfSample<R>> sample(Vec3<R> wo, Vec3<R> u) const {
        if (method == LayerMethod::kWalk) return CoatWalk<R>(coat, base).sample(wo, u);
        const auto o = coat.enter(wo);
        const R q = base_probability(o);
        if (!(u.x < q)) {
            u.x = std::min((u.x - q) / (R(1) - q), kOneMinusEpsilon<R>);
            auto s = coat.lobe.sample(wo, u);
            if (!s) return s;
            s->weight *= R(1) / (R(1) - q);
            s->pdf *= R(1) - q;
            return (s->lobe & kSpecular) != 0 ? s : combined(wo, *s);
        }
        u.x = std::min(u.x / q, kOneMinusEpsilon<R>);
        if (method == LayerMethod::kExact)
            return combined(
                wo, {square_to_cosine_hemisphere(u.y, u.z), {}, R(1), kDiffuse | kReflection});
        auto s = base.sample(o.w, u);
        if (!s) return s;
        const auto out = coat.leave(s->wi);
        if (!(out.T > R(0))) return {};
        s->weight *= crossing(o.w.z, s->wi.z) * (o.T * out.T / q);
        s->pdf *= q;
        if ((s->lobe & kSpecular) == 0) s->pdf *= out.w.z / (s->wi.z * sqr(coat.eta()));
        s->wi = out.w;
        return (s->lobe & kSpecular) != 0 ? s : combined(wo, *s);
    }

 private:
    static typename Dielectric<R>::Params surface_params(const Params& p) {
        typename Dielectric<R>::Params surface = p.walked;
        static_cast<AlphaParams<R>&>(surface) = p;
        surface.eta.v = Spectrum<R>(p.eta.v);
        return surface;
    }

    using Refracted = typename Coat<R>::Refracted;

    Spectrum<R> crossing(R cos_o, R cos_i) const {
        return coat.transmittance(cos_o) * coat.transmittance(cos_i);
    }
    /// All bounces of the closed form over the one pass.
    Spectrum<R> bounces() const {
        const Vec3<R> up{R(0), R(0), R(1)};
        Spectrum<R> more{R(1)};
        const auto s = base.sample(up, {R(0.5), R(0.5), R(0.5)});
        if (!s) return more;
        const Spectrum<R> rho = s->weight;  // of Lambert: its albedo, to the last digit
        for (int c = 0; c < kActiveLanes; ++c)
            more[c] = R(1) / (R(1) - rho[c] + rho[c] * escaping[c]);
        return more;
    }

    /// Probability of sampling the base rather than the surface's reflection.
    R base_probability(const Refracted& o) const {
        const R below = o.T > R(0) ? o.T * crossing(o.w.z, o.w.z).average() : R(0);
        return below > R(0) ? below / (o.F + below) : R(0);
    }

    BsdfEval<R> eval_base(const Refracted& o, const Refracted& i, Vec3<R> wi) const {
        if (!(o.T > R(0)) || !(i.T > R(0))) return {};  // eta < 1: total reflection outside
        const BsdfEval<R> b = base.eval(o.w, i.w);
        const R jacobian = wi.z / (i.w.z * sqr(coat.eta()));
        const Spectrum<R> f = b.f * crossing(o.w.z, i.w.z) * (o.T * i.T * jacobian);
        if (method == LayerMethod::kExact) return {f * bounces(), cosine_hemisphere_pdf(wi.z)};
        return {f, b.pdf * jacobian};
    }

    /// A stochastic base's pdf is a stand-in: its sample keeps its own weight.
    std::optional<BsdfSample<R>> combined(Vec3<R> wo, BsdfSample<R> s) const {
        const BsdfEval<R> e = eval(wo, s.wi);
        if (!(e.pdf > R(0))) return {};
        s.pdf = e.pdf;
        if (!is_stochastic()) s.weight = e.f * (R(1) / e.pdf);
        return s;
    }
};

}  // namespace matiere
