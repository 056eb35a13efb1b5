#include "light/portals.h"

#include <algorithm>
#include <cmath>

namespace matiere {

std::optional<Portals::Sample> Portals::sample(Vec3f reference, float u,
                                               const SampleBlock& block) const {
    const int n = faced(reference);
    if (n == 0) return std::nullopt;
    int left = std::min(int(u * float(n)), n - 1);
    for (const RectangleShape& s : shapes_) {
        if (!faces(s, reference) || left-- > 0) continue;
        const ShapeSample at = s.sample(reference, block);
        if (!(at.pdf > 0)) return std::nullopt;
        const Vec3f wi = normalize(at.p - reference);
        const float all = pdf(reference, wi);
        if (!(all > 0)) return std::nullopt;  // a direction that rounding put beside the edge
        return Sample{wi, all};
    }
    return std::nullopt;
}

float Portals::pdf(Vec3f reference, Vec3f direction) const {
    float sum = 0;
    int n = 0;
    for (const RectangleShape& s : shapes_) {
        if (!faces(s, reference)) continue;
        ++n;
        const float cosine = -dot(direction, s.n);
        if (!(cosine > 0)) continue;
        const float t = dot(reference - s.corner, s.n) / cosine;
        const Vec3f at = reference + direction * t - s.corner;
        const float u = dot(at, s.edge_u) / length_squared(s.edge_u);
        const float v = dot(at, s.edge_v) / length_squared(s.edge_v);
        if (!(u >= 0 && u <= 1 && v >= 0 && v <= 1)) continue;
        const float pdf = t * t / (s.area * cosine);
        if (std::isfinite(pdf)) sum += pdf;
    }
    return n > 0 ? sum / float(n) : 0;
}

}  // namespace matiere
