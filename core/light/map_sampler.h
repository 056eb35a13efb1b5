// Chooses texels of a lat-long map for a surface: in proportion to what a texel weighs times a
// bound on its cosine, so that a wall does not look for the light behind it (after Conty Estevez &
// Lecocq 2018). Blocks of texels are chosen by a table for the surface's normal, the texel inside a
// block by its weight alone; both numbers are used up in order, so that stratified points stay so.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "base/vec.h"

namespace matiere {

class MapSampler {
 public:
    MapSampler() = default;
    /// `weights` of the texels by row, finite and >= 0; row 0 is +y, the centre column looks along
    /// -z.
    MapSampler(int width, int height, std::span<const double> weights);

    bool empty() const { return texels_.ends.empty(); }
    std::size_t bytes() const;

    /// The table for surfaces with this normal, a direction in the frame of the map; zero for those
    /// that are lit from all around.
    static int table(Vec3f normal);

    struct Pick {
        std::uint32_t x, y;
        float u, v;         ///< where in the texel, in [0, 1)
        float probability;  ///< of the texel; 0 where nothing was picked
    };
    /// Numbers in 0.32 fixed point, `bits_u` along the rows. The sampler must not be empty.
    Pick sample(int table, std::uint32_t bits_u, std::uint32_t bits_v) const;
    /// Probability that `sample` picks a texel.
    float probability(int table, std::size_t x, std::size_t y) const;

 private:
    /// Normals by the faces of a cube, each cut into kSide x kSide cells of 18 degrees; an axis
    /// lies in the middle of a cell.
    static constexpr int kSide = 5, kTables = 6 * kSide * kSide + 1;
    static constexpr int kBlocksAcross = 32, kBlocksDown = 16;
    /// Distributions of one length after each other, as the ends of their cells on the lattice of
    /// DiscreteDistribution; all 0 where nothing has a weight.
    struct Distributions {
        std::size_t length = 0;
        std::vector<std::uint32_t> ends;

        void add(std::span<const double> weights);
        std::span<const std::uint32_t> of(std::size_t i) const {
            return {ends.data() + i * length, length};
        }
    };
    struct Patch {
        Vec3d direction;
        double weight, radius;  ///< in radians, of the cone around its direction
        std::size_t block_x, block_y;
    };

    static Vec3d normal_of(int table);
    std::vector<Patch> patches(std::span<const double> weights) const;
    void add_table(const std::vector<Patch>& patches, int table);
    /// The texels of a row that lie in a column of blocks.
    struct Stretch {
        std::span<const std::uint32_t> ends;
        std::uint32_t low;
    };
    Stretch stretch(std::size_t across, std::size_t y) const;

    std::size_t width_ = 0, height_ = 0;
    std::size_t block_width_ = 1, block_height_ = 1, across_ = 0, down_ = 0;
    Distributions rows_;        // by table: the rows of blocks
    Distributions columns_;     // by table and row of blocks: the blocks
    Distributions block_rows_;  // by block: the rows of its texels
    Distributions texels_;      // by row of the map
};

}  // namespace matiere
