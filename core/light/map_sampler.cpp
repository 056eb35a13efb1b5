#include "light/map_sampler.h"

#include <algorithm>
#include <cmath>

#include "base/numeric.h"
#include "base/rng.h"
#include "sampling/discrete.h"

namespace matiere {

namespace {

/// Edges of the cells of a cube face: tangents of 9 and 27 degrees.
constexpr float kInner = 0.158384440F, kOuter = 0.509525449F;
/// Widest angle between a normal and the middle of its cell: atan(sqrt(2) tan(9 degrees)).
constexpr double kCellRadius = 0.2204;
/// Patches of texels along each side of a block, which are taken to have one direction each.
constexpr std::size_t kPatches = 4;

int cell(float tangent) {
    return 2 + int(tangent > kInner) + int(tangent > kOuter) - int(tangent < -kInner) -
           int(tangent < -kOuter);
}

/// The largest cosine to a direction among normals within `radius` of n, and not less than 0.
double widest_cosine(double cosine, double radius) {
    if (cosine >= std::cos(radius)) return 1;
    const double sine = std::sqrt(std::max(0.0, 1 - cosine * cosine));
    return std::max(0.0, cosine * std::cos(radius) + sine * std::sin(radius));
}

/// A cell of a distribution, or of a stretch of one that begins at the lattice point `low`.
struct Found {
    std::size_t cell;
    float probability;
    std::uint32_t rest;  ///< where in the cell, in 0.32 fixed point
};

Found find(std::span<const std::uint32_t> ends, std::uint32_t low, std::uint32_t u) {
    const std::uint32_t whole = ends.back() - low;
    const std::uint64_t scaled = std::uint64_t(u) * whole;
    const std::uint32_t lattice = low + std::uint32_t(scaled >> 32U);
    std::uint32_t cell = 0;  // by counting: a few vector instructions for 32 cells
    for (const std::uint32_t end : ends) cell += std::uint32_t(end <= lattice);
    const std::uint32_t begin = cell == 0 ? low : ends[cell - 1], count = ends[cell] - begin;
    const std::uint64_t inside = (std::uint64_t(lattice - begin) << 32U) | std::uint32_t(scaled);
    return {cell, float(count) / float(whole), std::uint32_t(inside / count)};
}

/// Probability of a cell; 0 where nothing has one.
float share(std::span<const std::uint32_t> ends, std::uint32_t low, std::size_t cell) {
    const std::uint32_t whole = ends.back() - low;
    if (whole == 0) return 0;
    return float(ends[cell] - (cell == 0 ? low : ends[cell - 1])) / float(whole);
}

}  // namespace

void MapSampler::Distributions::add(std::span<const double> weights) {
    const DiscreteDistribution made(weights);
    ends.insert(ends.end(), made.ends().begin(), made.ends().end());
    if (made.empty()) ends.resize(ends.size() + length);
}

int MapSampler::table(Vec3f n) {
    const Vec3f a = abs(n);
    const int axis = a.x > a.y ? (a.x > a.z ? 0 : 2) : (a.y > a.z ? 1 : 2);
    const float major = n[std::size_t(axis)];
    if (major == 0) return kTables - 1;
    const float scale = 1 / std::abs(major);
    const int face = 2 * axis + int(major < 0);
    const int i = cell(n[std::size_t((axis + 1) % 3)] * scale);
    const int j = cell(n[std::size_t((axis + 2) % 3)] * scale);
    return (face * kSide + i) * kSide + j;
}

Vec3d MapSampler::normal_of(int table) {
    const int face = table / (kSide * kSide), i = table / kSide % kSide, j = table % kSide;
    const auto tangent = [](int k) { return std::tan(double(k - 2) * 18 * kPi<double> / 180); };
    std::array<double, 3> n{};
    const auto axis = std::size_t(face / 2);
    n[axis] = face % 2 == 0 ? 1 : -1;
    n[(axis + 1) % 3] = tangent(i);
    n[(axis + 2) % 3] = tangent(j);
    return normalize(Vec3d{n[0], n[1], n[2]});
}

MapSampler::MapSampler(int width, int height, std::span<const double> weights)
    : width_(std::size_t(width)), height_(std::size_t(height)) {
    if (std::none_of(weights.begin(), weights.end(), [](double w) { return w > 0; })) return;
    block_width_ = (width_ + kBlocksAcross - 1) / kBlocksAcross;
    block_height_ = (height_ + kBlocksDown - 1) / kBlocksDown;
    across_ = (width_ + block_width_ - 1) / block_width_;
    down_ = (height_ + block_height_ - 1) / block_height_;
    rows_.length = down_;
    columns_.length = across_;
    block_rows_.length = block_height_;
    texels_.length = width_;
    for (std::size_t y = 0; y < height_; ++y) texels_.add(weights.subspan(y * width_, width_));
    std::vector<double> sums(block_height_);
    for (std::size_t b = 0; b < across_ * down_; ++b) {
        const std::size_t x0 = b % across_ * block_width_, y0 = b / across_ * block_height_;
        const std::size_t x1 = std::min(x0 + block_width_, width_);
        std::fill(sums.begin(), sums.end(), 0);
        for (std::size_t y = y0; y < std::min(y0 + block_height_, height_); ++y)
            for (std::size_t x = x0; x < x1; ++x) sums[y - y0] += weights[y * width_ + x];
        block_rows_.add(sums);
    }
    const std::vector<Patch> all = patches(weights);
    for (int t = 0; t < kTables; ++t) add_table(all, t);
}

std::vector<MapSampler::Patch> MapSampler::patches(std::span<const double> weights) const {
    const std::size_t w = (block_width_ + kPatches - 1) / kPatches;
    const std::size_t h = (block_height_ + kPatches - 1) / kPatches;
    const double d_theta = kPi<double> / double(height_), d_phi = 2 * kPi<double> / double(width_);
    std::vector<Patch> out;
    for (std::size_t b = 0; b < across_ * down_; ++b) {
        const std::size_t left = b % across_ * block_width_, top = b / across_ * block_height_;
        const std::size_t right = std::min(left + block_width_, width_);
        const std::size_t bottom = std::min(top + block_height_, height_);
        for (std::size_t y0 = top; y0 < bottom; y0 += h)
            for (std::size_t x0 = left; x0 < right; x0 += w) {
                const std::size_t x1 = std::min(x0 + w, right), y1 = std::min(y0 + h, bottom);
                double sum = 0;
                for (std::size_t y = y0; y < y1; ++y)
                    for (std::size_t x = x0; x < x1; ++x) sum += weights[y * width_ + x];
                if (!(sum > 0)) continue;
                const double theta = 0.5 * double(y0 + y1) * d_theta;
                const double phi = 0.5 * double(x0 + x1) * d_phi - kPi<double>;
                const Vec3d d{std::sin(theta) * std::sin(phi), std::cos(theta),
                              -std::sin(theta) * std::cos(phi)};
                const double radius =
                    0.5 * std::hypot(double(x1 - x0) * d_phi, double(y1 - y0) * d_theta);
                out.push_back({d, sum, radius, b % across_, b / across_});
            }
    }
    return out;
}

void MapSampler::add_table(const std::vector<Patch>& patches, int table) {
    const bool all_around = table == kTables - 1;
    const Vec3d n = all_around ? Vec3d{} : normal_of(table);
    std::vector<double> blocks(across_ * down_), rows(down_);
    for (const Patch& p : patches) {
        const double cosine =
            all_around ? 1 : widest_cosine(dot(n, p.direction), kCellRadius + p.radius);
        blocks[p.block_y * across_ + p.block_x] += p.weight * cosine;
        rows[p.block_y] += p.weight * cosine;
    }
    rows_.add(rows);
    for (std::size_t y = 0; y < down_; ++y)
        columns_.add(std::span(blocks).subspan(y * across_, across_));
}

std::size_t MapSampler::bytes() const {
    return (rows_.ends.size() + columns_.ends.size() + block_rows_.ends.size() +
            texels_.ends.size()) *
           sizeof(std::uint32_t);
}

MapSampler::Stretch MapSampler::stretch(std::size_t across, std::size_t y) const {
    const std::size_t x0 = across * block_width_, x1 = std::min(x0 + block_width_, width_);
    const auto row = texels_.of(y);
    return {row.subspan(x0, x1 - x0), x0 == 0 ? 0 : row[x0 - 1]};
}

MapSampler::Pick MapSampler::sample(int table, std::uint32_t bits_u, std::uint32_t bits_v) const {
    const auto t = std::size_t(table);
    if (rows_.of(t).back() == 0) return {0, 0, 0, 0, 0};
    const Found down = find(rows_.of(t), 0, bits_v);
    const Found across = find(columns_.of(t * down_ + down.cell), 0, bits_u);
    const Found row = find(block_rows_.of(down.cell * across_ + across.cell), 0, down.rest);
    const std::size_t y = down.cell * block_height_ + row.cell;
    const Stretch texels = stretch(across.cell, y);
    const Found texel = find(texels.ends, texels.low, across.rest);
    return {std::uint32_t(across.cell * block_width_ + texel.cell), std::uint32_t(y),
            unit_float(texel.rest), unit_float(row.rest),
            down.probability * across.probability * row.probability * texel.probability};
}

float MapSampler::probability(int table, std::size_t x, std::size_t y) const {
    const auto t = std::size_t(table);
    const std::size_t across = x / block_width_, down = y / block_height_;
    const float block =
        share(rows_.of(t), 0, down) * share(columns_.of(t * down_ + down), 0, across);
    if (block == 0) return 0;
    const Stretch texels = stretch(across, y);
    return block * share(block_rows_.of(down * across_ + across), 0, y - down * block_height_) *
           share(texels.ends, texels.low, x - across * block_width_);
}

}  // namespace matiere
