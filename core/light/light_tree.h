// A tree over lights that stand somewhere: finds, in a number of steps that grows with the
// logarithm of their count, a light with a probability near its share of the light that arrives
// (Conty Estevez & Kulla 2018, "Importance Sampling of Many Lights with Adaptive Tree Splitting").
#pragma once

#include <cstdint>
#include <limits>
#include <optional>
#include <vector>

#include "base/vec.h"

namespace matiere {

/// Where a light stands, which way it shines, and how much.
struct LightBounds {
    Vec3f low{std::numeric_limits<float>::max(), std::numeric_limits<float>::max(),
              std::numeric_limits<float>::max()};
    Vec3f high = -low;
    Vec3f axis{0, 0, 1};   ///< of the cone that holds all normals, unit
    float cos_normal = 1;  ///< half angle of that cone; -1: all directions
    float cos_emit = 0;    ///< half angle around a normal that is lit
    bool two_sided = false;
    double power = 0;

    void grow(Vec3f p);
    /// Both together; no power is the empty set.
    static LightBounds merge(const LightBounds& a, const LightBounds& b);
    /// What reaches a point at most, up to a factor; `near2` keeps it finite where a light stands.
    float importance(Vec3f reference, float near2) const;
};

class LightTree {
 public:
    LightTree() = default;
    /// Lights without power are left out: they are never chosen.
    explicit LightTree(const std::vector<LightBounds>& lights);

    bool empty() const { return nodes_.empty(); }
    double power() const { return nodes_.empty() ? 0.0 : nodes_.front().bounds.power; }

    struct Choice {
        std::uint32_t light;
        float probability;
    };
    /// u in [0, 1). Nothing where no light can reach the point.
    std::optional<Choice> sample(Vec3f reference, double u) const;
    /// Probability with which `sample` chooses the light.
    float probability(Vec3f reference, std::uint32_t light) const;

 private:
    struct Node {
        LightBounds bounds;
        std::uint32_t parent = 0;
        std::uint32_t right = 0;  ///< inner: the second child, the first is the next node; leaf: 0
        std::uint32_t light = 0;  ///< leaf
    };
    using Leaves = std::vector<std::uint32_t>;
    std::uint32_t build(const std::vector<LightBounds>& lights, Leaves& leaves, std::size_t begin,
                        std::size_t end, std::uint32_t parent);
    /// Probability of the first child of an inner node; nothing where neither is lit from.
    std::optional<double> first(std::uint32_t node, Vec3f reference) const;

    static constexpr std::uint32_t kNone = ~0U;
    std::vector<Node> nodes_;
    std::vector<std::uint32_t> leaf_of_;  ///< by light; kNone: never chosen
    float near2_ = 0;
};

}  // namespace matiere
