#include "film/aov.h"

#include "base/error.h"

namespace matiere {
namespace {

struct Values {
    std::array<float, 3> v;
};

Values of(const Spectrumf& s) { return {{s[0], s[1], s[2]}}; }
Values of(Vec3f v) { return {{v.x, v.y, v.z}}; }

Values value_of(const AovSample& s, Aov aov) {
    switch (aov) {
        case Aov::kAlbedo:
            return of(s.albedo);
        case Aov::kNormal:
            return of(s.normal);
        case Aov::kDepth:
            return {{s.depth, 0, 0}};
        case Aov::kPosition:
            return of(s.position);
        case Aov::kUv:
            return {{s.uv.x, s.uv.y, 0}};
        case Aov::kMaterialId:
            return {{float(s.material + 1), 0, 0}};
        case Aov::kEmission:
            return of(s.emission);
        case Aov::kDirect:
            return of(s.direct);
        case Aov::kIndirect:
            return of(s.indirect);
        case Aov::kDiffuse:
            return of(s.diffuse);
        case Aov::kSpecular:
            return of(s.specular);
        case Aov::kTransmission:
            return of(s.transmission);
    }
    return {};
}

}  // namespace

AovLayout::AovLayout(AovSet set) : set_(set) {
    if (set >> kAovs.size() != 0)
        throw SceneError("newer_film", "the film has layers that this matiere does not know");
    for (std::size_t i = 0; i < kAovs.size(); ++i)
        if (has(Aov(i))) {
            offsets_[i] = channels_;
            channels_ += kAovs[i].channels;
        }
    if (set != 0) ++channels_;  // met()
}

void AovLayout::add(const AovSample& sample, bool first_of_pixel, double* sums) const {
    for (std::size_t i = 0; i < kAovs.size(); ++i) {
        const AovInfo& info = kAovs[i];
        if (!has(Aov(i)) || (info.mean == AovMean::kFirst && !first_of_pixel)) continue;
        const Values values = value_of(sample, Aov(i));
        for (int c = 0; c < info.channels; ++c)
            sums[offsets_[i] + c] += double(values.v[std::size_t(c)]);
    }
    if (sample.met) sums[met()] += 1.0;
}

}  // namespace matiere
