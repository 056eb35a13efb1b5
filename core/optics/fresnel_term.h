// One Fresnel reflectance per channel, whichever way a material states it.
#pragma once

#include <array>

#include "optics/fresnel.h"

namespace matiere {

/// Schlick 1994 from F0; the same with an edge tint at 82 degrees; exact dielectric or conductor;
/// or one colour at every angle, for lobes older than their Fresnel term.
template <class R>
struct FresnelTerm {
    enum class Kind : unsigned char { kSchlick, kF82, kDielectric, kConductor, kConstant };

    Kind kind = Kind::kSchlick;
    Spectrum<R> a;  ///< F0, or eta
    Spectrum<R> b;  ///< F82: weight of mu (1 - mu)^6; conductor: k

    static FresnelTerm schlick(const Spectrum<R>& F0) { return {Kind::kSchlick, F0, {}}; }

    static FresnelTerm constant(const Spectrum<R>& color) { return {Kind::kConstant, color, {}}; }

    /// `tint` scales Schlick's value at cos = 1/7, near 82 degrees (Hoffman 2019, Kutz et al.
    /// 2021).
    static FresnelTerm f82(const Spectrum<R>& F0, const Spectrum<R>& tint) {
        constexpr R kInverse = R(17.6513846021947873800);       // 7 (7/6)^6
        constexpr R kSchlickAt82 = R(0.462664366037960373654);  // (6/7)^5
        FresnelTerm f{Kind::kF82, F0, {}};
        for (int i = 0; i < kActiveLanes; ++i)
            f.b[i] = (F0[i] + (R(1) - F0[i]) * kSchlickAt82) * (R(1) - tint[i]) * kInverse;
        return f;
    }
    template <class To>
    FresnelTerm<To> cast() const {
        using ToKind = typename FresnelTerm<To>::Kind;
        return {ToKind(kind), spectrum_cast<To>(a), spectrum_cast<To>(b)};
    }

    static FresnelTerm dielectric(const Spectrum<R>& eta) { return {Kind::kDielectric, eta, {}}; }
    static FresnelTerm conductor(const Spectrum<R>& eta, const Spectrum<R>& k) {
        return {Kind::kConductor, eta, k};
    }

    Spectrum<R> operator()(R cos_theta) const {
        switch (kind) {
            case Kind::kSchlick:
                return fresnel_schlick(cos_theta, a);
            case Kind::kF82:
                return combine(terms(cos_theta));
            case Kind::kDielectric:
                return dielectric_reflectance(cos_theta);
            case Kind::kConductor:
                return fresnel_conductor(cos_theta, a, b);
            case Kind::kConstant:
                return a;
        }
        return {};
    }

    /// The same with 1 - cos_theta from whoever knows it better: all that Schlick's law sees near
    /// normal incidence where F0 is 0.
    Spectrum<R> operator()(R cos_theta, R versed) const {
        if (kind != Kind::kSchlick && kind != Kind::kF82) return (*this)(cos_theta);
        const R w = sqr(versed * versed) * versed;
        if (kind == Kind::kF82) return combine({R(1), w, cos_theta * versed * w});
        return a * (R(1) - w) + Spectrum<R>(w);
    }

    /// Whether reflectance is linear in the three terms (1, (1-c)^5, c (1-c)^6): then one table of
    /// directional albedo serves every F0, textures included.
    bool is_linear() const {
        return kind == Kind::kSchlick || kind == Kind::kF82 || kind == Kind::kConstant;
    }

    /// Cosine-weighted average over the hemisphere: closed for the linear ones (Hoffman 2019),
    /// Gauss-Legendre in the root of the cosine for the others.
    Spectrum<R> average() const {
        if (is_linear()) return combine({R(1), R(1) / R(21), R(1) / R(126)});
        constexpr std::array<R, 4> kNodes{R(0.18343464249564981), R(0.52553240991632899),
                                          R(0.79666647741362674), R(0.96028985649753623)};
        constexpr std::array<R, 4> kWeights{R(0.36268378337836198), R(0.31370664587788729),
                                            R(0.22238103445337448), R(0.10122853629037626)};
        Spectrum<R> sum;
        for (std::size_t i = 0; i < kNodes.size(); ++i)
            for (const R side : {R(-1), R(1)}) {
                const R t = R(0.5) * (R(1) + side * kNodes[i]);
                sum += (*this)(t * t) * (R(2) * kWeights[i] * t * t * t);
            }
        return sum.map([](R x) { return std::min(x, R(1)); });
    }

    static Spectrum<R> terms(R cos_theta) {
        const R m = std::clamp(R(1) - cos_theta, R(0), R(1));
        const R w = schlick_weight(cos_theta);
        return {R(1), w, cos_theta * m * w};
    }

    /// Reflectance (or an average of it) from the (averages of the) three terms.
    Spectrum<R> combine(const Spectrum<R>& t) const {
        Spectrum<R> f = kind == Kind::kConstant ? a * t[0] : a * (t[0] - t[1]) + Spectrum<R>(t[1]);
        if (kind == Kind::kF82) f -= b * t[2];
        return f.map([](R x) { return std::clamp(x, R(0), R(1)); });
    }

 private:
    Spectrum<R> dielectric_reflectance(R cos_theta) const {
        const auto F = [cos_theta](R n) {
            return std::isinf(n) ? R(1) : fresnel_dielectric(cos_theta, n).reflectance;
        };
        if (a[0] == a[1] && a[1] == a[2]) return Spectrum<R>(F(a[0]));
        return a.map(F);
    }
};

}  // namespace matiere
