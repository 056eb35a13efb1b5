// Two materials on one surface: f = (1 - weight) f_a + weight f_b, as the statistical blend of
// patches too small to see. Nest mixes for more than two. Energy is that of the parts; reciprocal
// where both are. Sampling picks a part by its weight; densities of all parts that are no delta are
// combined (one-sample balance heuristic, Veach 1997, 9.2.4), so weight = eval / pdf.
#pragma once

#include <algorithm>

#include "base/numeric.h"
#include "material/model.h"

namespace matiere {

template <class R>
struct Mix {
    static constexpr std::string_view kName = "mix";
    static constexpr std::string_view kDoc = "Two materials blended by a weight, often a texture.";
    static constexpr std::string_view kSource = "linear blend; Veach 1997, 9.2.4 (sampling)";
    static constexpr std::uint32_t kFeatures = 0;  // those of its parts

    struct Params {
        Value<Nested<R>> a, b;
        Value<R> weight;

        static constexpr auto table() {
            return std::array{
                material<Params, R>("a", &Params::a, "What weight 0 shows.").required(),
                material<Params, R>("b", &Params::b, "What weight 1 shows.").required(),
                scalar("weight", &Params::weight, "Share of b.").range(0, 1).initially(0.5)};
        }
        static constexpr std::array<Rule, 0> rules() { return {}; }
    };

    Nested<R> a, b;
    R weight{};

    static Mix prepare(const Params& p) { return {p.a.v, p.b.v, p.weight.v}; }

    bool has_a() const { return weight < R(1); }
    bool has_b() const { return weight > R(0); }

    std::uint8_t lobes() const {
        return std::uint8_t((has_a() ? a.lobes() : 0) | (has_b() ? b.lobes() : 0));
    }
    R null_share() const { return (R(1) - weight) * a.null_share() + weight * b.null_share(); }
    bool is_stochastic() const { return a.is_stochastic() || b.is_stochastic(); }

    Spectrum<R> diffuse(Vec3<R> wo, Vec3<R> wi) const {
        Spectrum<R> sum;
        if (has_a()) sum += a.diffuse(wo, wi) * (R(1) - weight);
        if (has_b()) sum += b.diffuse(wo, wi) * weight;
        return sum;
    }

    BsdfEval<R> eval(Vec3<R> wo, Vec3<R> wi) const {
        BsdfEval<R> sum;
        if (has_a()) add(sum, R(1) - weight, a.eval(wo, wi));
        if (has_b()) add(sum, weight, b.eval(wo, wi));
        return sum;
    }

    std::optional<BsdfSample<R>> sample(Vec3<R> wo, Vec3<R> u) const {
        const bool pick_b = u.x < weight;
        const R share = pick_b ? weight : R(1) - weight;
        u.x = std::min(pick_b ? u.x / weight : (u.x - weight) / share, kOneMinusEpsilon<R>);
        auto s = (pick_b ? b : a).sample(wo, u);
        if (!s) return s;
        if ((s->lobe & kSpecular) != 0) {
            s->pdf *= share;
            return s;
        }
        const Nested<R>& other = pick_b ? a : b;
        BsdfEval<R> e;
        if (share < R(1)) add(e, R(1) - share, other.eval(wo, s->wi));
        e.f += s->weight * (s->pdf * share);
        e.pdf += s->pdf * share;
        s->pdf = e.pdf;
        // A stochastic part's pdf is a stand-in that must not enter its weight: only its own walk.
        if (!is_stochastic()) s->weight = e.f * (R(1) / e.pdf);
        return s;
    }

 private:
    static void add(BsdfEval<R>& sum, R share, const BsdfEval<R>& part) {
        sum.f += part.f * share;
        sum.pdf += part.pdf * share;
    }
};

}  // namespace matiere
