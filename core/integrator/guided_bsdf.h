// A material whose directions are chosen partly by itself, partly by what is known about hidden
// light around the point: one-sample MIS with the balance heuristic (Veach 1997, 9.2.4).
#pragma once

#include <algorithm>
#include <optional>

#include "material/bsdf_for.h"
#include "sampling/photon_guide.h"

namespace matiere {

template <class B>
class GuidedBsdf {
 public:
    /// `region` may be null: then this is the material as it is.
    GuidedBsdf(const B& bsdf, const PhotonGuide::Region* region, Vec3f p)
        : bsdf_(bsdf), region_(region), p_(p), share_(region != nullptr ? region->share() : 0) {}

    BsdfEval<float> eval(Vec3f wo, Vec3f wi, Counters& counters) const {
        BsdfEval<float> value = bsdf_.eval(wo, wi, counters);
        if (region_ != nullptr && !value.f.is_black()) value.pdf = density(value.pdf, wi);
        return value;
    }

    std::optional<BsdfSample<float>> sample(Vec3f wo, Vec3f u, Counters& counters) const {
        if (region_ == nullptr) return bsdf_.sample(wo, u, counters);
        if (u.x < share_) return sample_region(wo, {u.x / share_, u.y, u.z}, counters);
        u.x = std::min((u.x - share_) / (1 - share_), kBelowOne);
        auto sample = bsdf_.sample(wo, u, counters);
        if (!sample) return sample;
        if ((sample->lobe & kSpecular) != 0) {
            sample->weight *= 1 / (1 - share_);
            return sample;
        }
        const float pdf = density(sample->pdf, sample->wi);
        sample->weight *= sample->pdf / pdf;
        sample->pdf = pdf;
        return sample;
    }

    LobeSplit split(Vec3f wo, Vec3f wi) const { return bsdf_.split(wo, wi); }

 private:
    static constexpr float kBelowOne = 1 - 0x1p-24F;

    float density(float bsdf_pdf, Vec3f wi) const {
        return (1 - share_) * bsdf_pdf + share_ * region_->pdf(p_, wi);
    }

    std::optional<BsdfSample<float>> sample_region(Vec3f wo, Vec3f u, Counters& counters) const {
        const Vec3f wi = region_->sample(p_, u.x, {u.y, u.z});
        const BsdfEval<float> value = bsdf_.eval(wo, wi, counters);
        if (value.f.is_black()) return std::nullopt;
        const float pdf = density(value.pdf, wi);
        return BsdfSample<float>{wi, value.f * (1 / pdf), pdf, kDiffuse | kReflection, 1};
    }

    const B& bsdf_;
    const PhotonGuide::Region* region_;
    Vec3f p_;
    float share_;
};

}  // namespace matiere
