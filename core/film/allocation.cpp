#include "film/allocation.h"

#include <algorithm>
#include <queue>
#include <utility>

namespace matiere {

Allocation::Allocation(const Plan& plan)
    : plan_(plan), ranges_(std::size_t(plan.strips()), 0), samples_(std::size_t(plan.halves())) {
    for (int tile = 0; tile < plan.tiles(); ++tile)
        pixels_.push_back(double(plan.chunk(std::uint32_t(tile)).pixels()));
    for (std::uint64_t k = 1; k <= kFirstBase; ++k) {
        lift(k);
        round_ends_.push_back(order_.size());
    }
}

std::uint64_t Allocation::rounds(std::size_t position) const {
    return std::uint64_t(std::upper_bound(round_ends_.begin(), round_ends_.end(), position) -
                         round_ends_.begin());
}

std::size_t Allocation::round_end(std::uint64_t k) const {
    if (k == 0) return 0;
    return k <= round_ends_.size() ? round_ends_[k - 1] : order_.size();
}

std::uint64_t Allocation::base(int level) const {
    return plan_.ranges(std::min(plan_.boundary(kFirstBase) << level, Plan::kMaxSpp));
}

bool Allocation::decide(std::span<const double> worth) {
    const std::uint64_t end = kMeanOverBase * (plan_.boundary(kFirstBase) << level_);
    const std::vector<double> wish = smooth(worth);
    const std::size_t known = round_ends_.size();
    for (std::uint64_t k = known + 1; plan_.boundary(k) <= std::min(end, Plan::kMaxSpp); ++k) {
        for (int half = 0; half < plan_.halves(); ++half) fill(half, plan_.boundary(k), wish);
        round_ends_.push_back(order_.size());
    }
    if (round_ends_.size() == known) return false;
    lift(base(++level_));
    return true;
}

void Allocation::add_range(int strip) {
    std::uint64_t& ranges = ranges_[std::size_t(strip)];
    order_.push_back(std::uint32_t(ranges * std::uint64_t(plan_.strips()) + std::uint64_t(strip)));
    samples_[std::size_t(strip / plan_.tiles())] +=
        pixels_[std::size_t(strip % plan_.tiles())] * (half_spp(ranges + 1) - half_spp(ranges));
    ++ranges;
}

/// Every strip gets at least so many ranges; both halves of a tile follow each other.
void Allocation::lift(std::uint64_t ranges) {
    for (int tile = 0; tile < plan_.tiles(); ++tile)
        for (int strip = tile; strip < plan_.strips(); strip += plan_.tiles())
            while (ranges_[std::size_t(strip)] < ranges && fits(ranges_[std::size_t(strip)]))
                add_range(strip);
}

/// Gives ranges to the tile that lags most behind its share until the mean of the half is reached
/// (Webster's method of highest averages: shares come out proportional to `wish`).
void Allocation::fill(int half, std::uint64_t spp, std::span<const double> wish) {
    const double pixels = double(plan_.width()) * double(plan_.height());
    const double budget = double(spp) / 2.0 * pixels;
    const double most = std::min(kCeiling * double(spp) / 2.0, double(Plan::kMaxSpp) / 2.0);
    using Claim = std::pair<double, int>;  // equal claims: the lower tile first
    std::priority_queue<Claim> claims;
    const auto claim = [&](int tile) {
        const std::uint64_t ranges = ranges_[std::size_t(half * plan_.tiles() + tile)];
        const double now = half_spp(ranges), next = half_spp(ranges + 1);
        const double share = wish[std::size_t((1 - half) * plan_.tiles() + tile)];
        if (next <= most && fits(ranges)) claims.emplace(share / (now + next), -tile);
    };
    for (int tile = 0; tile < plan_.tiles(); ++tile) claim(tile);
    while (samples_[std::size_t(half)] < budget && !claims.empty()) {
        const int tile = -claims.top().second;
        claims.pop();
        add_range(half * plan_.tiles() + tile);
        claim(tile);
    }
}

/// The worth of a tile, a quarter of it from its neighbours: where one tile met a rare path, the
/// next one may have missed it. Without evidence anywhere all tiles are alike.
std::vector<double> Allocation::smooth(std::span<const double> worth) const {
    const int across = plan_.tiles_across(), down = plan_.tiles() / across;
    std::vector<double> result(worth.size());
    for (int half = 0; half < plan_.halves(); ++half) {
        const auto own = worth.subspan(std::size_t(half * plan_.tiles()));
        double total = 0.0;
        for (int tile = 0; tile < plan_.tiles(); ++tile) {
            double sum = 0.0;
            int n = 0;
            for (int y = tile / across - 1; y <= tile / across + 1; ++y)
                for (int x = tile % across - 1; x <= tile % across + 1; ++x) {
                    const int other = y * across + x;
                    if (x < 0 || y < 0 || x >= across || y >= down || other == tile) continue;
                    sum += own[std::size_t(other)];
                    ++n;
                }
            const double self = own[std::size_t(tile)];
            const double wish = n == 0 ? self : kOwnShare * self + (1.0 - kOwnShare) * sum / n;
            result[std::size_t(half * plan_.tiles() + tile)] = wish;
            total += wish;
        }
        if (!(total > 0.0)) std::fill_n(result.begin() + half * plan_.tiles(), plan_.tiles(), 1.0);
    }
    return result;
}

}  // namespace matiere
