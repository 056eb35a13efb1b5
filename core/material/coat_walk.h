// Light between a coat's surface and its base, followed event by event: unbiased, all bounces
// (Guo, Hasan & Zhao 2018, "Position-Free Monte Carlo Simulation for Arbitrary Layered BSDFs", the
// unidirectional estimator; Pharr, Jakob & Humphreys 2023, 14.3). The slab absorbs and does not
// scatter, so every crossing is known from its cosine.
#pragma once

#include <optional>

#include "base/hash_stream.h"
#include "material/coat.h"
#include "material/nested.h"
#include "sampling/warp.h"

namespace matiere {

template <class R>
class CoatWalk {
 public:
    CoatWalk(const Coat<R>& coat, const Nested<R>& base) : coat_(coat), base_(base) {}

    /// An unbiased estimate of f cos_i without delta lobes; `pdf` stands in for the density.
    BsdfEval<R> eval(Vec3<R> wo, Vec3<R> wi) const {
        if (!(wo.z > R(0)) || !(wi.z > R(0))) return {};
        BsdfEval<R> sum{coat_.is_delta() ? Spectrum<R>() : coat_.above.eval(wo, wi).f,
                        stand_in(wo, wi)};
        HashStream<R> u(wo, wi, kEval);
        std::optional<Inside> at = enter(wo, u);
        for (int bounce = 0; at && bounce < kMaxBounces; ++bounce) {
            at->beta *= coat_.transmittance(at->o.z);
            sum.f += at->beta * connect(at->o, wi, u);
            const auto s = base_.sample(at->o, u.next3());
            if (!s || !(s->wi.z > R(0))) break;
            at->beta *= s->weight * coat_.transmittance(s->wi.z);
            sum.f += at->beta * exit_to(*s, wi);
            at = reflect_below(*at, s->wi, u);
            if (at && !survive(*at, bounce, u)) break;
        }
        return sum;
    }

    /// A walk from wo until it leaves; its throughput is the weight.
    std::optional<BsdfSample<R>> sample(Vec3<R> wo, Vec3<R> u3) const {
        const auto first = coat_.above.sample(wo, u3);
        if (!first) return {};
        if (first->wi.z > R(0)) return finish(wo, *first);
        HashStream<R> u(wo, u3, kSample);
        Inside at{-first->wi, first->weight};
        std::uint8_t seen = 0;
        for (int bounce = 0; bounce < kMaxBounces; ++bounce) {
            const auto s = base_.sample(at.o, u.next3());
            if (!s || !(s->wi.z > R(0))) return {};
            seen |= s->lobe;
            at.beta *= coat_.transmittance(at.o.z) * s->weight * coat_.transmittance(s->wi.z);
            const auto t = coat_.below.sample({-s->wi.x, -s->wi.y, s->wi.z}, u.next3());
            if (!t) return {};
            at.beta *= t->weight;
            if (t->wi.z < R(0)) {
                // eval cannot find a walk whose last turn and exit are both delta.
                const bool sharp = coat_.is_delta() && (s->lobe & kSpecular) != 0;
                const int kind = sharp ? kSpecular : (seen & kDiffuse) != 0 ? kDiffuse : kGlossy;
                return finish(wo, {{t->wi.x, t->wi.y, -t->wi.z},
                                   at.beta,
                                   R(1),
                                   std::uint8_t(kind | kReflection)});
            }
            at.o = {-t->wi.x, -t->wi.y, t->wi.z};
            if (!survive(at, bounce, u)) return {};
        }
        return {};
    }

 private:
    static constexpr std::uint64_t kEval = 0x6576616cU, kSample = 0x73616d70U;
    static constexpr int kMaxBounces = 1000;    // of a walk that nothing absorbs
    static constexpr int kRouletteBounces = 3;  // before roulette may end it

    /// At the base: the direction towards the viewer's side of the walk, and its throughput.
    struct Inside {
        Vec3<R> o;
        Spectrum<R> beta;
    };

    std::optional<Inside> enter(Vec3<R> wo, HashStream<R>& u) const {
        if (coat_.is_delta()) {
            const auto in = coat_.enter(wo);
            if (!(in.T > R(0))) return {};
            return Inside{in.w, Spectrum<R>(in.T / sqr(coat_.eta()))};
        }
        const auto s = coat_.above.sample(wo, u.next3());
        if (!s || s->wi.z > R(0)) return {};
        return Inside{-s->wi, s->weight};
    }

    /// From the base straight out to wi, through a point of the surface drawn from wi.
    Spectrum<R> connect(Vec3<R> o, Vec3<R> wi, HashStream<R>& u) const {
        if (coat_.is_delta()) {
            const auto in = coat_.enter(wi);
            if (!(in.T > R(0))) return {};
            return base_.eval(o, in.w).f * coat_.transmittance(in.w.z) * (in.T * wi.z / in.w.z);
        }
        const auto s = coat_.above.sample(wi, u.next3());
        if (!s || s->wi.z > R(0)) return {};
        const Vec3<R> v = -s->wi;
        const BsdfEval<R> e = base_.eval(o, v);
        if (e.f.is_black()) return {};
        // By reciprocity f(v, wi) = eta^2 f(wi, -v).
        const R turned = sqr(coat_.eta()) * wi.z / v.z;
        return e.f * s->weight * coat_.transmittance(v.z) * (turned * power(s->pdf, e.pdf));
    }

    /// From a sampled turn at the base out to wi, through the rough surface.
    Spectrum<R> exit_to(const BsdfSample<R>& s, Vec3<R> wi) const {
        if (coat_.is_delta()) return {};
        const BsdfEval<R> t = coat_.above.eval(wi, -s.wi);
        const R share = (s.lobe & kSpecular) != 0 ? R(1) : power(s.pdf, t.pdf);
        return t.f * (sqr(coat_.eta()) * wi.z / s.wi.z * share);
    }

    std::optional<Inside> reflect_below(const Inside& at, Vec3<R> w, HashStream<R>& u) const {
        if (coat_.is_delta()) {
            const R F = fresnel_dielectric(w.z, R(1) / coat_.eta()).reflectance;
            return Inside{{-w.x, -w.y, w.z}, at.beta * F};
        }
        const auto t = coat_.below.sample({-w.x, -w.y, w.z}, u.next3());
        if (!t || t->wi.z < R(0)) return {};
        return Inside{{-t->wi.x, -t->wi.y, t->wi.z}, at.beta * t->weight};
    }

    bool survive(Inside& at, int bounce, HashStream<R>& u) const {
        const R q = at.beta.max_value() * sqr(coat_.eta());  // as energy: radiance is compressed
        if (!(q > R(0))) return false;
        if (bounce < kRouletteBounces || q >= R(1)) return true;
        if (u.next() >= q) return false;
        at.beta *= R(1) / q;
        return true;
    }

    static R power(R a, R b) {
        const R ratio = b / a;
        return R(1) / (R(1) + ratio * ratio);
    }

    std::optional<BsdfSample<R>> finish(Vec3<R> wo, BsdfSample<R> s) const {
        s.eta = R(1);
        if ((s.lobe & kSpecular) == 0) s.pdf = stand_in(wo, s.wi);
        return s;
    }

    /// A deterministic, positive density near that of `sample`: for weighting techniques only.
    R stand_in(Vec3<R> wo, Vec3<R> wi) const {
        constexpr R kSpread = R(0.3);  // of the base's part: what its own lobe does not tell
        const auto o = coat_.enter(wo), i = coat_.enter(wi);
        R body = kSpread * cosine_hemisphere_pdf(wi.z);
        if (o.T > R(0) && i.T > R(0))
            body += (R(1) - kSpread) * base_.eval(o.w, i.w).pdf * wi.z / (i.w.z * sqr(coat_.eta()));
        if (coat_.is_delta()) return o.T > R(0) ? o.T * body : body;
        return (R(1) - o.T) * coat_.lobe.eval(wo, wi).pdf + std::max(o.T, R(0.1)) * body;
    }

    const Coat<R>& coat_;
    const Nested<R>& base_;
};

}  // namespace matiere
