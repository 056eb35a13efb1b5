#include "scene/media_at.h"

#include <algorithm>
#include <iterator>
#include <vector>

#include "scene/scene.h"

namespace matiere {

InteriorStack media_at(const Scene& scene, Vec3f p) {
    constexpr int kMaxCrossings = 10000;
    const MaterialTable& materials = scene.materials();
    // No axis, no diagonal: unlikely to run along an edge of anything modelled by hand.
    Ray ray{p, normalize(Vec3f{0.3217F, 0.8471F, 0.4219F})};
    std::vector<int> entered, inside;
    for (int i = 0; i < kMaxCrossings; ++i) {
        const RayHit hit = scene.intersect(ray);
        if (hit.missed()) break;
        const SurfaceHit s = scene.surface(ray, hit);
        if (s.material >= 0 && materials[s.material].has_interior) {
            const auto found = std::find(entered.rbegin(), entered.rend(), s.material);
            if (dot(s.point.n_g, ray.direction) < 0)
                entered.push_back(s.material);
            else if (found != entered.rend())
                entered.erase(std::next(found).base());
            else
                inside.push_back(s.material);
        }
        ray.origin = offset_origin(s.point.p, s.error, s.point.n_g, ray.direction);
    }
    InteriorStack stack;
    Counters ignored;
    for (auto it = inside.rbegin(); it != inside.rend(); ++it)
        stack.enter(*it, materials[*it], ignored);
    return stack;
}

}  // namespace matiere
