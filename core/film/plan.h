// The chunk plan: which samples of which pixels are one unit of work. It depends on film size,
// replicate count and kVersion alone, so a short render is a prefix of a longer one. The plan of an
// adaptive film has a chunk for either half of the replicates; which of them are rendered, and in
// what order, is told by allocation.h.
#pragma once

#include <cstdint>

namespace matiere {

/// Samples [s0, s1) of the pixels [x0, x1) x [y0, y1) of one layer (0 = camera), as far as they
/// belong to the replicates [r0, r1).
struct Chunk {
    std::uint32_t index = 0;
    int layer = 0;
    int x0 = 0, y0 = 0, x1 = 0, y1 = 0;
    std::uint64_t s0 = 0, s1 = 0;
    int r0 = 0, r1 = 0;

    int width() const { return x1 - x0; }
    int height() const { return y1 - y0; }
    int pixels() const { return width() * height(); }
    int replicates() const { return r1 - r0; }
};

/// Sample ranges end at R, 2R, 4R, 8R and then every further 4R samples per pixel; every range is
/// cut into the same strips: tiles, or in an adaptive plan tiles x halves of the replicates. Chunk
/// index = range index * strips + half * tiles + tile index.
class Plan {
 public:
    static constexpr int kVersion = 1;
    static constexpr int kAdaptiveVersion = 2;
    static constexpr int kMaxReplicates = 64;
    static constexpr int kMaxEdge = 65536;
    static constexpr int kFinestLooks = 8;  ///< per octave
    /// Most samples per pixel.
    static constexpr std::uint64_t kMaxSpp = std::uint64_t(1) << 24;
    /// The cap where only seconds or an error is asked for.
    static constexpr std::uint64_t kOpenEndedSpp = std::uint64_t(1) << 20;

    /// Width and height are those of the pixels stored (the crop). Throws SceneError if unusable;
    /// an adaptive plan needs an even number of replicates, at least 4.
    Plan(int width, int height, int replicates, bool adaptive = false);
    bool operator==(const Plan&) const = default;

    int width() const { return width_; }
    int height() const { return height_; }
    int replicates() const { return replicates_; }
    int tile_edge() const { return tile_edge_; }
    bool adaptive() const { return adaptive_; }
    int tiles() const { return tiles_x_ * tiles_y_; }
    int tiles_across() const { return tiles_x_; }
    int halves() const { return adaptive_ ? 2 : 1; }
    int strips() const { return tiles() * halves(); }

    /// Samples per pixel after k ranges; boundary(0) = 0, boundary(1) = R. Throws when the result
    /// would not fit the sample counter.
    std::uint64_t boundary(std::uint64_t k) const;
    /// Number of ranges that hold at least `spp` samples per pixel.
    std::uint64_t ranges(std::uint64_t spp) const;
    /// The smallest boundary >= spp. Throws above kMaxSpp.
    std::uint64_t round_up(std::uint64_t spp) const { return boundary(ranges(spp)); }
    /// Chunks of the uniform render of round_up(spp) samples per pixel: the indices [0, count).
    std::uint32_t chunk_count(std::uint64_t spp) const;
    Chunk chunk(std::uint32_t index) const;

    /// A look at the error is due at the first boundary at or after R * 2^(k / per_octave).
    bool is_look(std::uint64_t spp, int per_octave = 2) const;
    /// Looks of the finest kind up to and with this spp, at least 1: the number of a look is the
    /// same however a run was cut into calls, chunks and jobs.
    std::uint64_t look_number(std::uint64_t spp) const;

 private:
    int width_, height_, replicates_;
    int tile_edge_ = 16, tiles_x_ = 1, tiles_y_ = 1;
    bool adaptive_ = false;
};

}  // namespace matiere
