#include "light/light_tree.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>

#include "base/numeric.h"

namespace matiere {

namespace {

constexpr int kBuckets = 12;
constexpr float kRounding = 2e-3F;  // of a cosine made of products of square roots

/// Angles between unit vectors, cones and boxes; exact enough where they are small.
float angle(Vec3f a, Vec3f b) { return 2 * std::atan2(length(a - b), length(a + b)); }

Vec3f rotate(Vec3f v, Vec3f axis, float a) {
    const float c = std::cos(a), s = std::sin(a);
    return v * c + cross(axis, v) * s + axis * (dot(axis, v) * (1 - c));
}

struct Cone {
    Vec3f axis;
    float cos_half;
};

/// The smallest cone that holds two cones.
Cone merge_cones(Cone a, Cone b) {
    const Cone all{{0, 0, 1}, -1};
    if (a.cos_half <= -1 || b.cos_half <= -1) return all;
    const float half_a = std::acos(a.cos_half), half_b = std::acos(b.cos_half);
    const float between = angle(a.axis, b.axis);
    if (std::min(between + half_b, kPi<float>) <= half_a) return a;
    if (std::min(between + half_a, kPi<float>) <= half_b) return b;
    const float half = 0.5F * (half_a + between + half_b);
    if (half >= kPi<float>) return all;
    const Vec3f normal = cross(a.axis, b.axis);
    if (length_squared(normal) == 0) return all;
    const Vec3f axis = rotate(a.axis, normalize(normal), half - half_a);
    return {normalize(axis), std::cos(half)};
}

float sine(float cosine) { return safe_sqrt(1 - cosine * cosine); }

/// Cosine of what is left of an angle (given by its cosine) after another was taken off, at least
/// of the angle 0.
float cos_of_rest(float cosine, float cos_off, float sin_off) {
    return cosine > cos_off ? 1.0F : cosine * cos_off + sine(cosine) * sin_off;
}

/// Cost of a node in the surface-area-orientation heuristic: power, size and spread of directions.
double cost(const LightBounds& b, Vec3f extent, int dimension) {
    if (!(b.power > 0)) return 0;
    const double emit = std::acos(std::clamp(double(b.cos_emit), -1.0, 1.0));
    const double normal = std::acos(std::clamp(double(b.cos_normal), -1.0, 1.0));
    const double reach = std::min(normal + emit, kPi<double>);
    const double s = std::sin(normal), c = std::cos(normal);
    const double spread =
        2 * kPi<double> * (1 - c) +
        kPi<double> / 2 * (2 * reach * s - std::cos(normal - 2 * reach) - 2 * normal * s + c);
    const Vec3f d = b.high - b.low;
    const double area =
        2.0 * (double(d.x) * double(d.y) + double(d.y) * double(d.z) + double(d.z) * double(d.x));
    // Long thin boxes are to be cut across.
    const double longest = double(std::max({extent.x, extent.y, extent.z}));
    const double thin = longest / std::max(double(extent[std::size_t(dimension)]), 1e-30);
    return b.power * spread * thin * std::max(area, 1e-12 * longest * longest);
}

Vec3f lower(Vec3f a, Vec3f b) {
    return {std::min(a.x, b.x), std::min(a.y, b.y), std::min(a.z, b.z)};
}

Vec3f upper(Vec3f a, Vec3f b) {
    return {std::max(a.x, b.x), std::max(a.y, b.y), std::max(a.z, b.z)};
}

Vec3f middle(const LightBounds& b) { return (b.low + b.high) * 0.5F; }

}  // namespace

void LightBounds::grow(Vec3f p) {
    low = lower(low, p);
    high = upper(high, p);
}

LightBounds LightBounds::merge(const LightBounds& a, const LightBounds& b) {
    if (!(a.power > 0)) return b;
    if (!(b.power > 0)) return a;
    LightBounds m;
    m.low = lower(a.low, b.low);
    m.high = upper(a.high, b.high);
    const Cone cone = merge_cones({a.axis, a.cos_normal}, {b.axis, b.cos_normal});
    m.axis = cone.axis;
    m.cos_normal = cone.cos_half;
    m.cos_emit = std::min(a.cos_emit, b.cos_emit);
    m.two_sided = a.two_sided || b.two_sided;
    m.power = a.power + b.power;
    return m;
}

float LightBounds::importance(Vec3f reference, float near2) const {
    const Vec3f to_point = reference - (low + high) * 0.5F;
    const float radius2 = 0.25F * length_squared(high - low);
    const float distance2 = length_squared(to_point);
    const float d2 = std::max({distance2, radius2, near2});
    if (cos_normal <= -1 || distance2 <= radius2) return float(power) / d2;
    // Smallest angle between a normal in the cone and a direction from the box to the point: from
    // the axis to the line between the centres, less the cone's half angle, less that of the box.
    float cos_least = dot(axis, to_point) / std::sqrt(distance2);
    if (two_sided) cos_least = std::abs(cos_least);
    cos_least = cos_of_rest(cos_least, cos_normal, sine(cos_normal));
    const float sin2_box = radius2 / distance2;
    cos_least = cos_of_rest(cos_least, std::sqrt(1 - sin2_box), std::sqrt(sin2_box));
    // A light is never taken for unseen by a rounded angle.
    if (cos_least < cos_emit - kRounding) return 0;
    return float(power) * std::max(cos_least, kRounding) / d2;
}

LightTree::LightTree(const std::vector<LightBounds>& lights) : leaf_of_(lights.size(), kNone) {
    Leaves leaves;
    for (std::uint32_t i = 0; i < lights.size(); ++i)
        if (lights[i].power > 0) leaves.push_back(i);
    if (leaves.empty()) return;
    nodes_.reserve(2 * leaves.size());
    build(lights, leaves, 0, leaves.size(), kNone);
    const LightBounds& all = nodes_.front().bounds;
    near2_ = std::max(1e-12F * length_squared(all.high - all.low),
                      std::numeric_limits<float>::min() * 1e6F);
}

std::uint32_t LightTree::build(const std::vector<LightBounds>& lights, Leaves& leaves,
                               std::size_t begin, std::size_t end, std::uint32_t parent) {
    const auto node = std::uint32_t(nodes_.size());
    nodes_.emplace_back();
    nodes_[node].parent = parent;
    LightBounds all, centers;
    for (std::size_t i = begin; i < end; ++i) {
        all = LightBounds::merge(all, lights[leaves[i]]);
        centers.grow(middle(lights[leaves[i]]));
    }
    nodes_[node].bounds = all;
    if (end - begin == 1) {
        nodes_[node].light = leaves[begin];
        leaf_of_[leaves[begin]] = node;
        return node;
    }
    const Vec3f low = centers.low, extent = centers.high - centers.low;
    double best = std::numeric_limits<double>::infinity();
    int best_dimension = -1, best_bucket = 0;
    const auto bucket_of = [&](std::uint32_t light, int d) {
        const auto k = std::size_t(d);
        const float x = (middle(lights[light])[k] - low[k]) / extent[k];
        return std::clamp(int(x * kBuckets), 0, kBuckets - 1);
    };
    for (int d = 0; d < 3; ++d) {
        if (!(extent[std::size_t(d)] > 0)) continue;
        std::array<LightBounds, kBuckets> buckets;
        for (std::size_t i = begin; i < end; ++i) {
            LightBounds& b = buckets[std::size_t(bucket_of(leaves[i], d))];
            b = LightBounds::merge(b, lights[leaves[i]]);
        }
        for (int cut = 0; cut + 1 < kBuckets; ++cut) {
            LightBounds below, above;
            for (int b = 0; b < kBuckets; ++b) {
                LightBounds& side = b <= cut ? below : above;
                side = LightBounds::merge(side, buckets[std::size_t(b)]);
            }
            const Vec3f size = all.high - all.low;
            const double c = cost(below, size, d) + cost(above, size, d);
            if (below.power > 0 && above.power > 0 && c < best) {
                best = c;
                best_dimension = d;
                best_bucket = cut;
            }
        }
    }
    std::size_t split = begin + (end - begin) / 2;  // all in one place: halve the list
    if (best_dimension >= 0) {
        const auto cut = std::stable_partition(
            leaves.begin() + std::ptrdiff_t(begin), leaves.begin() + std::ptrdiff_t(end),
            [&](std::uint32_t l) { return bucket_of(l, best_dimension) <= best_bucket; });
        split = std::size_t(cut - leaves.begin());
    }
    build(lights, leaves, begin, split, node);
    const std::uint32_t right = build(lights, leaves, split, end, node);
    nodes_[node].right = right;
    return node;
}

std::optional<double> LightTree::first(std::uint32_t node, Vec3f reference) const {
    const double a = double(nodes_[node + 1].bounds.importance(reference, near2_));
    const double b = double(nodes_[nodes_[node].right].bounds.importance(reference, near2_));
    if (!(a + b > 0)) return std::nullopt;
    return a / (a + b);
}

std::optional<LightTree::Choice> LightTree::sample(Vec3f reference, double u) const {
    std::uint32_t node = 0;
    double probability = 1;
    while (nodes_[node].right != 0) {
        const auto p = first(node, reference);
        if (!p) return std::nullopt;
        const bool left = u < *p;
        const double chosen = left ? *p : 1 - *p;
        u = std::min((left ? u : u - *p) / chosen, 0x1.fffffffffffffp-1);
        probability *= chosen;
        node = left ? node + 1 : nodes_[node].right;
    }
    return Choice{nodes_[node].light, float(probability)};
}

float LightTree::probability(Vec3f reference, std::uint32_t light) const {
    std::uint32_t node = leaf_of_[light];
    if (node == kNone) return 0;
    double probability = 1;
    for (std::uint32_t up = nodes_[node].parent; up != kNone; up = nodes_[node].parent) {
        const auto p = first(up, reference);
        if (!p) return 0;
        probability *= nodes_[up].right == node ? 1 - *p : *p;
        node = up;
    }
    return float(probability);
}

}  // namespace matiere
