// Collects what one path says of the layers of a film, as it goes: the first surface it meets, and
// its light by the number of events and by the lobes of the first one.
#pragma once

#include "film/aov.h"
#include "integrator/integrator.h"
#include "material/bsdf.h"
#include "material/surface_point.h"

namespace matiere {

class AovLayers {
 public:
    /// The first surface that does not let the path pass.
    void meet(const SurfacePoint& point, int material, Vec3f origin, Vec3f direction) {
        s_.met = true;
        s_.material = material;
        s_.position = point.p;
        s_.depth = length(point.p - origin);
        s_.uv = point.first.uv;
        s_.normal = dot(point.n_g, direction) < 0 ? point.n_s : -point.n_s;
    }
    void shading_normal(Vec3f n) { s_.normal = n; }
    /// It was passed after all.
    void pass() { s_ = with_light(AovSample{}); }

    /// The direction that the first event took.
    void scatter(const BsdfSample<float>& sample) {
        s_.albedo = sample.weight;
        if ((sample.lobe & kTransmission) != 0) s_.albedo *= sample.eta * sample.eta;
    }
    void split(const LobeSplit& split) { split_ = split; }

    /// Light that arrives after so many events.
    void add(const Spectrumf& light, int events) {
        (events <= 1 ? s_.direct : s_.indirect) += light;
        if (events == 0) {
            s_.emission += light;
        } else if (split_.transmission) {
            s_.transmission += light;
        } else {
            const Spectrumf diffuse = light * split_.diffuse;
            s_.diffuse += diffuse;
            s_.specular += light - diffuse;
        }
    }

    /// A path whose light was rejected as a whole has none in its layers either.
    AovSample finish(const PathResult& result) {
        const Spectrumf sum = s_.direct + s_.indirect;
        return result.L.is_black() || !sum.is_finite() ? without_light() : s_;
    }

 private:
    AovSample with_light(AovSample to) const {
        to.emission = s_.emission;
        to.direct = s_.direct;
        to.indirect = s_.indirect;
        to.diffuse = s_.diffuse;
        to.specular = s_.specular;
        to.transmission = s_.transmission;
        return to;
    }
    AovSample without_light() const {
        AovSample dark = s_;
        dark.emission = dark.direct = dark.indirect = Spectrumf();
        dark.diffuse = dark.specular = dark.transmission = Spectrumf();
        return dark;
    }

    AovSample s_;
    LobeSplit split_;
};

}  // namespace matiere
