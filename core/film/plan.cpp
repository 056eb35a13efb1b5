#include "film/plan.h"

#include <algorithm>
#include <cmath>
#include <string>

#include "base/error.h"

namespace matiere {
namespace {

constexpr std::uint64_t kDoublings = 4;  // ranges that end at R, 2R, 4R, 8R
constexpr std::uint64_t kStep = 4;       // then 4R at a time
constexpr std::uint64_t kMaxRanges = std::uint64_t(1) << 23;
constexpr double kTargetTiles = 64.0;

int divide_up(int a, int b) { return (a + b - 1) / b; }

/// The power of two whose tile count is nearest to 64 by ratio; larger tiles win a tie.
int choose_tile_edge(int width, int height) {
    int best = 128;
    double best_distance = 1e9;
    for (int edge = 128; edge >= 16; edge /= 2) {
        const double tiles = double(divide_up(width, edge)) * double(divide_up(height, edge));
        const double distance = std::abs(std::log2(tiles / kTargetTiles));
        if (distance < best_distance - 1e-9) {
            best = edge;
            best_distance = distance;
        }
    }
    return best;
}

void check(int width, int height, int replicates) {
    if (width < 1 || height < 1 || width > Plan::kMaxEdge || height > Plan::kMaxEdge)
        throw SceneError("bad_film_size",
                         "a film is 1 to 65536 pixels wide and high, not " + std::to_string(width) +
                             " x " + std::to_string(height),
                         "/film");
    if (replicates < 1 || replicates > Plan::kMaxReplicates)
        throw SceneError("bad_replicates",
                         "replicates must be 1 to 64, not " + std::to_string(replicates),
                         "/render/replicates");
}

}  // namespace

Plan::Plan(int width, int height, int replicates, bool adaptive)
    : width_(width), height_(height), replicates_(replicates), adaptive_(adaptive) {
    check(width, height, replicates);
    if (adaptive && (replicates < 4 || replicates % 2 != 0))
        throw SceneError("bad_replicates",
                         "adaptive sampling needs two halves of at least two replicates: an even "
                         "number of 4 or more, not " +
                             std::to_string(replicates),
                         "/render/replicates");
    tile_edge_ = choose_tile_edge(width, height);
    tiles_x_ = divide_up(width, tile_edge_);
    tiles_y_ = divide_up(height, tile_edge_);
}

std::uint64_t Plan::boundary(std::uint64_t k) const {
    if (k > kMaxRanges)
        throw SceneError("bad_spp", "the plan has no range " + std::to_string(k), "/render/spp");
    const auto r = std::uint64_t(replicates_);
    if (k == 0) return 0;
    if (k <= kDoublings) return r << (k - 1);
    return (r << (kDoublings - 1)) + (k - kDoublings) * kStep * r;
}

std::uint64_t Plan::ranges(std::uint64_t spp) const {
    if (spp > kMaxSpp)
        throw SceneError(
            "bad_spp", "spp is at most " + std::to_string(kMaxSpp) + ", not " + std::to_string(spp),
            "/render/spp");
    for (std::uint64_t k = 0; k <= kDoublings; ++k)
        if (boundary(k) >= spp) return k;
    const std::uint64_t step = kStep * std::uint64_t(replicates_);
    return kDoublings + (spp - boundary(kDoublings) + step - 1) / step;
}

std::uint32_t Plan::chunk_count(std::uint64_t spp) const {
    const std::uint64_t count = ranges(spp) * std::uint64_t(strips());
    if (count > UINT32_MAX)
        throw SceneError("bad_spp", "this film and spp need more than 2^32 chunks", "/render/spp");
    return std::uint32_t(count);
}

Chunk Plan::chunk(std::uint32_t index) const {
    const auto strip_count = std::uint32_t(strips());
    const std::uint32_t range = index / strip_count;
    const auto strip = int(index % strip_count);
    const int tile = strip % tiles(), half = strip / tiles();
    Chunk c;
    c.index = index;
    c.r0 = half * (replicates_ / 2);
    c.r1 = adaptive_ ? c.r0 + replicates_ / 2 : replicates_;
    c.x0 = (tile % tiles_x_) * tile_edge_;
    c.y0 = (tile / tiles_x_) * tile_edge_;
    c.x1 = std::min(c.x0 + tile_edge_, width_);
    c.y1 = std::min(c.y0 + tile_edge_, height_);
    c.s0 = boundary(range);
    c.s1 = boundary(std::uint64_t(range) + 1);
    return c;
}

bool Plan::is_look(std::uint64_t spp, int per_octave) const {
    const std::uint64_t k = ranges(spp);
    if (spp == 0 || boundary(k) != spp) return false;
    if (k == 1) return true;
    // The mark is exact for even k: the slack only absorbs the rounding of exp2 and log2.
    const double r = double(replicates_), slack = 1e-9;
    const double step = std::floor(double(per_octave) * std::log2(double(spp) / r) + slack);
    const double mark = r * std::exp2(step / double(per_octave));
    return mark * (1.0 + slack) > double(boundary(k - 1)) * (1.0 + 2.0 * slack);
}

std::uint64_t Plan::look_number(std::uint64_t spp) const {
    std::uint64_t looks = 0;
    const std::uint64_t last = std::min(spp, kMaxSpp);
    for (std::uint64_t k = 1; boundary(k) <= last; ++k)
        if (is_look(boundary(k), kFinestLooks)) ++looks;
    return std::max<std::uint64_t>(looks, 1);
}

}  // namespace matiere
