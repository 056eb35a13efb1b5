#include "sampling/photon_guide.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <utility>

#include "base/frame.h"
#include "base/numeric.h"

namespace matiere {

namespace {

constexpr std::size_t kLeafPhotons = 12;
/// Share of guided directions where hard light is a trifle, and where it is everything.
constexpr float kLeastShare = 0.08F, kMostShare = 0.6F;
/// Fewer photons than this say nothing about the width of their lobes.
constexpr std::size_t kFewPhotons = 3;
/// Narrowest and widest lobe, as 1 - cos of its half width.
constexpr float kMinSpread = 1e-8F, kMaxSpread = 0.5F;
/// Where the light of a photon seems to come from, in multiples of the distance to the surface it
/// left: the image in a curved mirror or lens lies before, behind or beyond it; 0 is at infinity.
constexpr std::array<float, 8> kImageDistance = {1, 0.5F, 2, 4, 0, -0.5F, -1, -3};

struct Bounds {
    Vec3f low{kInfinity<float>, kInfinity<float>, kInfinity<float>};
    Vec3f high{-kInfinity<float>, -kInfinity<float>, -kInfinity<float>};

    void add(Vec3f p) {
        low = {std::min(low.x, p.x), std::min(low.y, p.y), std::min(low.z, p.z)};
        high = {std::max(high.x, p.x), std::max(high.y, p.y), std::max(high.z, p.z)};
    }
    Vec3f extent() const { return high - low; }
};

Vec3f anchor_of(const GuidePhoton& photon, float distance) {
    const Vec3f way = photon.from - photon.p;
    return distance == 0 ? normalize(way) : photon.p + way * distance;
}

float sign_of(float distance) { return float(distance > 0) - float(distance < 0); }

Vec3f axis_towards(Vec3f p, Vec3f anchor, float sign) {
    if (sign == 0) return anchor;
    const Vec3f way = (anchor - p) * sign;
    const float l2 = length_squared(way);
    return l2 > 0 ? way * (1 / std::sqrt(l2)) : Vec3f{0, 0, 1};
}

/// How badly the other photons of a region foretell the direction of each: the mean over photons of
/// 1 - cos to the nearest foretold direction.
float mean_miss(const std::vector<GuidePhoton>& photons, std::size_t begin, std::size_t end,
                float distance) {
    float sum = 0;
    const float sign = sign_of(distance);
    for (std::size_t i = begin; i < end; ++i) {
        const Vec3f truth = normalize(photons[i].from - photons[i].p);
        float best = 2;
        for (std::size_t j = begin; j < end; ++j) {
            if (j == i) continue;
            const Vec3f told = axis_towards(photons[i].p, anchor_of(photons[j], distance), sign);
            best = std::min(best, 0.5F * length_squared(told - truth));
        }
        sum += best;
    }
    return sum / float(end - begin);
}

}  // namespace

Vec3f PhotonGuide::Region::axis(Vec3f p, const Lobe& lobe) const {
    return axis_towards(p, lobe.anchor, sign_);
}

// One lobe has the density a (2 + a) / (4 pi (t + a)^2) with t = 1 - cos and the spread a: a heavy
// tail, so that a photon a little off the mark still helps and no weight grows without bound.
Vec3f PhotonGuide::Region::sample(Vec3f p, float choice, Vec2f u) const {
    std::uint32_t i = 0;
    while (i + 1 < count_ && choice >= lobes_[i].cumulative) ++i;
    const float a = spread_;
    const float t = 2 * u.x * a / (2 + a - 2 * u.x);
    const float sine = safe_sqrt(t * (2 - t)), phi = kTwoPi<float> * u.y;
    const Vec3f local{sine * std::cos(phi), sine * std::sin(phi), 1 - t};
    return normalize(Framef::from_normal(axis(p, lobes_[i])).to_world(local));
}

float PhotonGuide::Region::pdf(Vec3f p, Vec3f wi) const {
    const float a = spread_;
    float sum = 0, before = 0;
    for (std::uint32_t i = 0; i < count_; ++i) {
        const float t = 0.5F * length_squared(wi - axis(p, lobes_[i])) + a;
        sum += (lobes_[i].cumulative - before) / (t * t);
        before = lobes_[i].cumulative;
    }
    return sum * a * (2 + a) * (0.25F * kInvPi<float>);
}

PhotonGuide::PhotonGuide(std::vector<GuidePhoton> photons, double ordinary) : ordinary_(ordinary) {
    if (photons.size() < kFewPhotons) return;
    lobes_.reserve(photons.size());  // regions point into it
    build(photons, 0, photons.size());
}

void PhotonGuide::build(std::vector<GuidePhoton>& photons, std::size_t begin, std::size_t end) {
    Bounds bounds;
    for (std::size_t i = begin; i < end; ++i) bounds.add(photons[i].p);
    const Vec3f extent = bounds.extent();
    std::uint32_t axis = 0;
    for (std::uint32_t k = 1; k < 3; ++k)
        if (extent[k] > extent[axis]) axis = k;
    if (end - begin <= kLeafPhotons || !(extent[axis] > 0)) {
        nodes_.push_back({0, 3, std::uint32_t(regions_.size())});
        add_region(photons, begin, std::min(end, begin + kLeafPhotons));
        return;
    }
    const std::size_t middle = begin + (end - begin) / 2;
    const auto first = photons.begin();
    std::nth_element(
        first + std::ptrdiff_t(begin), first + std::ptrdiff_t(middle), first + std::ptrdiff_t(end),
        [axis](const GuidePhoton& a, const GuidePhoton& b) { return a.p[axis] < b.p[axis]; });
    const std::size_t node = nodes_.size();
    nodes_.push_back({photons[middle].p[axis], axis, 0});
    build(photons, begin, middle);
    nodes_[node].child = std::uint32_t(nodes_.size());
    build(photons, middle, end);
}

void PhotonGuide::add_region(const std::vector<GuidePhoton>& photons, std::size_t begin,
                             std::size_t end) {
    Region region;
    Bounds bounds;
    double total = 0;
    for (std::size_t i = begin; i < end; ++i) {
        bounds.add(photons[i].p);
        total += double(photons[i].weight);
    }
    float image = 1, spread = kInfinity<float>;
    for (const float distance : kImageDistance) {
        const float miss = mean_miss(photons, begin, end, distance);
        if (miss < spread) {
            spread = miss;
            image = distance;
        }
    }
    region.sign_ = sign_of(image);
    region.spread_ = std::clamp(spread, kMinSpread, kMaxSpread);
    const Vec3f extent = bounds.extent();
    const float longest = max_component(extent);
    const Vec3f margin = extent * 0.5F + Vec3f{longest, longest, longest} * 0.1F;
    region.low_ = bounds.low - margin;
    region.high_ = bounds.high + margin;
    std::array<float, 3> e = {extent.x, extent.y, extent.z};
    std::sort(e.begin(), e.end());
    const float area = std::max(e[2] * e[1], e[2] * e[2] * 0.01F);
    const double hard = total / std::max(double(area), 1e-30);
    region.share_ =
        kLeastShare + (kMostShare - kLeastShare) * float(hard / (hard + 0.5 * ordinary_));
    region.count_ = end - begin < kFewPhotons ? 0 : std::uint32_t(end - begin);
    region.lobes_ = lobes_.data() + lobes_.size();
    double sum = 0;
    for (std::size_t i = begin; i < end; ++i) {
        sum += double(photons[i].weight);
        lobes_.push_back({anchor_of(photons[i], image), float(sum / total)});
    }
    lobes_.back().cumulative = 1;
    regions_.push_back(region);
}

std::size_t PhotonGuide::bytes() const {
    return nodes_.size() * sizeof(Node) + regions_.size() * sizeof(Region) +
           lobes_.size() * sizeof(Region::Lobe);
}

const PhotonGuide::Region* PhotonGuide::find(Vec3f p) const {
    if (nodes_.empty()) return nullptr;
    std::uint32_t i = 0;
    while (nodes_[i].axis < 3) i = p[nodes_[i].axis] < nodes_[i].split ? i + 1 : nodes_[i].child;
    const Region& region = regions_[nodes_[i].child];
    if (region.count_ == 0) return nullptr;
    for (std::size_t k = 0; k < 3; ++k)
        if (p[k] < region.low_[k] || p[k] > region.high_[k]) return nullptr;
    return &region;
}

}  // namespace matiere
