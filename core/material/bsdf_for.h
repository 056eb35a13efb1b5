// The scattering of one hit. The only place that turns world directions into local ones, keeps
// shading and geometric sides apart, and rejects what is not finite, counting why.
#pragma once

#include <algorithm>
#include <cmath>
#include <optional>
#include <type_traits>
#include <variant>

#include "base/features.h"
#include "base/frame.h"
#include "base/guard.h"
#include "material/bsdf.h"
#include "material/material.h"

namespace matiere {

inline constexpr std::uint8_t kNullLobes = kSpecular | kTransmission | kNull;

/// Shading normals that would face away from the viewer are bent until wo is just above their
/// horizon; 1e-3 keeps the black rim of coarse meshes away and cosines out of the denormals.
inline constexpr float kMinShadingCosine = 1e-3F;

inline Vec3f bend_towards(Vec3f n_s, Vec3f wo, Vec3f n_g) {
    const float target = std::min(kMinShadingCosine, dot(wo, n_g));
    const float c = dot(wo, n_s);
    if (c >= target) return n_s;
    const Vec3f tangential = n_s - wo * c;
    const float l2 = length_squared(tangential);
    if (!(l2 > 1e-8F)) return n_g;
    return tangential * std::sqrt((1.0F - target * target) / l2) + wo * target;
}

/// A model that is any of the list, made once or at the hit.
class AnyModelAt {
 public:
    /// Whether f and weight are finite where the density is.
    static constexpr bool kBounded = false;

    void set(const MaterialTable& table, const MaterialRecord& record, const SurfacePoint& point,
             float eta_rel) {
        if (record.made_at_hits)
            own_ = record.recipe.at(table.textures(), point.texture_point(), eta_rel, nested_);
        else
            constant_ = &record.recipe.model();
    }
    BsdfEval<float> eval(Vec3f wo, Vec3f wi) const { return eval_model<float>(model(), wo, wi); }
    std::optional<BsdfSample<float>> sample(Vec3f wo, Vec3f u) const {
        return sample_model<float>(model(), wo, u);
    }
    std::uint8_t lobes() const { return model_lobes<float>(model()); }
    Spectrumf diffuse(Vec3f wo, Vec3f wi) const { return model_diffuse<float>(model(), wo, wi); }

 private:
    const AnyModel<float>& model() const { return constant_ ? *constant_ : own_; }

    const AnyModel<float>* constant_ = nullptr;  // null: own_
    AnyModel<float> own_;
    NestedModels<float> nested_;  // of own_
};

/// Where no texture and no other medium shapes a model.
class ConstantModelAt {
 public:
    static constexpr bool kBounded = false;

    void set(const MaterialTable&, const MaterialRecord& record, const SurfacePoint&, float) {
        model_ = &record.recipe.model();
    }
    BsdfEval<float> eval(Vec3f wo, Vec3f wi) const { return eval_model<float>(*model_, wo, wi); }
    std::optional<BsdfSample<float>> sample(Vec3f wo, Vec3f u) const {
        return sample_model<float>(*model_, wo, u);
    }
    std::uint8_t lobes() const { return model_lobes<float>(*model_); }

 private:
    const AnyModel<float>* model_ = nullptr;
};

/// Where every surface is constant lambert: no dispatch at all.
class LambertAt {
 public:
    static constexpr bool kBounded = true;

    void set(const MaterialTable&, const MaterialRecord& record, const SurfacePoint&, float) {
        model_ = std::get_if<Lambert<float>>(&record.recipe.model());
    }
    BsdfEval<float> eval(Vec3f wo, Vec3f wi) const { return model_->eval(wo, wi); }
    std::optional<BsdfSample<float>> sample(Vec3f wo, Vec3f u) const {
        return model_->sample(wo, u);
    }
    std::uint8_t lobes() const { return model_->lobes(); }

 private:
    const Lambert<float>* model_ = nullptr;
};

/// Made for one wo; small, no heap, no virtual calls. Has code for the features F alone; on a
/// surface that needs no more it gives the same bits whatever F is.
template <Features F>
class BsdfFor {
 public:
    /// `wo` is the unit world direction to the viewer; `eta_rel` the index of the medium on the
    /// other side over that on the side of wo, read by interfaces only.
    BsdfFor(const MaterialTable& table, int material, const SurfacePoint& point, Vec3f wo,
            float eta_rel)
        : n_g_(point.n_g), material_(material) {
        const MaterialRecord& record = table[material];
        Vec3f n_s = point.n_s;
        if constexpr (has(F, kNeedsMaps))
            if (record.mapped()) n_s = table.shading_normal(material, point);
        if (dot(wo, n_g_) < 0.0F) {
            n_g_ = -n_g_;
            n_s = -n_s;
            black_ = !record.two_sided && (record.features & kFeatureTransmission) == 0;
        }
        n_s = bend_towards(n_s, wo, n_g_);
        if (has(F, kNeedsTangents) && (record.features & kFeatureAnisotropic) != 0)
            frame_ = Framef::from_normal_tangent(n_s, point.first.dpdu);
        else
            frame_ = Framef::from_normal(n_s);
        model_.set(table, record, point, eta_rel);
        if constexpr (has(F, kNeedsPassing))
            if (record.passes) opacity_ = table.opacity(material, point.texture_point());
    }
    BsdfFor(const BsdfFor&) = delete;  // a model may point into its own nested ones
    BsdfFor& operator=(const BsdfFor&) = delete;

    /// f |cos| and pdf for world directions. Zero where geometric and shading sides disagree, so
    /// that no light leaks through. What is not finite is returned as it is, for the caller to
    /// count.
    BsdfEval<float> eval(Vec3f wo, Vec3f wi) const {
        const Vec3f local_o = frame_.to_local(wo);
        const Vec3f local_i = frame_.to_local(wi);
        const float side = dot(wi, n_g_);
        if (black_ || !(local_o.z > 0.0F) || !(local_i.z * side > 0.0F)) return {};
        BsdfEval<float> e = model_.eval(local_o, local_i);
        if (opacity() < 1.0F) {
            e.f *= opacity();
            e.pdf *= opacity();
        }
        return e;
    }
    /// The same; what is not finite is zeroed and counted.
    BsdfEval<float> eval(Vec3f wo, Vec3f wi, Counters& counters) const {
        const BsdfEval<float> e = eval(wo, wi);
        if ((ModelAt::kBounded || e.f.is_finite()) && std::isfinite(e.pdf)) return e;
        counters.reject(Reject::kNonFiniteEval, material_);
        return {};
    }

    /// A world direction, or nothing where the sample is absorbed or rejected. u.x picks the lobe.
    /// A kNull sample goes on in the direction -wo: no scattering event.
    std::optional<BsdfSample<float>> sample(Vec3f wo, Vec3f u, Counters& counters) const {
        if (!(opacity() < 1.0F)) return sample_surface(wo, u, counters);
        const float gap = 1.0F - opacity();
        if (u.x < gap) return BsdfSample<float>{-wo, Spectrumf(1.0F), gap, kNullLobes};
        u.x = std::min((u.x - gap) / opacity(), kOneMinusEpsilon<float>);
        auto s = sample_surface(wo, u, counters);
        if (s) s->pdf *= opacity();
        return s;
    }

    /// By which lobes light from `wi` comes to `wo`.
    LobeSplit split(Vec3f wo, Vec3f wi) const {
        LobeSplit found;
        found.transmission = dot(wi, n_g_) < 0.0F;
        if (found.transmission) return found;
        const Vec3f local_o = frame_.to_local(wo), local_i = frame_.to_local(wi);
        const Spectrumf all = model_.eval(local_o, local_i).f;
        const Spectrumf diffuse = model_.diffuse(local_o, local_i);
        for (int i = 0; i < kActiveLanes; ++i)
            if (all[i] > 0.0F) found.diffuse[i] = std::clamp(diffuse[i] / all[i], 0.0F, 1.0F);
        return found;
    }

    std::uint8_t lobes() const {
        const std::uint8_t gap = opacity() < 1.0F ? kNullLobes : 0;
        if (black_ || opacity() == 0.0F) return gap;
        return std::uint8_t(gap | model_.lobes());
    }
    bool is_delta() const { return (lobes() & (kDiffuse | kGlossy)) == 0; }
    bool may_pass() const { return (lobes() & kNull) != 0; }
    /// The shading frame, its normal on the side of wo.
    const Framef& frame() const { return frame_; }

 private:
    using ModelAt =
        std::conditional_t<has(F, kNeedsTextures | kNeedsInteriors), AnyModelAt,
                           std::conditional_t<has(F, kNeedsModels), ConstantModelAt, LambertAt>>;

    float opacity() const { return has(F, kNeedsPassing) ? opacity_ : 1.0F; }

    std::optional<BsdfSample<float>> sample_surface(Vec3f wo, Vec3f u, Counters& counters) const {
        const Vec3f local_o = frame_.to_local(wo);
        if (black_ || !(local_o.z > 0.0F)) return {};
        auto s = model_.sample(local_o, u);
        if (!s) return {};
        if (!(ModelAt::kBounded || s->weight.is_finite()) || !std::isfinite(s->pdf) ||
            !is_finite(s->wi)) {
            counters.reject(Reject::kNonFiniteSample, material_);
            return {};
        }
        if (s->weight.is_black() || !(s->pdf > 0.0F)) return {};
        if (has(F, kNeedsPassing) && (s->lobe & kNull) != 0) {
            s->wi = -wo;
            return s;
        }
        // A direction above the shading horizon but below the surface (or the reverse) is absorbed,
        // as eval says; the surface would shadow it.
        const float local_z = s->wi.z;
        s->wi = frame_.to_world(s->wi);
        if (!(local_z * dot(s->wi, n_g_) > 0.0F)) {
            counters.reject(Reject::kSideMismatch, material_);
            return {};
        }
        return s;
    }

    Framef frame_;
    Vec3f n_g_;  // on the side of wo
    ModelAt model_;
    int material_;
    float opacity_ = 1.0F;
    bool black_ = false;  // the back of a one-sided surface
};

/// For any surface.
using Bsdf = BsdfFor<kEveryFeature>;

}  // namespace matiere
