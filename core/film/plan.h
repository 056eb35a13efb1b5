// The chunk plan: which samples of which pixels are one unit of work. It depends on film size,
// replicate count and kVersion alone, so a short render is a prefix of a longer one.
#pragma once

#include <cstdint>

namespace matiere {

/// Samples [s0, s1) of the pixels [x0, x1) x [y0, y1) of one layer (0 = camera).
struct Chunk {
    std::uint32_t index = 0;
    int layer = 0;
    int x0 = 0, y0 = 0, x1 = 0, y1 = 0;
    std::uint64_t s0 = 0, s1 = 0;

    int width() const { return x1 - x0; }
    int height() const { return y1 - y0; }
};

/// Sample ranges end at R, 2R, 4R, 8R and then every further 4R samples per pixel; every range is
/// cut into the same tiles. Chunk index = range index * tiles + tile index.
class Plan {
 public:
    static constexpr int kVersion = 1;
    static constexpr int kMaxReplicates = 64;
    static constexpr int kMaxEdge = 65536;
    static constexpr int kFinestLooks = 8;  ///< per octave
    /// Ceiling of samples per pixel, also the cap where only seconds or an error is asked for.
    static constexpr std::uint64_t kMaxSpp = std::uint64_t(1) << 20;

    /// Width and height are those of the pixels stored (the crop). Throws SceneError if unusable.
    Plan(int width, int height, int replicates);

    int width() const { return width_; }
    int height() const { return height_; }
    int replicates() const { return replicates_; }
    int tile_edge() const { return tile_edge_; }
    int tiles() const { return tiles_x_ * tiles_y_; }

    /// Samples per pixel after k ranges; boundary(0) = 0, boundary(1) = R. Throws when the result
    /// would not fit the sample counter.
    std::uint64_t boundary(std::uint64_t k) const;
    /// Number of ranges that hold at least `spp` samples per pixel.
    std::uint64_t ranges(std::uint64_t spp) const;
    /// The smallest boundary >= spp. Throws above kMaxSpp.
    std::uint64_t round_up(std::uint64_t spp) const { return boundary(ranges(spp)); }
    /// Chunks of the render of round_up(spp) samples per pixel: the indices [0, count).
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
};

}  // namespace matiere
